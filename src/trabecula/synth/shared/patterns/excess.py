"""Fractions that flips keep, or bring to a target: what cells have too much of a phase."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from trabecula.engine.chunking import Box
from trabecula.engine.parallel import for_slabs

CELL = 5
"""Voxels a side of what meets its fraction where a target varies."""

SHARINGS = 8
"""Times that what windows are off is shared: more bring them nearer, and leave interfaces
rougher.
"""

_KEPT, _MET = 0.02, 0.1  # prices: cells that are to change must be worth it


class FractionCells(NamedTuple):
    """Cells of a block, each with a fraction of its own.

    Attributes
    ----------
    sides : three ints
        Voxels along each axis; a block begins with a whole one.
    gained : (cells z, y, x, phases) int64
        How many voxels a cell has too many of a phase.
    price : float
        Of one voxel, by the square. 0: below 0 of them cost nothing, and there are never more.
    whole : (phases,) int64
        How many the block has too many of a phase.
    whole_price : float
        Of one of them, by the square: small cells gain less than others lose.
    """

    sides: tuple[int, int, int]
    gained: np.ndarray
    price: float
    whole: np.ndarray
    whole_price: float


def kept_cells(shape: Sequence[int], phases: int, width: int) -> FractionCells:
    """Return cells of a block that keep their fractions."""
    cells = [-(-side // width) for side in shape]
    gained = np.zeros([*cells, phases], np.int64)
    return FractionCells((width,) * 3, gained, _KEPT, np.zeros(phases, np.int64), 0.0)


def cells_of(excess: np.ndarray, box: Box, width: int = CELL) -> FractionCells:
    """Return the cells of a block of a volume whose excess is `excess_of`."""
    sides = (width,) * 3
    gained = _inside(excess, box, sides)
    return FractionCells(sides, gained, _MET, gained.sum(axis=(0, 1, 2)), _KEPT)


def bounded_cells(excess: np.ndarray, box: Box, sides: tuple[int, int, int]) -> FractionCells:
    """Return the cells of a block that keep what they have at most; the block keeps its
    fraction.
    """
    gained = _inside(excess, box, sides)
    return FractionCells(sides, gained, 0.0, np.zeros(gained.shape[3], np.int64), _KEPT)


def _inside(excess: np.ndarray, box: Box, sides: tuple[int, int, int]) -> np.ndarray:
    """Return a copy of what the cells of a block have."""
    cut = zip(box, sides, strict=True)
    return excess[
        tuple(slice(first // side, -(-last // side)) for (first, last), side in cut)
    ].copy()


def excess_of(
    phases: np.ndarray,
    fractions: np.ndarray,
    free: np.ndarray | None,
    *,
    window: int,
    width: int = CELL,
    wraps: Sequence[bool] = (False, False, False),
) -> np.ndarray:
    """Return how many voxels each cell has too many of both phases, so that windows have their
    fractions: (cells z, y, x, 2) int64.

    A cell takes its part of what the windows that hold it are off, since in a window fractions vary
    from cell to cell as they do in the material: by its voxels at interfaces, since no others can
    change. What windows are off with that is shared again, as Landweber (1951,
    doi:10.2307/2372313) solves such sums. In all they have as many too many as there are.

    Parameters
    ----------
    phases : (Z, Y, X) uint8
        0 and 1.
    fractions : (Z, Y, X) float32
        That the second phase is to have.
    free : (Z, Y, X) bool, optional
        Voxels that count. Default: all.
    window, width : int
        Voxels a side of windows, and of cells.
    wraps : three bools
        Axes along which windows and interfaces continue at the opposite face.
    """
    depth, *rest = phases.shape
    planes = (depth, *(-(-side // width) for side in rest))
    off, room = np.zeros(planes), np.zeros(planes)

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            there = np.ones(phases[z].shape, np.float32) if free is None else free[z]
            off[z] = _sums(((phases[z] == 1) - fractions[z]) * there, width)
            room[z] = _sums(_at_interfaces(phases, z, wraps) * there, width)

    for_slabs(work, depth)
    layers = np.arange(0, depth, width)
    off, room = (np.add.reduceat(one, layers, axis=0) for one in (off, room))
    given = (window / width, wraps)
    around, share = np.maximum(_spread(room, *given), 1), np.zeros_like(off)
    for _ in range(SHARINGS):  # each time what the shares of before leave
        share += _spread(off - share * room, *given) / around
    # a cell at a face is in fewer windows, in which it counts more: so the sum is another
    share += np.sum(off - share * room) / max(room.sum(), 1)
    second = np.rint(share * room).astype(np.int64)
    return np.stack([-second, second], axis=-1)


def _at_interfaces(phases: np.ndarray, z: int, wraps: Sequence[bool]) -> np.ndarray:
    """Return the voxels of a plane that have a neighbour of another phase along an axis: (Y, X)."""
    plane, depth = phases[z], len(phases)
    found = np.zeros(plane.shape, bool)
    for near in (z - 1, z + 1):
        if wraps[0] or 0 <= near < depth:
            found |= phases[near % depth] != plane
    for lines, of, endless in ((found, plane, wraps[1]), (found.T, plane.T, wraps[2])):
        differ = of[1:] != of[:-1]
        lines[1:] |= differ
        lines[:-1] |= differ
        if endless:
            differ = of[0] != of[-1]
            lines[0] |= differ
            lines[-1] |= differ
    return found


def _sums(plane: np.ndarray, width: int) -> np.ndarray:
    """Return the sums of the cells of a plane (Y, X)."""
    starts = (np.arange(0, side, width) for side in plane.shape)
    for axis, first in enumerate(starts):
        plane = np.add.reduceat(plane, first, axis=axis, dtype=np.float64)
    return plane


def _spread(sums: np.ndarray, window: float, wraps: Sequence[bool]) -> np.ndarray:
    """Return the sums of cells over all windows, of so many cells a side, that hold a cell, each by
    how many of them do.
    """
    for axis, endless in enumerate(wraps):
        found, lines = sums.copy(), np.moveaxis(sums, axis, 0)
        to = np.moveaxis(found, axis, 0)
        for far in range(1, min(int(np.ceil(window)), len(lines))):
            weight = 1 - far / window
            to[far:] += weight * lines[:-far]
            to[:-far] += weight * lines[far:]
            if endless:
                to[:far] += weight * lines[-far:]
                to[-far:] += weight * lines[:far]
        sums = found
    return sums
