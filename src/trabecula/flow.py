"""The sentence, as functions: read, fit, generate, finish, verify, export. The only place that puts the stages together."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from trabecula import finish
from trabecula.core.checks import check_name
from trabecula.core.errors import FileError, InputError
from trabecula.core.image import Image, as_image, default_phases
from trabecula.core.progress import say
from trabecula.exemplar.crop import crop as cut_box
from trabecula.exemplar.place import block, place
from trabecula.exemplar.samples import sample
from trabecula.exemplar.segment import segment
from trabecula.io import files
from trabecula.io.formats import format_of, suffix_of, suffixes
from trabecula.io.units import has_length, to_metres
from trabecula.mesh.files import read_mesh, write_mesh
from trabecula.mesh.formats import FORMATS as SURFACES
from trabecula.mesh.surface import mesh
from trabecula.mesh.voxels import fitted, scaled, voxelise
from trabecula.replay import replay, rerun
from trabecula.report.certificate import verify
from trabecula.report.metric import Certificate
from trabecula.report.page import page
from trabecula.report.page import write_page as page_to_file
from trabecula.synth.registry import method
from trabecula.view.slices import montage
from trabecula.view.still import render

__all__ = ["check_target", "demo", "export", "load", "load_fixed", "load_like", "load_mask", "replay", "rerun"]

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


def load_like(
    source: str | os.PathLike[str], exemplar: Image, *, threshold: float | Sequence[float] | str = "auto"
) -> Image:
    """A result to be compared with an exemplar: a grey one is segmented where the exemplar has phases, and where its file
    states neither a spacing nor names of phases of its own (an outside program's, a plain array) it takes the
    exemplar's."""
    image = load(source, threshold="none")
    if image.kind == "grey" and exemplar.kind == "labels":
        image = load(source, threshold=threshold)
    given: dict[str, Any] = {}
    if image.unit == "voxel" and image.ndim == exemplar.ndim:
        given |= {"spacing": exemplar.spacing, "unit": exemplar.unit}
    if image.phases == default_phases(len(image.phases)) and len(exemplar.phases) >= len(image.phases):
        given |= {"phases": exemplar.phases}
    return replace(image, **given)


def load_mask(
    source: str | os.PathLike[str],
    exemplar: Image,
    *,
    shape: Sequence[int] | None = None,
    scale: float | None = None,
) -> Image:
    """A form to fill, for `Request.mask`: a closed surface in voxels of the exemplar's size, or a volume as it is.

    Parameters
    ----------
    source : path
        A surface (.stl, .ply, .obj, .3mf), or a volume of labels in which everything but void is filled.
    exemplar : Image, (Z, Y, X) or (Y, X)
        Its voxels are the mask's; of a picture, as deep as they are high.
    shape : sequence of int, optional
        Of a surface: the voxels that it is put into, scaled so that it just fits where no `scale` is given. Default: as
        many as it needs.
    scale : float, optional
        Factor on the surface's coordinates, which are lengths in the unit that its file states, else in the exemplar's.

    Raises
    ------
    InputError
        A surface that is not watertight or does not fit; a grey volume; a scale for a volume.
    FileError
        As `read` and `read_mesh`.
    """
    if Path(source).suffix.lower() not in SURFACES:
        if scale is not None:
            raise InputError(f"{os.fspath(source)} is a volume: a scale is for a surface ({', '.join(SURFACES)})")
        return load(source)
    surface = read_mesh(source)
    edges = exemplar.spacing if exemplar.ndim == 3 else (exemplar.spacing[0], *exemplar.spacing)
    if scale is None and shape is not None:
        surface = fitted(surface, shape=shape, spacing=edges, unit=exemplar.unit)
    else:
        both = has_length(surface.unit) and has_length(exemplar.unit)
        factor = to_metres(surface.unit) / to_metres(exemplar.unit) if both else 1.0
        surface = scaled(surface, (1.0 if scale is None else scale) * factor, unit=exemplar.unit)
    return voxelise(surface, spacing=edges, shape=shape)


def load_fixed(
    source: str | os.PathLike[str],
    exemplar: Image,
    *,
    shape: Sequence[int] | None = None,
    corner: Sequence[int] | None = None,
    known: str | os.PathLike[str] | None = None,
) -> tuple[Image, Image]:
    """A measured part, for `Request.fixed`, and where it is known, for `Request.known`.

    Parameters
    ----------
    source : path or str
        A scan. A grey one is cut at the exemplar's threshold; what its file does not state (spacing, unit, names of the
        phases) is taken from the exemplar.
    exemplar : Image
    shape : sequence of int, optional
        Voxels to be made in all; needed with `corner`.
    corner : sequence of int, optional
        Where in `shape` the first voxel of the scan lies; the whole scan is known, all around it is made.
    known : path, optional
        Instead of a corner, for a scan of the whole shape: a volume of labels, of which all but void is known.

    Raises
    ------
    InputError
        Neither corner nor known, or both; a scan that does not lie inside the shape; as `load`.
    """
    if (corner is None) == (known is None):
        raise InputError(
            "a fixed scan needs to be told where it is known: give either a volume of what is known (--known), or the "
            "corner at which the whole scan lies in the shape (--at)"
        )
    cuts = [step for step in exemplar.recipe.steps if step["verb"] == "segment"]
    scan = load_like(source, exemplar, threshold=cuts[-1]["threshold"] if cuts else "auto")
    if known is not None:
        return scan, load(known)
    if shape is None or corner is None:
        raise InputError("a scan at a corner needs a shape to lie in: give --shape")
    return place(scan, shape, corner=corner), block(scan.shape, shape, corner=corner)


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
