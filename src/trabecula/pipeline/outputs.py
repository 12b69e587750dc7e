"""Files that the steps write: where a result may go, and its export for other programs."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, check_name
from trabecula.core.errors import FileError, InputError
from trabecula.core.image import Image, as_image
from trabecula.engine.lazy_volume import Slabs
from trabecula.engine.storage import Remote, is_address, location_of, path_or_remote
from trabecula.engine.store import open_unfinished
from trabecula.io import files
from trabecula.io.formats import format_of, suffix_of, suffixes
from trabecula.io.lengths import with_lengths
from trabecula.mesh.beam_file import write_beams
from trabecula.mesh.beams import beam_lattice
from trabecula.mesh.decimate import decimate
from trabecula.mesh.files import write_mesh
from trabecula.mesh.formats import FORMATS as SURFACES
from trabecula.mesh.slabs import export_slabs
from trabecula.mesh.surface import mesh


def export(
    image: Image | Slabs | ArrayLike,
    path: str | os.PathLike[str],
    *,
    phase: str | int | None = None,
    spacing: float | Sequence[float] | None = None,
    unit: str | None = None,
    scale: float | None = None,
    beams: bool = False,
    tolerance: float | None = None,
) -> Path | Remote:
    """Write an image for another program: the closed surface of a phase, or the voxels.

    Parameters
    ----------
    image : Image or array of labels, or Slabs
        Of `Slabs` the surface is written slab by slab, as .stl alone.
    path : path
        The suffix chooses: a surface for .stl, .3mf, .ply and .obj, voxels for the formats of
        `trabecula.io.formats`.
    phase : str or int, optional
        The phase whose surface is taken. Default: every phase but "void".
    spacing, unit : optional
        Edge of a voxel, one number or one per axis (z, y, x), and its unit, where the image does
        not state them or they should be others. A surface whose unit is "voxel" is written in
        millimetres, with a notice (`write_mesh`).
    scale : float, optional
        Factor on all lengths: 10 makes the part ten times as large.
    beams : bool
        Write beams along the skeleton instead of a surface, as .3mf (`mesh.beams`): a small file
        that one can edit, right for struts and not for plates.
    tolerance : float, optional
        Decimate the surface: fewer triangles, nowhere farther from it than so many voxels (of their
        shortest edge). Default: all triangles.

    Returns
    -------
    Path, or Remote at an address

    Raises
    ------
    UnknownNameError
        A suffix that is neither a surface's nor a volume's; an unknown unit.
    InputError, FileError
        As `mesh`, `write_mesh` and `write`; a spacing or scale that is not above 0.
    """
    check_target(path, surfaces=True)
    if beams and (isinstance(image, Slabs) or Path(path).suffix.lower() != ".3mf"):
        raise InputError("beams are made of a volume in memory, and written as .3mf; name it so")
    if tolerance is not None:
        tolerance = as_number(tolerance, name="tolerance", low=1e-3, high=100)
        if beams or isinstance(image, Slabs):
            raise InputError("a tolerance is for a surface in memory: leave it out, or beams")
    lengths: dict[str, Any] = {"spacing": spacing, "unit": unit, "scale": scale}
    if isinstance(image, Slabs):
        export_slabs(with_lengths(image, **lengths), path, phase=phase)
        return Path(path)
    image = with_lengths(as_image(image), **lengths)
    if beams:
        return write_beams(beam_lattice(image, phase=phase), path)
    if Path(path).suffix.lower() in SURFACES:
        surface = mesh(image, phase=phase)
        if tolerance is not None:
            surface = decimate(surface, tolerance * min(image.spacing))
        return write_mesh(surface, path)
    if tolerance is not None:
        raise InputError(f"{path} holds voxels, a tolerance is for a surface: leave it out")
    return files.write(image, path)


def check_target(
    path: str | os.PathLike[str], *, surfaces: bool = False, size: int = 0, resumes: bool = False
) -> None:
    """Raise before any work is done where a result cannot be written.

    Parameters
    ----------
    path : path or address
    surfaces : bool
        Accept the suffixes of surfaces as well.
    size : int
        Bytes that are needed.
    resumes : bool
        The run resumes an unfinished store at an address; without it that place must be free.

    Raises
    ------
    UnknownNameError
        An unknown suffix.
    InputError, FileError
        The place cannot be written, is taken, or has too little room.
    """
    target, text = path_or_remote(path), os.fspath(path)
    if isinstance(target, Remote):
        files.check_stored(target)
        target.check_writable()
        if not resumes or open_unfinished(target) is None:
            target.check_free()
        return
    suffix = suffix_of(text) or target.suffix.lower()
    is_folder = True
    if suffix or not text.endswith(("/", os.sep)):
        known = {**suffixes(), **(SURFACES if surfaces else {})}
        if not suffix:
            format_of(text)  # raises: there is none
        check_name(suffix, known, name="format")
        is_folder = suffix not in SURFACES and suffixes()[suffix].folder
    if not is_folder and target.is_dir():
        raise FileError(f"cannot write {path}: a folder of that name is there; choose another name")
    if is_folder and target.exists() and not target.is_dir():
        raise FileError(
            f"cannot write {path}: a file of that name is there; choose another name, or remove it"
        )
    check_folder(path, size=size)


def check_folder(path: str | os.PathLike[str], *, size: int = 0) -> None:
    """Raise where the folder of `path` is no folder, cannot be written, or lacks `size` bytes."""
    if is_address(path):
        raise InputError(
            f"cannot write {path}: only a .zarr is written to an address; write a file, "
            "and copy it there"
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
            f"cannot write {path}: about {size >> 20} MiB are needed, {free >> 20} MiB are free "
            f"in {folder}"
        )
