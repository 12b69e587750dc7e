"""The sentence, as functions: read, fit, generate, finish, verify, export. The only place that puts
the stages together.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from trabecula import finish
from trabecula.core.checks import check_name
from trabecula.core.errors import FileError, InputError
from trabecula.core.image import Image, as_image
from trabecula.core.progress import notify
from trabecula.engine.lazy_volume import Slabs
from trabecula.engine.storage.location import Remote, is_address, location_of, path_or_remote
from trabecula.engine.store import open_unfinished
from trabecula.exemplar.samples import sample
from trabecula.io import files
from trabecula.io.formats import format_of, suffix_of, suffixes
from trabecula.io.lazy import slabs_if_large, volume_shape
from trabecula.io.lengths import with_lengths
from trabecula.mesh.files import write_mesh
from trabecula.mesh.formats import FORMATS as SURFACES
from trabecula.mesh.slabs import export_slabs
from trabecula.mesh.surface import mesh
from trabecula.pipeline.generate import generate_to, plan_to
from trabecula.pipeline.inputs import (
    load,
    load_fixed,
    load_like,
    load_mask,
    slabs_like_if_large,
    voxels_of,
)
from trabecula.pipeline.replay import form_of, replay, rerun
from trabecula.pipeline.resume import resume
from trabecula.report.certificate import verify
from trabecula.report.metric import Certificate
from trabecula.report.page import page
from trabecula.report.page import write_page as page_to_file
from trabecula.synth.api.registry import method
from trabecula.view.slices import montage
from trabecula.view.still import render

__all__ = [
    "check_target",
    "demo",
    "export",
    "form_of",
    "generate_to",
    "load",
    "load_fixed",
    "load_like",
    "load_mask",
    "plan_to",
    "replay",
    "rerun",
    "resume",
    "slabs_if_large",
    "slabs_like_if_large",
    "volume_shape",
    "voxels_of",
    "with_lengths",
]


def check_page(path: str | os.PathLike[str]) -> None:
    """Raise before any work is done where a page cannot be written to `path`."""
    if Path(path).suffix.lower() not in (".html", ".htm"):
        raise InputError(f"a report is a page, {path} should end in .html")
    if Path(path).is_dir():
        raise FileError(f"cannot write {path}: a folder of that name is there; choose another name")
    check_folder(path)


def write_page(
    path: str | os.PathLike[str],
    exemplar: Image | Sequence[Image],
    images: Sequence[Image | Slabs],
    certificates: Sequence[Certificate],
) -> None:
    """The certificates as one page, with slices and stills of the exemplars and of what was judged;
    of a volume in slabs of a box in its middle."""
    exemplars = [exemplar] if isinstance(exemplar, Image) else list(exemplar)
    numbers = [""] if len(exemplars) == 1 else [f" {n}" for n in range(1, len(exemplars) + 1)]
    results = [certificate.name for certificate in certificates]
    names = [f"exemplar{number}" for number in numbers] + results
    shown = [*exemplars, *(_shown(image) for image in images)]
    title = "Slices through the middle" if images[0].ndim == 3 else "Images"
    pictures = [(title, _png(montage(shown, names)))]
    pictures += [
        (name, _png(render(image, size=(640, 480))))
        for name, image in zip(names, shown, strict=True)
        if image.ndim == 3 and image.kind == "labels"
    ]
    page_to_file(page(certificates, pictures=pictures), Path(path))


def _shown(image: Image | Slabs) -> Image:
    return (
        image.centre([min(side, 256) for side in image.shape])
        if isinstance(image, Slabs)
        else image
    )


def _png(picture: Image) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.png"
        files.write(picture, path)
        return path.read_bytes()


def export(
    image: Image | Slabs | ArrayLike,
    path: str | os.PathLike[str],
    *,
    phase: str | int | None = None,
    spacing: float | Sequence[float] | None = None,
    unit: str | None = None,
    scale: float | None = None,
) -> Path | Remote:
    """Write an image for another program: the closed surface of a phase (.stl, .3mf, .ply, .obj) or
    the voxels.

    Parameters
    ----------
    image : Image or array of labels, or Slabs
        Of `Slabs` the surface is written slab by slab, as .stl alone.
    path : path
        The suffix chooses.
    phase : str or int, optional
        Of which phase the surface is taken. Default: every phase but "void".
    spacing, unit : optional
        Edge of a voxel, one number or one per axis (z, y, x), and its unit, where the image does
        not know them or they should be others. A surface whose unit is "voxel" is written as
        millimetres, which is said (`write_mesh`).
    scale : float, optional
        Factor on all lengths: 10 makes the part ten times as large.

    Raises
    ------
    UnknownNameError
        A suffix that is neither a surface's nor a volume's; an unknown unit.
    InputError, FileError
        As `mesh`, `write_mesh` and `write`; a spacing or scale that is not above 0.
    """
    check_target(path, surfaces=True)
    lengths: dict[str, Any] = {"spacing": spacing, "unit": unit, "scale": scale}
    if isinstance(image, Slabs):
        export_slabs(with_lengths(image, **lengths), path, phase=phase)
        return Path(path)
    image = with_lengths(as_image(image), **lengths)
    if Path(path).suffix.lower() in SURFACES:
        return write_mesh(mesh(image, phase=phase), path)
    return files.write(image, path)


def check_target(
    path: str | os.PathLike[str], *, surfaces: bool = False, size: int = 0, goes_on: bool = False
) -> None:
    """Raise before any work is done where `path` has an unknown suffix, cannot be written, or has
    no room for `size` bytes; at an address also where something is there, unless a run `goes_on`
    with it."""
    target, text = path_or_remote(path), os.fspath(path)
    if isinstance(target, Remote):
        files.check_stored(target)
        target.check_writable()
        if not goes_on or open_unfinished(target) is None:
            target.check_free()
        return
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
        raise FileError(
            f"cannot write {path}: a file of that name is there; choose another name, or remove it"
        )
    check_folder(path, size=size)


def check_folder(path: str | os.PathLike[str], *, size: int = 0) -> None:
    """Raise where the folder of `path` is no folder, cannot be written, or has no room for `size`
    bytes.
    """
    if is_address(path):
        raise InputError(
            f"cannot write {path}: only a .zarr is written to an address; write a file, and copy it there"
        )
    folder = location_of(path).folder
    while not folder.exists():
        folder = folder.parent
    if not folder.is_dir():
        raise FileError(
            f"cannot write {path}: {folder} is a file, not a folder; choose another place"
        )
    if not os.access(folder, os.W_OK):
        raise FileError(
            f"cannot write {path}: no right to write into {folder}; choose another place"
        )
    free = shutil.disk_usage(folder).free
    if free < size:
        raise FileError(
            f"cannot write {path}: about {size >> 20} MiB are needed, {free >> 20} MiB are free in {folder}"
        )


def demo(folder: str | os.PathLike[str], *, shape: int = 120, seed: int = 7) -> Certificate:
    """The main job on `sample:bone`: a larger volume, connected, with a certificate, a surface, a
    still and slices.

    Leaves exemplar.zarr, bone.zarr, part.zarr, part.stl, part.png, slices.png and report.html in
    `folder`.
    """
    out = Path(folder)
    check_folder(out / "report.html", size=200 << 20)
    exemplar = sample("bone")
    material = method("texture").fit(exemplar).generate(shape, seed=seed)
    part = finish.connect(material)
    for image, name in ((exemplar, "exemplar.zarr"), (material, "bone.zarr"), (part, "part.zarr")):
        files.write(image, out / name)
    notify(f"surface: {export(part, out / 'part.stl')}")
    render(part, out / "part.png")
    montage([exemplar, part], ["exemplar", "part"], out / "slices.png")
    verdict = verify(exemplar, part, names=["part.zarr"])
    write_page(out / "report.html", exemplar, [part], [verdict])
    return verdict
