"""What a solver's result holds: points, cells, arrays on either; of a regular grid its lattice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trabecula.core.checks import check_name, quote
from trabecula.core.errors import InputError
from trabecula.io.guard import report_damage

CORNERS = {"tetrahedron": 4, "pyramid": 5, "wedge": 6, "hexahedron": 8}
"""Kinds of cells that are read, with their corners in the order of VTK."""

VTK_KINDS = {
    10: "tetrahedron",
    11: "voxel",
    12: "hexahedron",
    13: "wedge",
    14: "pyramid",
    24: "tetrahedron",  # quadratic: corners come first
    25: "hexahedron",
    26: "wedge",
    27: "pyramid",
}
"""VTK's numbers of them; of quadratic ones the corners alone count."""

_VOXEL_ORDER = [0, 1, 3, 2, 4, 5, 7, 6]
"""Corners of a VTK_VOXEL in the order of a hexahedron."""


@dataclass(frozen=True, eq=False)
class ResultArray:
    """An array of a result.

    Attributes
    ----------
    name : str
    place : {"points", "cells"}
    components : int
    load : callable
        Returns the numbers, (points or cells, components).
    """

    name: str
    place: str
    components: int
    load: Callable[[], np.ndarray]

    def __str__(self) -> str:
        words = f"{self.components} components" if self.components > 1 else "1 number"
        return f"{self.name} ({words} on {self.place})"


@dataclass(frozen=True, eq=False)
class CellBlock:
    """Cells of one kind.

    Attributes
    ----------
    kind : str
        A key of `CORNERS`.
    nodes : int array, (cells, corners)
    numbers : int array, (cells,)
        Of the cells among all, for arrays on cells.
    """

    kind: str
    nodes: np.ndarray
    numbers: np.ndarray


@dataclass(frozen=True)
class RegularGrid:
    """A regular grid: its first corner and the edges of a cell along x, y, z, and the cells along
    z, y, x.
    """

    origin: tuple[float, float, float]
    spacing: tuple[float, float, float]
    shape: tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class SolverResult:
    """A result, open.

    Attributes
    ----------
    path : Path
    form : str
        Name of the format.
    arrays : tuple of ResultArray
    points : float64 array, (points, 3), optional
        x, y, z; none of a lattice.
    blocks : tuple of CellBlock
    lattice : RegularGrid, optional
        Instead of points and cells; points and cells are then counted along x first.
    scalars : str
        Name of the array that the file itself prefers, else empty.
    note : str
        What the file says before its first tag.
    """

    path: Path
    form: str
    arrays: tuple[ResultArray, ...]
    points: np.ndarray | None = None
    blocks: tuple[CellBlock, ...] = ()
    lattice: RegularGrid | None = None
    scalars: str = ""
    note: str = ""

    def array(self, name: str | None) -> ResultArray:
        """Return an array by its name; the only one for None, on cells rather than on points where
        both have it.

        Raises
        ------
        UnknownNameError
            There is none of that name.
        InputError
            There are several and none is named, or there is none at all.
        """
        if not self.arrays:
            raise InputError(
                f"{self.path} holds no array on points or cells: write the result into it"
            )
        known = {one.name: one for one in sorted(self.arrays, key=lambda one: one.place == "cells")}
        if name is None:
            if len(known) > 1:
                raise InputError(
                    f"{self.path} holds several arrays: {', '.join(map(str, known.values()))}; "
                    "name one (--array)"
                )
            return next(iter(known.values()))
        check_name(name, known, name="array")
        return known[name]

    def values(self, array: ResultArray) -> np.ndarray:
        """Return the numbers of an array, (points or cells, components) float.

        Raises
        ------
        FileError
            They are damaged.
        InputError
            They are not finite.
        """
        with report_damage(self.path, self.form):
            found = array.load()
        if not np.isfinite(found).all():
            raise InputError(
                f"{self.path}: {quote(array.name)} holds NaN or infinite numbers: the solver did "
                "not converge, or wrote no value there"
            )
        return found


def group_cells(
    connectivity: np.ndarray, offsets: np.ndarray, types: np.ndarray, points: int
) -> tuple[CellBlock, ...]:
    """Group cells as VTK stores them by their kinds; surfaces, lines and points are left out.

    Parameters
    ----------
    connectivity : int array
        Points of all cells, one cell after the other.
    offsets : int array, (cells,)
        Where each cell ends in it.
    types : int array, (cells,)
    points : int
        Number of points.

    Raises
    ------
    ValueError
        Damaged: a cell with other corners than its kind, or of points that are not there.
    InputError
        No cell of a kind that is read.
    """
    if len(offsets) != len(types):
        raise ValueError(f"it holds {len(types)} types of {len(offsets)} cells")
    starts = np.concatenate([[0], offsets[:-1]]).astype(np.int64)
    blocks = []
    for number in np.unique(types).tolist():
        if number not in VTK_KINDS:
            continue
        kind = VTK_KINDS[number]
        members = np.flatnonzero(types == number)
        count = CORNERS["hexahedron" if kind == "voxel" else kind]
        if (offsets[members] - starts[members] < count).any():
            raise ValueError(f"a {kind} has fewer than {count} corners")
        at = starts[members][:, None] + np.arange(count)
        if at.size and (at.min() < 0 or at.max() >= len(connectivity)):
            raise ValueError("its cells are longer than its connectivity")
        nodes = connectivity[at]
        if nodes.size and not 0 <= nodes.min() <= nodes.max() < points:
            raise ValueError(f"a cell has a point that is none of its {points}")
        if kind == "voxel":
            kind, nodes = "hexahedron", nodes[:, _VOXEL_ORDER]
        blocks.append(CellBlock(kind, nodes, members))
    if not blocks:
        found = ", ".join(map(str, np.unique(types).tolist())) or "none"
        raise InputError(
            "the mesh has no hexahedra, wedges, pyramids or tetrahedra (VTK's types of its cells: "
            f"{found}): take the volume, not its surface"
        )
    return tuple(blocks)
