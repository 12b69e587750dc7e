"""Make a result again from its recipe: every step is done anew, and its voxels are compared with
what was recorded.
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
from trabecula.engine.storage.location import is_address, location_of
from trabecula.exemplar.crop import crop
from trabecula.exemplar.place import block, place
from trabecula.exemplar.samples import sample
from trabecula.exemplar.segment import segment
from trabecula.io import files
from trabecula.mesh.base import Mesh
from trabecula.mesh.files import read_mesh
from trabecula.mesh.voxels import scale_mesh, voxelise
from trabecula.models import shipped
from trabecula.synth.api.method import Model
from trabecula.synth.api.registry import method
from trabecula.synth.api.serialize import load_model
from trabecula.view.still import render

AnyPath = str | os.PathLike[str]
PARTS = ("mask", "fixed", "known")


@dataclass(frozen=True)
class RecipeFiles:
    """Where the files that a recipe names lie now: beside the result unless they are given anew, by
    option.
    """

    folder: Path
    moved: Mapping[str, Sequence[AnyPath]] = field(default_factory=dict)
    option: str = "exemplar"
    number: int = 0

    @property
    def given(self) -> AnyPath | None:
        """The file that was given for the recipe in hand."""
        found = self.moved.get(self.option, ())
        return found[min(self.number, len(found) - 1)] if found else None

    def of(self, option: str, number: int = 0) -> RecipeFiles:
        """For a recipe inside the recipe."""
        return RecipeFiles(self.folder, self.moved, option, number)

    def find(self, source: str) -> AnyPath:
        """Where the file that a recipe calls `source` lies."""
        if self.given is not None:
            return self.given
        if is_address(source):
            return source
        for candidate in (source, self.folder / source, self.folder / Path(source).name):
            if Path(candidate).exists():
                return candidate
        raise FileError(
            f"the recipe starts from {source}, which is not here: give its place with --{self.option}"
        )


def rerun(
    path: AnyPath,
    *,
    exemplar: AnyPath | Sequence[AnyPath] | None = None,
    mask: AnyPath | None = None,
    fixed: AnyPath | None = None,
    known: AnyPath | None = None,
    target: AnyPath | None = None,
    model: AnyPath | None = None,
) -> Image:
    """Make a file's voxels again from the recipe in it.

    Parameters
    ----------
    path : path
    exemplar : path or sequence of path, optional
        Where the files that the recipe starts from lie now, if they have moved; several in the
        order of the exemplars.
    mask, fixed, known, target : path, optional
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
    parts = {"mask": mask, "fixed": fixed, "known": known, "target": target, "model": model}
    return replay(image.recipe, folder=folder, exemplar=exemplar, **parts)


def replay(
    recipe: Recipe,
    *,
    folder: Path,
    exemplar: AnyPath | Sequence[AnyPath] | None = None,
    **parts: AnyPath | None,
) -> Image:
    """Do the steps of a recipe, checking the voxels after each; paths as for `rerun`."""
    return _replayed(recipe, _places(folder, exemplar, parts))


def _places(
    folder: Path, exemplar: AnyPath | Sequence[AnyPath] | None, parts: Mapping[str, AnyPath | None]
) -> RecipeFiles:
    several = [exemplar] if isinstance(exemplar, (str, os.PathLike)) else list(exemplar or ())
    return RecipeFiles(
        folder,
        {"exemplar": several, **{name: [part] for name, part in parts.items() if part is not None}},
    )


