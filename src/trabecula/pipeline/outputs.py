"""Files that the steps write: where a result may go, and its export for other programs."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, check_name
from trabecula.core.errors import FileError, InputError
from trabecula.core.image import Image, as_image
from trabecula.engine.lazy_volume import Slabs, as_slabs
from trabecula.engine.storage import Remote, is_address, location_of, path_or_remote
from trabecula.engine.store import open_unfinished
from trabecula.io import files
from trabecula.io.formats import format_of, suffix_of, suffixes
from trabecula.io.lengths import with_lengths
from trabecula.mesh.base import Mesh
from trabecula.mesh.beam_file import write_beams
from trabecula.mesh.beams import beam_lattice
from trabecula.mesh.bricks.export import DEFAULT_MODULI, Moduli, export_bricks
from trabecula.mesh.bricks.formats import FORMATS as BRICKS
from trabecula.mesh.decimate import decimate
from trabecula.mesh.files import write_mesh, write_parts
from trabecula.mesh.formats import FORMATS as SURFACES
from trabecula.mesh.formats import SurfaceFormat
from trabecula.mesh.slabs import export_slabs
from trabecula.mesh.surface import mesh
from trabecula.mesh.tetrahedra.export import SUFFIXES as TETRAHEDRA
from trabecula.mesh.tetrahedra.export import write_tetrahedra
from trabecula.mesh.tetrahedra.make import tetrahedra as make_tetrahedra


def export(
    image: Image | Slabs | ArrayLike,
    path: str | os.PathLike[str],
    *,
    phase: str | int | Sequence[str | int] | None = None,
    spacing: float | Sequence[float] | None = None,
    unit: str | None = None,
    scale: float | None = None,
    beams: bool = False,
    tolerance: float | None = None,
    tetrahedra: float | None = None,
    case: str | None = None,
    axis: str | None = None,
    strain: float | None = None,
    moduli: Moduli | None = None,
) -> Path | Remote:
    """Write an image for another program: the closed surface of a phase, bricks for a solver, or
    the voxels.

    Parameters
    ----------
    image : Image or array of labels, or Slabs
        Of `Slabs` the surface is written slab by slab, as .stl alone; bricks in any format.
    path : path
        The suffix chooses: a surface for .stl, .3mf, .ply and .obj; bricks for .inp (Abaqus,
        CalculiX), .vtu, .msh and .foam (a folder with an OpenFOAM case); voxels for the formats of
        `trabecula.io.formats`.
    phase : str or int, optional
        The phase whose surface is taken; of bricks and .3mf also several. Default: every phase but
        "void"; of .foam "void".
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
    tetrahedra : float, optional
        Tetrahedra with smooth interfaces instead of bricks, in a lattice of cells with so many
        voxels a side (`tb.tetrahedra`): of .vtu, .msh and .inp, without a load case.
    case : {"compression", "shear", "periodic"}, optional
        Load case, of .inp.
    axis : {"z", "y", "x"}, optional
        Of the load case, or of the flow of .foam. Default: "z".
    strain : float, optional
        Of the load case, 1e-9 .. 1. Default: 0.01.
    moduli : (E, nu), or mapping from the name of a phase to (E, nu), optional
        Young's modulus and Poisson's ratio, of .inp. Default: (1, 0.3).

    Returns
    -------
    Path, or Remote at an address

    Raises
    ------
    UnknownNameError
        A suffix of no format; an unknown unit, case or axis.
    InputError, FileError, MemoryBudgetError
        As `mesh`, `write_mesh`, `write` and `mesh.bricks.export.export_bricks`; a spacing or scale
        that is not above 0; a load case where there are no bricks.
    """
    check_target(path, surfaces=True)
    check_surface_options(path, beams=beams, tolerance=tolerance)
    check_tetrahedra(path, tetrahedra, case=case)
    if isinstance(image, Slabs) and (beams or tolerance is not None):
        raise InputError("beams and decimated surfaces are made of a volume in memory: read it")
    lengths: dict[str, Any] = {"spacing": spacing, "unit": unit, "scale": scale}
    given = {"case": case, "axis": axis, "strain": strain, "moduli": moduli}
    bricks: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if tetrahedra is not None:
        if isinstance(image, Slabs):
            raise InputError("tetrahedra are made of a volume in memory: read it")
        image = with_lengths(as_image(image), **lengths)
        found = make_tetrahedra(image, edge=tetrahedra, phases=phase)
        return write_tetrahedra(found, path, moduli=DEFAULT_MODULI if moduli is None else moduli)
    if Path(path).suffix.lower() in BRICKS:
        slabs = image if isinstance(image, Slabs) else as_slabs(as_image(image))
        export_bricks(with_lengths(slabs, **lengths), path, phases=phase, **bricks)
        return Path(path)
    check_no_bricks(path, phase, bricks)
    if phase is not None and not isinstance(phase, (str, int)):
        if beams or isinstance(image, Slabs):
            raise InputError("several phases are written from a volume in memory, as surfaces")
        image = with_lengths(as_image(image), **lengths)
        return write_parts({str(one): _surface(image, one, tolerance) for one in phase}, path)
    if isinstance(image, Slabs):
        export_slabs(with_lengths(image, **lengths), path, phase=phase)
        return Path(path)
    image = with_lengths(as_image(image), **lengths)
    if beams:
        return write_beams(beam_lattice(image, phase=phase), path)
    if Path(path).suffix.lower() in SURFACES:
        return write_mesh(_surface(image, phase, tolerance), path)
    return files.write(image, path)


def _surface(image: Image, phase: str | int | None, tolerance: float | None) -> Mesh:
    """Return the surface of a phase, decimated where a tolerance in voxels is given."""
    surface = mesh(image, phase=phase)
    return surface if tolerance is None else decimate(surface, tolerance * min(image.spacing))


def check_surface_options(
    path: str | os.PathLike[str], *, beams: bool, tolerance: float | None
) -> None:
    """Raise where beams or a tolerance are given for another format, or for each other.

    Raises
    ------
    InputError
        Beams in another file than .3mf, a tolerance out of range, or for voxels, bricks or beams.
    """
    name, suffix = Path(path).name, Path(path).suffix.lower()
    if beams and suffix != ".3mf":
        raise InputError(f"{name} holds no beams: they are written as .3mf; name it so")
    if tolerance is None:
        return
    as_number(tolerance, name="tolerance", low=1e-3, high=100)
    if beams or suffix not in SURFACES:
        what = "beams" if beams else "voxels"
        raise InputError(f"{name} holds {what}, a tolerance is for a surface: leave it out")


def check_tetrahedra(
    path: str | os.PathLike[str], edge: float | None, *, case: str | None = None
) -> None:
    """Raise where tetrahedra cannot be written.

    Raises
    ------
    InputError
        Another format, or a load case.
    """
    if edge is None:
        return
    if Path(path).suffix.lower() not in TETRAHEDRA:
        raise InputError(
            f"{Path(path).name} holds no tetrahedra: write {', '.join(TETRAHEDRA)}, or leave "
            "tetrahedra out"
        )
    if case is not None:
        raise InputError("a load case is for bricks: leave out tetrahedra, or the case")


def check_no_bricks(
    path: str | os.PathLike[str],
    phase: str | int | Sequence[str | int] | None,
    options: Mapping[str, Any],
) -> None:
    """Raise where options of bricks are given for a surface or for voxels.

    Raises
    ------
    InputError
        A load case or several phases.
    """
    if options:
        raise InputError(
            f"{', '.join(options)} {'are' if len(options) > 1 else 'is'} for bricks: write "
            f"{', '.join(BRICKS)}, not {Path(path).name}"
        )
    if phase is None or isinstance(phase, (str, int)):
        return
    if Path(path).suffix.lower() != ".3mf":
        raise InputError(
            f"{len(phase)} phases are named, and {Path(path).name} holds one: name one, or write "
            f".3mf, or bricks ({', '.join(BRICKS)})"
        )


def check_target(
    path: str | os.PathLike[str], *, surfaces: bool = False, size: int = 0, resumes: bool = False
) -> None:
    """Raise before any work is done where a result cannot be written.

    Parameters
    ----------
    path : path or address
    surfaces : bool
        Accept the suffixes of surfaces and of bricks as well.
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
        known: dict[str, Any] = {**suffixes(), **({**SURFACES, **BRICKS} if surfaces else {})}
        if not suffix:
            format_of(text)  # raises: there is none
        check_name(suffix, known, name="format")
        form = known[suffix]
        is_folder = not isinstance(form, SurfaceFormat) and form.folder
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
