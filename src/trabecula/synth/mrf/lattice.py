"""The output at one scale: its levels, what may change, what counts as a neighbour, and what
belongs to the result.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs, sum_slabs

ALL = np.zeros((0, 0, 0), bool)
"""To a kernel: every voxel is marked."""


@dataclass
class Lattice:
    """The output at one scale.

    Attributes
    ----------
    levels : (Z, Y, X) uint8
        The present level of every voxel.
    free : (Z, Y, X) bool, or None
        Voxels that are to be made. Of this and of what follows: None for all.
    there : (Z, Y, X) bool, or None
        Voxels that are neighbours: what is made and what is known. Outside a form there is nothing.
    box : three int, or None
        The corner of the lattice that is the result, whose shares are to be right; a rim beyond it
        is made as well and then cut away.
    form : bool of the shape of the box, or None
        What of the box the result is.

    Notes
    -----
    A torus: every axis is periodic. Where the result is not to be, there is more of the lattice
    than of the result.
    """

    levels: np.ndarray
    free: np.ndarray | None = None
    there: np.ndarray | None = None
    box: tuple[int, ...] | None = None
    form: np.ndarray | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Voxels along z, y, x."""
        return self.levels.shape

    def asks_for(self, sites: np.ndarray) -> np.ndarray:
        """Which sites (S,) are voxels of the result, (S,) bool."""
        if self.form is None and self.box in (None, self.shape):
            return np.ones(len(sites), bool)
        z, rest = np.divmod(sites, self.shape[1] * self.shape[2])
        y, x = np.divmod(rest, self.shape[2])
        depth, height, width = self.box or self.shape
        asked = np.asarray((z < depth) & (y < height) & (x < width))
        if self.form is not None:
            asked[asked] = self.form[z[asked], y[asked], x[asked]]
        return asked

    def asked(self, first: int, last: int) -> np.ndarray:
        """Where the result is in these planes, bool."""
        depth, height, width = self.box or self.shape
        asked = np.zeros((last - first, *self.shape[1:]), bool)
        part = asked[: max(0, min(last, depth) - first), :height, :width]
        part[...] = True if self.form is None else self.form[first : first + len(part)]
        return asked

    def known(self, count: int) -> tuple[int, np.ndarray]:
        """How many voxels of the result are still to be made, and how many of each of `count`
        levels are known.
        """

        def work(first: int, last: int) -> np.ndarray:
            asked = self.asked(first, last)
            if self.free is None:
                return np.append(np.zeros(count, np.int64), np.count_nonzero(asked))
            free = self.free[first:last]
            held = np.zeros(count, np.int64)
            for plane, marks in zip(self.levels[first:last], asked & ~free, strict=True):
                held += np.bincount(plane[marks], minlength=count)
            return np.append(held, np.count_nonzero(asked & free))

        found = sum_slabs(work, self.shape[0])
        return int(found[-1]), found[:-1]


def marks_of(marks: np.ndarray | None) -> np.ndarray:
    """What a kernel takes for marks."""
    return ALL if marks is None else marks


def halved(shape: tuple[int, ...]) -> tuple[int, ...]:
    """The shape at half the resolution."""
    return tuple(-(-side // 2) for side in shape)


def any_of_eight(marks: np.ndarray) -> np.ndarray:
    """(Z, Y, X) bool at half the resolution: whether any of the eight voxels is marked."""
    coarse = memmap.zeros(halved(marks.shape), bool)

    def work(first: int, last: int) -> None:
        for corner in np.ndindex(2, 2, 2):
            part = _of_corner(marks, corner, first, last)
            coarse[first:last][tuple(map(slice, part.shape))] |= part

    for_slabs(work, len(coarse))
    return coarse


def known_halved(values: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Known voxels (uint8 levels) at half the resolution: a cell takes the first of its eight that
    is known.
    """
    result, found = (
        memmap.zeros(halved(known.shape), values.dtype),
        memmap.zeros(halved(known.shape), bool),
    )

    def work(first: int, last: int) -> None:
        for corner in np.ndindex(2, 2, 2):
            part = _of_corner(known, corner, first, last)
            cells = tuple(map(slice, part.shape))
            before = found[first:last][cells]
            fresh = part & ~before
            result[first:last][cells][fresh] = _of_corner(values, corner, first, last)[fresh]
            before |= fresh

    for_slabs(work, len(result))
    return result, found


def _of_corner(values: np.ndarray, corner: tuple[int, ...], first: int, last: int) -> np.ndarray:
    """One of the eight voxels of every cell of the coarse planes first .. last, where there is one."""
    z, y, x = corner
    return values[2 * first + z : 2 * last : 2, y::2, x::2]


def grown(form: np.ndarray, shape: tuple[int, ...], reach: int) -> np.ndarray:
    """What lies at most `reach` (a box) from a form at the corner of a torus, (Z, Y, X) bool."""
    there = memmap.empty(shape, bool)
    height, width = form.shape[1:]

    def work(first: int, last: int) -> None:
        for z in range(first, last):
            plane = np.zeros(shape[1:], bool)
            near = {(z + step) % shape[0] for step in range(-reach, reach + 1)}
            for other in sorted(near & set(range(len(form)))):
                plane[:height, :width] |= form[other]
            for axis in (0, 1):
                plane = _spread(plane, axis, reach)
            there[z] = plane

    for_slabs(work, shape[0])
    return there


def _spread(plane: np.ndarray, axis: int, reach: int) -> np.ndarray:
    """The marks of a plane, and all cells at most `reach` from them along a periodic axis."""
    wide = plane.copy()
    for step in range(1, reach + 1):
        wide |= np.roll(plane, step, axis)
        wide |= np.roll(plane, -step, axis)
    return wide
