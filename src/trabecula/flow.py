"""The sentence, as functions: read, fit, generate, finish, verify, export. The only place that puts the stages together."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from trabecula import finish
from trabecula.core.checks import check_name
from trabecula.core.errors import FileError, InputError, NotReproducedError, TrabeculaError
from trabecula.core.image import Image, as_image, default_phases
from trabecula.core.progress import say
from trabecula.core.recipe import Recipe, digest
from trabecula.core.request import Request
from trabecula.exemplar.crop import crop as cut_box
from trabecula.exemplar.samples import sample
from trabecula.exemplar.segment import segment
from trabecula.io import files
from trabecula.io.formats import format_of, suffix_of, suffixes
from trabecula.mesh.files import write_mesh
from trabecula.mesh.formats import FORMATS as SURFACES
from trabecula.mesh.surface import mesh
from trabecula.report.certificate import verify
from trabecula.report.metric import Certificate
from trabecula.report.page import page
from trabecula.report.page import write_page as page_to_file
from trabecula.synth.registry import method
from trabecula.view.slices import montage
from trabecula.view.still import render

SAMPLE_PREFIX = "sample:"


def load(
    source: str | os.PathLike[str],
    *,
    crop: int | Sequence[int] | None = None,
    threshold: float | Sequence[float] | str | None = None,
    **reading: Any,
) -> Image:
    """An image from a file or from `sample:NAME`, segmented and cropped where asked.

    Parameters
    ----------
    source : path or str
    crop : int or sequence of int, optional
        Size of a central box to keep, voxels.
    threshold : float, pair of float, "otsu", "dual", "auto" or "none", optional
        Segment a grey image (see `segment`). "auto" is Otsu's, and leaves an image that is not grey as it is; "none"
        leaves a grey one grey.
    **reading
        kind, spacing, unit, phases: as in `read`. Where a grey image is segmented, `phases` names the two labels.
    """
    name = os.fspath(source)
    phases = reading.pop("phases", None)
    if name.startswith(SAMPLE_PREFIX):
        if reading or phases:
            raise InputError(f"{name} comes with its spacing, unit and phases: give none")
        image = sample(name.removeprefix(SAMPLE_PREFIX))
    else:
        image = files.read(name, **reading) if phases is None else _read_with_phases(name, phases, reading)
    if image.kind == "grey" and threshold not in (None, "none"):
        image = segment(image, "otsu" if threshold == "auto" else threshold, phases=phases or ("void", "solid"))
        found = image.recipe.steps[-1]["threshold"]
        if isinstance(threshold, str):
            say(f"{name} is grey: threshold {found} found (--threshold chooses another)")
    elif threshold not in (None, "auto", "none"):
        raise InputError(
            f"{name} holds {image.kind}, a threshold is for grey images: leave --threshold out, or give --kind grey"
        )
    # After the threshold was found, so that it is the whole scan's and every crop of it is cut at the same level.
    return image if crop is None else cut_box(image, crop)


def _read_with_phases(name: str, phases: Sequence[str], reading: Mapping[str, Any]) -> Image:
    """A grey file is read without names: they are for the labels that a threshold makes of it."""
    plain = files.read(name, **reading)
    return plain if plain.kind == "grey" else files.read(name, phases=phases, **reading)


def load_like(source: str | os.PathLike[str], exemplar: Image) -> Image:
    """A result to be compared with an exemplar: a grey one is segmented where the exemplar has phases, and where its file
    states neither a spacing nor names of phases of its own (an outside program's, a plain array) it takes the
    exemplar's."""
    image = load(source, threshold="auto" if exemplar.kind == "labels" else "none")
    given: dict[str, Any] = {}
    if image.unit == "voxel" and image.ndim == exemplar.ndim:
        given |= {"spacing": exemplar.spacing, "unit": exemplar.unit}
    if image.phases == default_phases(len(image.phases)) and len(exemplar.phases) >= len(image.phases):
        given |= {"phases": exemplar.phases}
    return replace(image, **given)


def check_page(path: str | os.PathLike[str]) -> None:
    """Raise before any work is done where a page cannot be written to `path`."""
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise InputError(f"a report is a page, {path} should end in .html")
    if Path(path).is_dir():
        raise FileError(f"cannot write {path}: a folder of that name is there; choose another name")
    check_folder(path)


def write_page(
    path: str | os.PathLike[str], exemplar: Image, images: Sequence[Image], certificates: Sequence[Certificate]
) -> None:
    """The certificates as one page, with slices and stills of the exemplar and of what was judged."""
    names = ["exemplar", *(certificate.name for certificate in certificates)]
    shown = [exemplar, *images]
    pictures = [("Slices through the middle" if exemplar.ndim == 3 else "Images", _png(montage(shown, names)))]
    if exemplar.ndim == 3 and exemplar.kind == "labels":
        pictures += [(name, _png(render(image, size=(640, 480)))) for name, image in zip(names, shown, strict=True)]
    page_to_file(page(certificates, pictures=pictures), Path(path))


def _png(picture: Image) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        return files.write(picture, Path(folder) / "picture.png").read_bytes()


def export(image: Image | ArrayLike, path: str | os.PathLike[str], *, phase: str | int | None = None) -> Path:
    """Write an image for another program: the closed surface of a phase (.stl, .3mf, .ply, .obj) or the voxels.

    Parameters
    ----------
    image : Image or array of labels
    path : path
        The suffix chooses.
    phase : str or int, optional
        Of which phase the surface is taken. Default: every phase but "void".

    Raises
    ------
    UnknownNameError
        A suffix that is neither a surface's nor a volume's.
    InputError, FileError
        As `mesh`, `write_mesh` and `write`.
    """
    check_target(path, surfaces=True)
    if Path(path).suffix.lower() in SURFACES:
        return write_mesh(mesh(image, phase=phase), path)
    return files.write(as_image(image), path)


def check_target(path: str | os.PathLike[str], *, surfaces: bool = False, size: int = 0) -> None:
    """Raise before any work is done where `path` has an unknown suffix, cannot be written, or has no room for `size` bytes."""
    target, text = Path(path), os.fspath(path)
    suffix = suffix_of(text) or target.suffix.lower()
    if suffix or not text.endswith(("/", os.sep)):
        known = {**suffixes(), **(SURFACES if surfaces else {})}
        if not suffix:
            format_of(text)  # which says that there is none
        check_name(suffix, known, name="format")
        a_folder = suffix not in SURFACES and suffixes()[suffix].folder
    else:
        a_folder = True
    if not a_folder and target.is_dir():
        raise FileError(f"cannot write {path}: a folder of that name is there; choose another name")
    if a_folder and target.exists() and not target.is_dir():
        raise FileError(f"cannot write {path}: a file of that name is there; choose another name, or remove it")
    check_folder(path, size=size)


def check_folder(path: str | os.PathLike[str], *, size: int = 0) -> None:
    """Raise where the folder of `path` is no folder, cannot be written, or has no room for `size` bytes."""
    folder = Path(path).absolute().parent
    while not folder.exists():
        folder = folder.parent
    if not folder.is_dir():
        raise FileError(f"cannot write {path}: {folder} is a file, not a folder; choose another place")
    if not os.access(folder, os.W_OK):
        raise FileError(f"cannot write {path}: no right to write into {folder}; choose another place")
    free = shutil.disk_usage(folder).free
    if free < size:
        raise FileError(
            f"cannot write {path}: about {size >> 20} MiB are needed, {free >> 20} MiB are free in {folder}"
        )


def demo(folder: str | os.PathLike[str], *, shape: int = 120, seed: int = 7) -> Certificate:
    """The main job on `sample:bone`: a larger volume, connected, with a certificate, a surface, a still and slices.

    Leaves exemplar.zarr, bone.zarr, part.zarr, part.stl, part.png, slices.png and report.html in `folder`.
    """
    out = Path(folder)
    check_folder(out / "report.html", size=200 << 20)
    exemplar = sample("bone")
    material = method("texture").fit(exemplar).generate(shape, seed=seed)
    part = finish.connect(material)
    for image, name in ((exemplar, "exemplar.zarr"), (material, "bone.zarr"), (part, "part.zarr")):
        files.write(image, out / name)
    say(f"surface: {export(part, out / 'part.stl')}")
    render(part, out / "part.png")
    montage([exemplar, part], ["exemplar", "part"], out / "slices.png")
    verdict = verify(exemplar, part, names=["part.zarr"])
    write_page(out / "report.html", exemplar, [part], [verdict])
    return verdict


def rerun(path: str | os.PathLike[str], *, exemplar: str | os.PathLike[str] | None = None) -> Image:
    """Make a file's voxels again from the recipe in it.

    Parameters
    ----------
    path : path
    exemplar : path, optional
        Where the file that the recipe starts from lies now, if it has moved.

    Raises
    ------
    InputError
        The file holds no recipe, or one that starts from an array in memory.
    NotReproducedError
        A step gave other voxels than the recipe says (another exemplar, another version), or the file's own voxels are
        not the recipe's.
    """
    image = files.read(path)
    steps = image.recipe.steps
    if not steps or [step["verb"] for step in steps] == ["read"]:
        raise InputError(f"{path} holds no recipe: it was not made by this package, or its metadata is lost")
    # Before any work: the last step recorded the digest that its replay would have to meet as well.
    if digest(image.values) != steps[-1].get("sha256"):
        raise NotReproducedError(f"{path} does not hold what its recipe makes: its voxels were changed since")
    return replay(image.recipe, folder=Path(path).absolute().parent, exemplar=exemplar)


def replay(recipe: Recipe, *, folder: Path, exemplar: str | os.PathLike[str] | None = None) -> Image:
    """Do the steps of a recipe, checking the voxels after each."""
    image: Image | None = None
    for step in recipe.steps:
        check_name(step["verb"], _STEPS, name="step of a recipe")
        try:
            image = _STEPS[step["verb"]](image, step, folder, exemplar)
            same = digest(image.values) == step["sha256"]
        except TrabeculaError:
            raise
        except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
            # The parameters come from a file, and anybody may have written it.
            raise InputError(
                f"the recipe is damaged: its step {step['verb']!r} cannot be done again "
                f"({type(error).__name__}: {error})"
            ) from error
        if not same:
            raise NotReproducedError(_difference(step))
    if image is None:
        raise InputError("the recipe is empty: there is nothing to do again")
    return image


def _difference(step: Mapping[str, Any]) -> str:
    what = step.get("source") or step.get("method") or step.get("operation") or step["verb"]
    made = ", ".join(f"{name} {number}" for name, number in dict(step.get("versions") or {}).items())
    return (
        f"step {step['verb']!r} ({what}) gives other voxels than recorded: "
        f"the file has changed, or the versions ({made}) differ"
    )


def _read_again(image: Image | None, step: Mapping[str, Any], folder: Path, exemplar: Any) -> Image:
    if exemplar is not None:
        return files.read(exemplar, **step["options"])
    candidates = [step["source"], folder / step["source"], folder / Path(step["source"]).name]
    for candidate in candidates:
        if Path(candidate).exists():
            return files.read(candidate, **step["options"])
    raise FileError(f"the recipe starts from {step['source']}, which is not here: give its place with --exemplar")


def _array_again(image: Image | None, step: Mapping[str, Any], folder: Path, exemplar: Any) -> Image:
    if exemplar is None:
        raise InputError(
            f"the recipe starts from an array in memory (SHA-256 {step['sha256'][:12]}): give it as a file with --exemplar"
        )
    return files.read(exemplar)


def _generate_again(image: Image | None, step: Mapping[str, Any], folder: Path, exemplar: Any) -> Image:
    sources = [replay(Recipe.from_json(steps), folder=folder, exemplar=exemplar) for steps in step["exemplars"]]
    model = method(step["method"], **step["settings"]).fit(sources[0])
    return model.generate(Request(**step["request"]))


def _given(image: Image | None) -> Image:
    if image is None:
        raise InputError("the recipe is damaged: its first step needs an image that no step made")
    return image


_STEPS: dict[str, Callable[[Image | None, Mapping[str, Any], Path, Any], Image]] = {
    "read": _read_again,
    "array": _array_again,
    "sample": lambda image, step, folder, exemplar: sample(step["name"]),
    "crop": lambda image, step, folder, exemplar: cut_box(_given(image), step["size"], corner=step["corner"]),
    "segment": lambda image, step, folder, exemplar: segment(_given(image), step["threshold"], phases=step["phases"]),
    "generate": _generate_again,
    "finish": lambda image, step, folder, exemplar: finish.OPERATIONS[step["operation"]](
        _given(image), **step["settings"]
    ),
    "render": lambda image, step, folder, exemplar: render(
        _given(image), **{name: step[name] for name in ("look", "size", "phase", "camera", "cut", "threshold")}
    ),
}
