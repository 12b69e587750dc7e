"""The table of formats for solvers. A format is a module of this folder, loaded at first use."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from trabecula.core.checks import check_name

CASES = ("compression", "shear", "periodic")
"""Load cases of finite elements."""

FLOW = "flow"
"""The case of every OpenFOAM folder."""


@dataclass(frozen=True)
class BrickFormat:
    """A format of bricks.

    Parameters
    ----------
    module : str
        Module of this folder with `write(grid, path, context)`.
    note : str
        One line for the docs and the command line.
    most : int
        Bricks that it can count.
    bytes_a_brick : int
        About the size of the file over the bricks.
    cases : tuple of str
        Load cases that it may hold.
    phase : str, optional
        Phase that is taken where none is named. Default: every phase but void.
    folder : bool
        It is a folder of files.
    """

    module: str
    note: str
    most: int
    bytes_a_brick: int
    cases: tuple[str, ...] = ()
    phase: str | None = None
    folder: bool = False

    def load(self) -> Callable[..., Any]:
        """Return the function that writes the format."""
        return importlib.import_module(f"trabecula.mesh.bricks.{self.module}").write


FORMATS: dict[str, BrickFormat] = {
    ".inp": BrickFormat(
        "abaqus",
        "voxel bricks (C3D8) for Abaqus and CalculiX, with sets and a load case",
        most=2**31 // 8,  # node numbers are 32-bit integers, and a brick may have eight of its own
        bytes_a_brick=140,
        cases=CASES,
    ),
    ".vtu": BrickFormat(
        "unstructured",
        "voxel bricks as VTK UnstructuredGrid, for ParaView, MFEM, and FEniCSx by meshio",
        most=2**40,
        bytes_a_brick=90,
    ),
    ".msh": BrickFormat(
        "unstructured",
        "voxel bricks for Gmsh, FEniCSx and MFEM, a physical group for each phase",
        most=2**31 // 8,
        bytes_a_brick=90,
    ),
    ".foam": BrickFormat(
        "openfoam",
        "folder with an OpenFOAM case: voxel polyMesh of the void, simpleFoam",
        most=2**31 // 6,
        bytes_a_brick=400,
        cases=(FLOW,),
        phase="void",
        folder=True,
    ),
}
"""Formats that bricks are written in, by suffix."""


def brick_format(path: str | PathLike[str]) -> BrickFormat:
    """Return the format of a path by its suffix.

    Raises
    ------
    UnknownNameError
        None of the formats has this suffix.
    """
    suffix = Path(path).suffix.lower()
    check_name(suffix, FORMATS, name="format of bricks")
    return FORMATS[suffix]