def form_of(recipe: Recipe, *, folder: Path, mask: AnyPath | None = None) -> Image | None:
    """Make the form again that an image was made to fill, as its recipe tells; None where it tells
    of none.

    Parameters
    ----------
    recipe : Recipe
        Of the image.
    folder : Path
        Where the image lies.
    mask : path, optional
        Where the form's file lies now, if it has moved.

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
    return _replayed(Recipe.from_json(steps), _places(folder, None, {"mask": mask}).of("mask"))


@contextmanager
def _undamaged(verb: str) -> Iterator[None]:
    """The parameters come from a file, and anybody may have written it."""
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
            f"the recipe is damaged{doubt}: its step {verb!r} cannot be done again ({type(error).__name__}: {error})"
        ) from error


def asked(
    step: Mapping[str, Any],
    *,
    folder: Path,
    exemplar: AnyPath | Sequence[AnyPath] | None = None,
    **parts: AnyPath | None,
) -> tuple[Model, Request]:
    """The model and the request of a step "generate", which need not have been done; paths as for
    `rerun`.

    Raises
    ------
    InputError
        The step is of another verb, or damaged.
    NotReproducedError
        An exemplar or a part of the request is not what it was.
    """
    if step.get("verb") != "generate":
        raise InputError(f"there is nothing to generate in a step {step.get('verb')!r}")
    places = _places(folder, exemplar, parts)
    with _undamaged("generate"):
        return _model_again(step, places), _request_again(step, places)


def _replayed(recipe: Recipe, places: RecipeFiles) -> Image:
    image: Image | None = None
    for step in recipe.steps:
        check_name(step["verb"], _STEPS, name="step of a recipe")
        with _undamaged(step["verb"]):
            image = _STEPS[step["verb"]](image, step, places)
            same = digest(image.values) == step["sha256"]
        if not same:
            raise NotReproducedError(_difference(step))
    if image is None:
        raise InputError("the recipe is empty: there is nothing to do again")
    return image


def _difference(step: Mapping[str, Any]) -> str:
    what = step.get("source") or step.get("method") or step.get("operation") or step["verb"]
    made = ", ".join(
        f"{name} {number}" for name, number in dict(step.get("versions") or {}).items()
    )
    return (
        f"step {step['verb']!r} ({what}) gives other voxels than recorded: "
        f"the file has changed, or the versions ({made}) differ"
    )


def _read_again(image: Image | None, step: Mapping[str, Any], places: RecipeFiles) -> Image:
    return files.read(places.find(step["source"]), **step["options"])


def _array_again(image: Image | None, step: Mapping[str, Any], places: RecipeFiles) -> Image:
    if places.given is None:
        raise InputError(
            f"the recipe starts from an array in memory (SHA-256 {step['sha256'][:12]}): give it as a file with "
            f"--{places.option}"
        )
    return files.read(places.given)


def _voxelise_again(image: Image | None, step: Mapping[str, Any], places: RecipeFiles) -> Image:
    surface = _surface_again(step["mesh"], places)
    return voxelise(surface, spacing=step["spacing"], shape=step["shape"], origin=step["origin"])


def _surface_again(steps: Sequence[Mapping[str, Any]], places: RecipeFiles) -> Mesh:
    if not steps or steps[0]["verb"] != "read_mesh":
        raise InputError(
            "the recipe voxelises a surface that was in memory: nothing says how to make it again"
        )
    surface = read_mesh(places.find(steps[0]["source"]), unit=steps[0]["unit"])
    if digest(surface.vertices) != steps[0]["sha256"]:
        raise NotReproducedError(_difference(steps[0]))
    for step in steps[1:]:
        check_name(step["verb"], ("scale",), name="step of a surface's recipe")
        surface = scale_mesh(surface, step["factor"], unit=step["unit"])
    return surface


def _generate_again(image: Image | None, step: Mapping[str, Any], places: RecipeFiles) -> Image:
    return _model_again(step, places).generate(_request_again(step, places))


def _model_again(step: Mapping[str, Any], places: RecipeFiles) -> Model:
    """The model: from its file where it learned for long, else learned again."""
    named = step.get("model")
    if named is not None:
        path = _model_file(named, places.of("model"))
        if path is not None:
            return _same_model(load_model(path), named["sha256"], f"the model {path} is another")
        notify("the model was never in a file: learning again")
    sources = [
        _replayed(Recipe.from_json(steps), places.of("exemplar", number))
        for number, steps in enumerate(step["exemplars"])
    ]
    learner: Any = method(step["method"], **step["settings"])
    model: Model = learner.fit(**step["voxel"]) if "voxel" in step else learner.fit(sources)
    if named is not None:
        _same_model(
            model,
            named["sha256"],
            "learning again gave another model (its time, threads, machine or versions differ)",
        )
    return model


def _model_file(named: Mapping[str, Any], places: RecipeFiles) -> AnyPath | None:
    """Where a model lies: as given, beside the result, or shipped; None where it was never in a
    file.
    """
    if places.given is not None:
        return places.given
    if named["name"] is None:
        return None
    beside = places.folder / Path(named["name"]).name
    if beside.exists() or named["name"] in shipped():
        return beside if beside.exists() else named["name"]
    raise FileError(
        f"the recipe needs the model {named['name']} (SHA-256 {named['sha256'][:12]}), which is not here: give its place "
        "with --model"
    )


def _same_model(model: Model, sha256: str, otherwise: str) -> Model:
    if model.sha256 != sha256:
        raise NotReproducedError(
            f"{otherwise}: its SHA-256 is {model.sha256[:12]}, the recipe's {sha256[:12]}; give the right one with --model"
        )
    return model


def _request_again(step: Mapping[str, Any], places: RecipeFiles) -> Request:
    request = dict(step["request"])
    for name in PARTS:
        if name in request:
            request[name] = _replayed(Recipe.from_json(request[name]), places.of(name))
    request["target"] = {
        name: _replayed(Recipe.from_json(value), places.of("target"))
        if isinstance(value, list)
        else value
        for name, value in dict(request.get("target", {})).items()
    }
    return Request(**request)


def _finish_again(image: Image | None, step: Mapping[str, Any], places: RecipeFiles) -> Image:
    settings = dict(step["settings"])
    for steps in step.get("exemplars", ()):
        settings["exemplar"] = _replayed(Recipe.from_json(steps), places.of("exemplar"))
    if "mask" in step:
        settings["mask"] = _replayed(Recipe.from_json(step["mask"]), places.of("mask"))
    return finish.OPERATIONS[step["operation"]](_given(image), **settings)


def _field_again(image: Image | None, step: Mapping[str, Any], places: RecipeFiles) -> Image:
    settings = dict(step["settings"])
    if step["make"] in fields.FROM_AN_IMAGE:
        return fields.FROM_AN_IMAGE[step["make"]](_given(image), **settings)
    check_name(step["make"], fields.FROM_NOTHING, name="field of a recipe")
    return fields.FROM_NOTHING[step["make"]](**settings)


def _given(image: Image | None) -> Image:
    if image is None:
        raise InputError("the recipe is damaged: its first step needs an image that no step made")
    return image


_STEPS: dict[str, Callable[[Image | None, Mapping[str, Any], RecipeFiles], Image]] = {
    "read": _read_again,
    "array": _array_again,
    "sample": lambda image, step, places: sample(step["name"]),
    "voxelise": _voxelise_again,
    "crop": lambda image, step, places: crop(_given(image), step["size"], corner=step["corner"]),
    "slice": lambda image, step, places: _given(image)[indexing.from_json(step["index"])],
    "place": lambda image, step, places: place(
        _given(image),
        step["shape"],
        corner=step["corner"],
        plane=step.get("plane"),
        across=step.get("across", 1.0),
    ),
    "block": lambda image, step, places: block(step["size"], step["shape"], corner=step["corner"]),
    "declare": lambda image, step, places: declare_fields(_given(image), **step["fields"]),
    "segment": lambda image, step, places: segment(
        _given(image), step["threshold"], phases=step["phases"]
    ),
    "generate": _generate_again,
    "finish": _finish_again,
    "field": _field_again,
    "render": lambda image, step, places: render(
        _given(image),
        **{name: step[name] for name in ("look", "size", "phase", "camera", "cut", "threshold")},
    ),
}
