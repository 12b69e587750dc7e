"""`read_mesh` and `write_mesh`: the suffix names the format."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import replace
from os import PathLike, fspath
from pathlib import Path

from trabecula.core.checks import as_path_text
from trabecula.core.errors import FileError, InputError
from trabecula.core.recipe import Recipe
from trabecula.engine.files import replacing
from trabecula.io.guard import check_there, report_damage
from trabecula.io.units import canonical, check_unit
from trabecula.mesh.base import Mesh
from trabecula.mesh.formats import READABLE, surface_format
from trabecula.mesh.sizes import extent_of, notify_size


def write_mesh(mesh: Mesh, path: str | PathLike[str]) -> Path:
    """Write a mesh; the file appears whole or not at all.

    Parameters
    ----------
    mesh : Mesh
    path : path
        `.stl` (millimetres where the unit is a length), `.3mf` (the unit is declared), `.ply` or
        `.obj` (in the mesh's unit, named in a comment). Programs take lengths without a unit for
        millimetres: a mesh in "voxel" is written so, with a notice, as is a part of more than 2 m
        or less than 0.1 mm.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        An unknown suffix, or a mesh without faces.
    FileError
        The file cannot be written.
    """
    path = Path(as_path_text(path))
    form = surface_format(path)
    if not len(mesh.faces):
        raise InputError("the mesh has no faces: there is nothing to write")
    with replacing(path) as temporary:
        form.member("write")(mesh, temporary)
    notify_size(extent_of(mesh), mesh.unit)
    return path


def write_parts(parts: Mapping[str, Mesh], path: str | PathLike[str]) -> Path:
    """Write several surfaces, each with a material of its name, as objects of one part.

    Parameters
    ----------
    parts : mapping of str to Mesh
        Name -> surface; of one unit.
    path : path
        `.3mf`.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        Another suffix, surfaces of different units, or one without faces.
    FileError
        The file cannot be written.
    """
    path = Path(as_path_text(path))
    if path.suffix.lower() != ".3mf":
        raise InputError(f"{path}: several parts are written as .3mf alone; name it so")
    units = {mesh.unit for mesh in parts.values()}
    if len(units) != 1 or not all(len(mesh.faces) for mesh in parts.values()):
        raise InputError("several parts need one unit, and faces each: there is nothing to write")
    with replacing(path) as temporary:
        surface_format(path).member("write_parts")(parts, temporary)
    extent = tuple(max(sides) for sides in zip(*map(extent_of, parts.values()), strict=True))
    notify_size(extent, units.pop())
    return path


def read_mesh(path: str | PathLike[str], *, unit: str | None = None) -> Mesh:
    """Read a surface.

    Parameters
    ----------
    path : path
        `.stl` (binary or text), `.ply` (binary or text), `.obj` or `.3mf`; with the extra `mesh`
        also `.off`, `.glb` and `.gltf`.
    unit : str, optional
        Unit of the coordinates. Default: the one in the file (3MF and glTF always have it, the
        others where this package wrote them), else "voxel", which is no length.

    Returns
    -------
    Mesh
        Polygons as triangles, all bodies of a scene at their places; the corners of an STL at one
        place are one vertex. The recipe is this reading.

    Raises
    ------
    FileError
        Missing, empty, truncated or damaged, or without triangles.
    UnknownNameError
        An unknown suffix or unit.
    InputError
        Coordinates that are not finite, faces that name vertices that do not exist.
    MissingExtraError
        trimesh is not installed, and the format needs it.

    Examples
    --------
    >>> import tempfile, numpy as np, trabecula as tb
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = tb.export(np.ones((2, 3, 4), np.uint8), f"{folder}/block.stl")
    ...     read_mesh(path, unit="mm")
    <Mesh 52 vertices, 100 faces, mm>
    """
    path = Path(as_path_text(path))
    form = surface_format(path, READABLE)
    check_there(path)
    if unit is not None:
        check_unit(unit)
    also = (zipfile.BadZipFile, StopIteration)
    with report_damage(path, path.suffix[1:].upper(), also=also):
        mesh = form.member("read")(path)
    if not len(mesh.faces):
        raise FileError(f"{path} holds no triangles: is it a surface? export it again as triangles")
    unit = mesh.unit if unit is None else canonical(unit)
    return replace(
        mesh,
        unit=unit,
        recipe=Recipe().then("read_mesh", mesh.vertices, source=fspath(path), unit=unit),
    )
