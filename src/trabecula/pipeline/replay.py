"""Results made again from their recipe: every step is repeated, and its voxels are compared with
the recorded digest.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trabecula import fields, finish
from trabecula.core import indexing
from trabecula.core.checks import check_name
from trabecula.core.errors import FileError, InputError, NotReproducedError, TrabeculaError
from trabecula.core.image import Image, declare_fields
from trabecula.core.progress import notify
from trabecula.core.recipe import Recipe, digest
from trabecula.core.request import Request
from trabecula.engine.storage import is_address, location_of
from trabecula.exemplar.crop import crop
from trabecula.exemplar.place import block, place
from trabecula.exemplar.samples import sample
from trabecula.exemplar.segment import segment
from trabecula.io import files
from trabecula.mesh.base import Mesh
from trabecula.mesh.files import read_mesh
from trabecula.mesh.voxels import scale_mesh, voxelise
from trabecula.models import shipped_models
from trabecula.synth.api.method import Model
from trabecula.synth.api.registry import recorded_method
from trabecula.synth.api.serialize import load_model
from trabecula.view.still import render

AnyPath = str | os.PathLike[str]
PARTS = ("mask", "fixed", "known", "coarse", "like")


@dataclass(frozen=True)
class RecipeFiles:
    """Places of the files that a recipe names: beside the result, or as given by option.

    Attributes
    ----------
    folder : Path
        The result's.
    moved : mapping
        Option -> the files given for it.
    option : str
        The option that gives the files of the recipe in hand: that of the result, or one inside it.
    number : int
        Which of several exemplars the recipe in hand is of.
    """

    folder: Path
    moved: Mapping[str, Sequence[AnyPath]] = field(default_factory=dict)
    option: str = "exemplar"
    number: int = 0

    @property
    def replacement(self) -> AnyPath | None:
        """Return the file that was given for the recipe in hand."""
        found = self.moved.get(self.option, ())
        return found[min(self.number, len(found) - 1)] if found else None

    def inside(self, option: str, number: int = 0) -> RecipeFiles:
        """Return the same for a recipe inside the recipe."""
        return RecipeFiles(self.folder, self.moved, option, number)

    def find(self, source: str) -> AnyPath:
        """Return the place of the file that a recipe calls `source`."""
        if self.replacement is not None:
            return self.replacement
        if is_address(source):
            return source
        for candidate in (source, self.folder / source, self.folder / Path(source).name):
            if Path(candidate).exists():
                return candidate
        raise FileError(
            f"the recipe starts from {source}, which is not here: give its place with "
            f"--{self.option}"
        )


def rerun(
    path: AnyPath,
    *,
    exemplar: AnyPath | Sequence[AnyPath] | None = None,
    mask: AnyPath | None = None,
    fixed: AnyPath | None = None,
    known: AnyPath | None = None,
    coarse: AnyPath | None = None,
    like: AnyPath | None = None,
    target: AnyPath | None = None,
    model: AnyPath | None = None,
) -> Image:
    """Make a file's voxels again from the recipe in it.

    Parameters
    ----------
    path : path
    exemplar : path or sequence of path, optional
        The files that the recipe starts from, if they have moved; several in the order of the
        exemplars.
    mask, fixed, known, coarse, like, target : path, optional
        The same for the other files that the request named.
    model : path or str, optional
        The trained model that the recipe names, where it is neither beside the file nor shipped
        under that name.

    Raises
    ------
    InputError
        The file holds no recipe, or one that starts from an array in memory.
    NotReproducedError
        A step gave other voxels than the recipe says (another exemplar, another version), or the
        file's own voxels are not the recipe's.
    """
    image = files.read(path)
    steps = image.recipe.steps
    if not steps or [step["verb"] for step in steps] == ["read"]:
        raise InputError(
            f"{path} holds no recipe: it was not made by this package, or its metadata is lost"
        )
    # Before any work: the last step recorded the digest that its replay would have to meet as well.
    if digest(image.values) != steps[-1].get("sha256"):
        raise NotReproducedError(
            f"{path} does not hold what its recipe makes: its voxels were changed since"
        )
    folder = location_of(path).folder
    parts = {"mask": mask, "fixed": fixed, "known": known, "coarse": coarse, "like": like}
    parts |= {"target": target, "model": model}
    return replay(image.recipe, folder=folder, exemplar=exemplar, **parts)


def replay(
    recipe: Recipe,
    *,
    folder: Path,
    exemplar: AnyPath | Sequence[AnyPath] | None = None,
    **parts: AnyPath | None,
) -> Image:
    """Repeat the steps of a recipe and check the voxels after each; paths as for `rerun`."""
    return _replay_steps(recipe, _recipe_files(folder, exemplar, parts))


def _recipe_files(
    folder: Path, exemplar: AnyPath | Sequence[AnyPath] | None, parts: Mapping[str, AnyPath | None]
) -> RecipeFiles:
    several = [exemplar] if isinstance(exemplar, (str, os.PathLike)) else list(exemplar or ())
    return RecipeFiles(
        folder,
        {"exemplar": several, **{name: [part] for name, part in parts.items() if part is not None}},
    )


def form_of(recipe: Recipe, *, folder: Path, mask: AnyPath | None = None) -> Image | None:
    """Make the form again that an image was made to fill; None where its recipe names none.

    Parameters
    ----------
    recipe : Recipe
        Of the image.
    folder : Path
        That of the image.
    mask : path, optional
        The form's file, if it has moved.

    Raises
    ------
    FileError
        The form's file is not there.
    NotReproducedError
        It is another form.
    InputError
        The form was an array in memory, or the recipe is damaged.
    """
    steps = finish.mask_steps(recipe)
    if steps is None:
        return None
    return _replay_steps(
        Recipe.from_json(steps), _recipe_files(folder, None, {"mask": mask}).inside("mask")
    )


@contextmanager
def _report_damage(verb: str) -> Iterator[None]:
    """Turn errors of a step's parameters into one line: they come from a file that anybody may have
    written.
    """
    try:
        yield
    except TrabeculaError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        # A parameter of a wrong type and a mistake of ours look alike: neither is to be called
        # damage alone.
        doubt = (
            ", or trabecula has a defect" if isinstance(error, (TypeError, AttributeError)) else ""
        )
        raise InputError(
            f"the recipe is damaged{doubt}: its step {verb!r} cannot be done again "
            f"({type(error).__name__}: {error})"
        ) from error


def model_and_request(
    step: Mapping[str, Any],
    *,
    folder: Path,
    exemplar: AnyPath | Sequence[AnyPath] | None = None,
    **parts: AnyPath | None,
) -> tuple[Model, Request]:
    """Make the model and the request of a step "generate" again; paths as for `rerun`.

    Raises
    ------
    InputError
        The step is of another verb, or damaged.
    NotReproducedError
        An exemplar or a part of the request is not what it was.
    """
    if step.get("verb") != "generate":
        raise InputError(f"there is nothing to generate in a step {step.get('verb')!r}")
    sources = _recipe_files(folder, exemplar, parts)
    with _report_damage("generate"):
        return _make_model(step, sources), _make_request(step, sources)


def _replay_steps(recipe: Recipe, sources: RecipeFiles) -> Image:
    image: Image | None = None
    for step in recipe.steps:
        check_name(step["verb"], _STEPS, name="step of a recipe")
        with _report_damage(step["verb"]):
            image = _STEPS[step["verb"]](image, step, sources)
            same = digest(image.values) == step["sha256"]
        if not same:
            raise NotReproducedError(_explain_difference(step))
    if image is None:
        raise InputError("the recipe is empty: there is nothing to do again")
    return image


def _explain_difference(step: Mapping[str, Any]) -> str:
    what = step.get("source") or step.get("method") or step.get("operation") or step["verb"]
    made = ", ".join(
        f"{name} {number}" for name, number in dict(step.get("versions") or {}).items()
    )
    return (
        f"step {step['verb']!r} ({what}) gives other voxels than recorded: "
        f"the file has changed, or the versions ({made}) differ"
    )


def _repeat_read(image: Image | None, step: Mapping[str, Any], sources: RecipeFiles) -> Image:
    return files.read(sources.find(step["source"]), **step["options"])


def _repeat_array(image: Image | None, step: Mapping[str, Any], sources: RecipeFiles) -> Image:
    if sources.replacement is None:
        raise InputError(
            f"the recipe starts from an array in memory (SHA-256 {step['sha256'][:12]}): "
            f"give it as a file with --{sources.option}"
        )
    return files.read(sources.replacement)


def _repeat_voxelise(image: Image | None, step: Mapping[str, Any], sources: RecipeFiles) -> Image:
    surface = _make_surface(step["mesh"], sources)
    return voxelise(surface, spacing=step["spacing"], shape=step["shape"], origin=step["origin"])


def _make_surface(steps: Sequence[Mapping[str, Any]], sources: RecipeFiles) -> Mesh:
    if not steps or steps[0]["verb"] != "read_mesh":
        raise InputError(
            "the recipe voxelises a surface that was in memory: it cannot be made again"
        )
    surface = read_mesh(sources.find(steps[0]["source"]), unit=steps[0]["unit"])
    if digest(surface.vertices) != steps[0]["sha256"]:
        raise NotReproducedError(_explain_difference(steps[0]))
    for step in steps[1:]:
        check_name(step["verb"], ("scale",), name="step of a surface's recipe")
        surface = scale_mesh(surface, step["factor"], unit=step["unit"])
    return surface


def _repeat_generate(image: Image | None, step: Mapping[str, Any], sources: RecipeFiles) -> Image:
    return _make_model(step, sources).generate(_make_request(step, sources))


def _make_model(step: Mapping[str, Any], sources: RecipeFiles) -> Model:
    """Return the model: from its file where learning took long, else learned again."""
    named = step.get("model")
    if named is not None:
        path = _model_file(named, sources.inside("model"))
        if path is not None:
            return _check_model(load_model(path), named["sha256"], f"the model {path} is another")
        notify("the model was never in a file: learning again")
    exemplars = [
        _replay_steps(Recipe.from_json(steps), sources.inside("exemplar", number))
        for number, steps in enumerate(step["exemplars"])
    ]
    learner: Any = recorded_method(step["method"], step["settings"])
    model: Model = learner.fit(**step["voxel"]) if "voxel" in step else learner.fit(exemplars)
    if named is not None:
        _check_model(
            model,
            named["sha256"],
            "learning again gave another model (its time, threads, machine or versions differ)",
        )
    return model


def _model_file(named: Mapping[str, Any], sources: RecipeFiles) -> AnyPath | None:
    """Return the file of a model: as given, beside the result, or shipped; None where it was never
    in a file.
    """
    if sources.replacement is not None:
        return sources.replacement
    if named["name"] is None:
        return None
    beside = sources.folder / Path(named["name"]).name
    if beside.exists() or named["name"] in shipped_models():
        return beside if beside.exists() else named["name"]
    raise FileError(
        f"the recipe needs the model {named['name']} (SHA-256 {named['sha256'][:12]}), "
        "which is not here: give its place with --model"
    )


def _check_model(model: Model, sha256: str, otherwise: str) -> Model:
    if model.sha256 != sha256:
        raise NotReproducedError(
            f"{otherwise}: its SHA-256 is {model.sha256[:12]}, the recipe's {sha256[:12]}; "
            "give the right one with --model"
        )
    return model


def _make_request(step: Mapping[str, Any], sources: RecipeFiles) -> Request:
    request = dict(step["request"])
    for name in PARTS:
        if name in request:
            request[name] = _replay_steps(Recipe.from_json(request[name]), sources.inside(name))
    request["target"] = {
        name: _make_target(name, value, sources.inside("target"))
        for name, value in dict(request.get("target", {})).items()
    }
    return Request(**request)


def _make_target(name: str, value: Any, sources: RecipeFiles) -> Any:
    """Return a target: a number, one direction, or a field that is made again."""
    if not isinstance(value, list) or (value and not isinstance(value[0], dict)):
        return value
    if name != "orientation":
        return _replay_steps(Recipe.from_json(value), sources)
    step = value[-1]
    if step["verb"] == "array" and sources.replacement is None:
        _repeat_array(None, step, sources)
    found = fields.read_directions(sources.find(step.get("source", "")))
    if digest(found.values) != step["sha256"]:
        raise NotReproducedError(_explain_difference(step))
    return found


def _repeat_finish(image: Image | None, step: Mapping[str, Any], sources: RecipeFiles) -> Image:
    settings = dict(step["settings"])
    for steps in step.get("exemplars", ()):
        settings["exemplar"] = _replay_steps(Recipe.from_json(steps), sources.inside("exemplar"))
    if "mask" in step:
        settings["mask"] = _replay_steps(Recipe.from_json(step["mask"]), sources.inside("mask"))
    if step["operation"] == "scan":
        return finish.scan(_require(image), **settings)
    return finish.OPERATIONS[step["operation"]](_require(image), **settings)


def _repeat_field(image: Image | None, step: Mapping[str, Any], sources: RecipeFiles) -> Image:
    settings = dict(step["settings"])
    if isinstance(settings.get("mask"), str) or "marks" in settings:
        raise InputError(
            "the recipe's part was an array in memory, or it has painted meshes: this field cannot "
            "be made again from its recipe"
        )
    if "mask" in settings:
        recipe = Recipe.from_json(settings["mask"])
        settings["mask"] = _replay_steps(recipe, sources.inside("mask"))
    if step["make"] in fields.FROM_AN_IMAGE:
        return fields.FROM_AN_IMAGE[step["make"]](_require(image), **settings)
    check_name(step["make"], fields.FROM_NOTHING, name="field of a recipe")
    if "path" in settings:  # of a solver's result
        settings["path"] = sources.find(settings["path"])
    return fields.FROM_NOTHING[step["make"]](**settings)


def _repeat_render(image: Image | None, step: Mapping[str, Any], sources: RecipeFiles) -> Image:
    names = ("look", "size", "phase", "camera", "cut", "threshold")
    given = {name: step[name] for name in names}
    if "field" in step:
        inside = sources.inside("target")
        given["field"] = _replay_steps(Recipe.from_json(step["field"]), inside)
        given["limits"] = step["limits"]
    if "form" in step:
        given["form"] = _replay_steps(Recipe.from_json(step["form"]), sources.inside("form"))
    if "up" in step:
        given["up"] = step["up"]
    if "quality" in step:
        given["quality"] = step["quality"]
        given |= {name: value for name, value in step["taken"].items() if name != "denoise"}
    return render(_require(image), **given)


def _require(image: Image | None) -> Image:
    if image is None:
        raise InputError("the recipe is damaged: its first step needs an image that no step made")
    return image


_STEPS: dict[str, Callable[[Image | None, Mapping[str, Any], RecipeFiles], Image]] = {
    "read": _repeat_read,
    "array": _repeat_array,
    "sample": lambda image, step, sources: sample(step["name"]),
    "voxelise": _repeat_voxelise,
    "crop": lambda image, step, sources: crop(_require(image), step["size"], corner=step["corner"]),
    "slice": lambda image, step, sources: _require(image)[indexing.from_json(step["index"])],
    "place": lambda image, step, sources: place(
        _require(image),
        step["shape"],
        corner=step["corner"],
        plane=step.get("plane"),
        across=step.get("across", 1.0),
    ),
    "block": lambda image, step, sources: block(step["size"], step["shape"], corner=step["corner"]),
    "declare": lambda image, step, sources: declare_fields(_require(image), **step["fields"]),
    "segment": lambda image, step, sources: segment(
        _require(image), step["threshold"], phases=step["phases"]
    ),
    "generate": _repeat_generate,
    "finish": _repeat_finish,
    "field": _repeat_field,
    "render": _repeat_render,
}
