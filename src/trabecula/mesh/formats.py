"""The table of surface formats. A format is a module of this folder, loaded at its first use."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from trabecula.core.checks import check_name


@dataclass(frozen=True)
class SurfaceFormat:
    """A format of surface files.

    Parameters
    ----------
    home : str
        The module of this folder, with `read(path) -> Mesh` and, of a format that is written,
        `write(mesh, path) -> None`.
    note : str
        One line for the docs and the command line.
    in_slabs : bool
        The module has a `Writer`, which takes a surface chunk by chunk: see `mesh.stl`.
    own_unit : bool
        Coordinates are in the unit of the mesh, which a comment alone names; else the file declares
        its unit, or has a fixed one.
    """

    home: str
    note: str
    in_slabs: bool = False
    own_unit: bool = False

    def member(self, name: str) -> Any:
        """Return "read", "write" or "Writer" of the format's module."""
        return getattr(importlib.import_module(f"trabecula.mesh.{self.home}"), name)


FORMATS: dict[str, SurfaceFormat] = {
    ".stl": SurfaceFormat("stl", "binary STL, in millimetres", in_slabs=True),
    ".3mf": SurfaceFormat("threemf", "3D Manufacturing Format, with unit and recipe"),
    ".ply": SurfaceFormat("ply", "binary PLY, unit and recipe as comments", own_unit=True),
    ".obj": SurfaceFormat("obj", "Wavefront OBJ, unit and recipe as comments", own_unit=True),
}
"""Formats that are written, and read."""

READABLE: dict[str, SurfaceFormat] = {
    **FORMATS,
    ".off": SurfaceFormat("by_trimesh", "Object File Format, without a unit"),
    ".glb": SurfaceFormat("by_trimesh", "binary glTF 2.0, in metres"),
    ".gltf": SurfaceFormat("by_trimesh", "glTF 2.0 as text, in metres"),
}
"""Formats that are read; of those that are not written trimesh does it, the extra `mesh`."""


def surface_format(
    path: str | PathLike[str], formats: dict[str, SurfaceFormat] = FORMATS
) -> SurfaceFormat:
    """Return the format of a path by its suffix.

    Raises
    ------
    UnknownNameError
        None of the formats has this suffix.
    """
    suffix = Path(path).suffix.lower()
    check_name(suffix, formats, name="surface format")
    return formats[suffix]
