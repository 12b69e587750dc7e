"""`write_mesh`: a mesh into a file whose suffix names the format."""

from __future__ import annotations

import importlib
from os import PathLike
from pathlib import Path

from trabecula.core.checks import check_name
from trabecula.core.errors import InputError
from trabecula.engine.files import replacing
from trabecula.mesh.base import Mesh
from trabecula.mesh.formats import FORMATS


def write_mesh(mesh: Mesh, path: str | PathLike[str]) -> Path:
    """Write a mesh; the file appears whole or not at all.

    Parameters
    ----------
    mesh : Mesh
    path : path
        `.stl` (millimetres where the unit is a length), `.3mf` (the unit is declared), `.ply` or `.obj` (in the mesh's
        unit, named in a comment).

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
    path = Path(path)
    check_name(path.suffix.lower(), FORMATS, name="surface format")
    if not len(mesh.faces):
        raise InputError("the mesh has no faces: there is nothing to write")
    writer = importlib.import_module(FORMATS[path.suffix.lower()][1])
    with replacing(path) as temporary:
        writer.write(mesh, temporary)
    return path
