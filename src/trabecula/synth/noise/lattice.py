"""Cells of a lattice under the voxels of a request: positions in whole numbers, and a point in
every cell.

An edge of a cell is `CELL` steps. Positions, points and distances are whole numbers of steps, held
as float64 without rounding, so that every box, every cut of it and every processor finds the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.random import philox
from trabecula.synth.shared.gaussian.domain import Domain


@inline
def wrap(cell, period):
    """Return a cell's number, wrapped along an axis that repeats (period above 0)."""
    return cell if period == 0 else cell % period


@kernel
def place_points(place, word, key, first, counts, periods, around, flat, jitter):
    """Draw a point in every cell and its random word, in the order of the cells.

    A point is at most `jitter` / 2 steps from the middle of its cell.
    """
    at = 0
    for z in range(counts[0]):
        for y in range(counts[1]):
            for x in range(counts[2]):
                cz = wrap(first[0] + z - around[0], periods[0])
                cy = wrap(first[1] + y - around[1], periods[1])
                cx = wrap(first[2] + x - around[2], periods[2])
                w = philox(key, cz, cy, cx, 0)
                place[at, 0] = (
                    0
                    if flat
                    else (z - around[0]) * 4096 + _inside(w[0] & np.uint64(0xFFFF), jitter)
                )
                place[at, 1] = (y - around[1]) * 4096 + _inside(w[0] >> np.uint64(16), jitter)
                place[at, 2] = (x - around[2]) * 4096 + _inside(w[1] & np.uint64(0xFFFF), jitter)
                word[at] = np.int64(w[2] >> np.uint64(8))
                at += 1


@inline
def _inside(bits, jitter):
    """Return the steps from the corner of a cell."""
    return 2048 + (((np.int64(bits) - 32768) * jitter) >> 16)


CELL = 4096
"""Steps along an edge of a cell."""

APART = 2**0.5 - 1
"""Cells between the voxels of a trial: no simple part of a cell, so that they fall everywhere in
cells.
"""


@dataclass(frozen=True)
class Axis:
    """Voxels along an axis, on a lattice.

    Attributes
    ----------
    at : (N,) float64
        Middles of the voxels, rising whole numbers of steps from the first cell's corner on.
    first : int
        That cell's number.
    period : int
        Cells after which the lattice repeats; 0 where it is endless.
    flat : bool
        Whether this is the axis that a picture lacks: one layer of cells, all points in its plane.
    """

    at: np.ndarray
    first: int
    period: int
    flat: bool = False

    @property
    def cells(self) -> int:
        """Return the number of cells that the voxels lie in."""
        return int(self.at[-1]) // CELL + 1

    @property
    def cell(self) -> np.ndarray:
        """Return the cell of every voxel, counted from the first."""
        return (self.at // CELL).astype(np.int64)

    @property
    def inside(self) -> np.ndarray:
        """Return the position of every voxel in its cell, 0 .. 1."""
        return np.asarray((self.at % CELL) / CELL)


@dataclass(frozen=True)
class VoxelGrid:
    """Voxels on lattices.

    Attributes
    ----------
    places : three (N,) int64
        Their numbers along z, y, x, rising.
    step : three floats
        Cells that a voxel is wide, along each.
    edges : three floats
        Of a cell, in one unit of length.
    periods : three ints
        Voxels after which all repeats; 0 where it does not.
    flat : bool
        Whether a picture is made.
    """

    places: tuple[np.ndarray, ...]
    step: tuple[float, ...]
    edges: tuple[float, ...]
    periods: tuple[int, ...]
    flat: bool

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the number of voxels along every axis."""
        return tuple(len(place) for place in self.places)

    def part(self, cuts: Sequence[slice]) -> VoxelGrid:
        """Return the grid of some of the voxels."""
        return replace(
            self, places=tuple(place[cut] for place, cut in zip(self.places, cuts, strict=True))
        )

    def axes(self, finer: int = 1) -> list[Axis]:
        """Return the voxels on the lattice, with every cell divided into `finer` along every axis.

        A period is rounded to whole cells before they are divided, to 1 at least.
        """
        found = [
            _axis(place, width, period, finer)
            for place, width, period in zip(self.places, self.step, self.periods, strict=True)
        ]
        return [Axis(np.zeros(1), 0, 0, flat=True), *found[1:]] if self.flat else found


def shortest(edges: Sequence[float], *, flat: bool) -> float:
    """Return the shortest edge of a cell; in a picture the shortest edge in its plane."""
    return min(edges[1:] if flat else edges)


def grid_of(
    domain: Domain, box: Sequence[tuple[int, int]], step: Sequence[float], edges: Sequence[float]
) -> VoxelGrid:
    """Return the grid of the voxels of a box."""
    periods = tuple(
        side if wraps else 0 for side, wraps in zip(domain.shape, domain.periodic, strict=True)
    )
    return VoxelGrid(
        tuple(np.arange(start, stop) for start, stop in box),
        tuple(step),
        tuple(edges),
        periods,
        domain.flat,
    )


def scatter_grid(
    step: Sequence[float], edges: Sequence[float], counts: Sequence[int], *, flat: bool
) -> VoxelGrid:
    """Return a grid of voxels of the endless material far apart: many cells for few voxels.

    They are `APART` of a cell apart, or next to each other.
    """
    places = tuple(
        np.floor(np.arange(count) * max(1.0, APART / width)).astype(np.int64)
        for count, width in zip(counts, step, strict=True)
    )
    return VoxelGrid(places, tuple(step), tuple(edges), (0, 0, 0), flat)


def _axis(place: np.ndarray, width: float, period: int, finer: int) -> Axis:
    """Return the voxels of one axis on the lattice."""
    cells = max(1, round(period * width)) * finer if period else 0
    if period:
        turn, place = np.divmod(place, period)
        at = turn * (cells * CELL) + (2 * place + 1) * (cells * CELL) // (2 * period)
    else:
        at = np.floor((place + 0.5) * (width * finer * CELL)).astype(np.int64)
    first = int(at[0]) // CELL
    return Axis((at - first * CELL).astype(np.float64), first, cells)


@dataclass(frozen=True)
class Points:
    """A point in every cell of a box of cells.

    Attributes
    ----------
    place : (C, 3) float64
        Whole steps from where the axes' positions are counted, cells in the order of an array.
    word : (C,) int64
        A random whole number from 0 to 2**24 - 1.
    counts : (3,) int64
        Cells along z, y, x.
    around : (3,) int64
        How many of them lie before the first voxel's, and after the last one's.
    """

    place: np.ndarray
    word: np.ndarray
    counts: np.ndarray
    around: np.ndarray


def points_of(axes: Sequence[Axis], key: np.uint64, *, jitter: float, margin: int) -> Points:
    """Return the points of all cells that the voxels lie in, and of `margin` cells around them."""
    around = np.array([0 if axis.flat else margin for axis in axes], np.int64)
    counts = np.array([axis.cells for axis in axes], np.int64) + 2 * around
    total = int(counts.prod())
    place, word = np.empty((total, 3)), np.empty(total, np.int64)
    first, periods = (
        np.array([getattr(axis, name) for axis in axes], np.int64) for name in ("first", "period")
    )
    place_points(
        place, word, key, first, counts, periods, around, axes[0].flat, round(jitter * CELL)
    )
    return Points(place, word, counts, around)
