"""The output at one scale: its levels, what may change, what counts as a neighbour, and which sites may change at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from trabecula.synth.mrf.planes import Plane

Name = tuple[int, int, int, int]


@dataclass
class Lattice:
    """The output at one scale.

    Attributes
    ----------
    levels : (Z, Y, X) uint8
        The present level of every voxel.
    free : (Z, Y, X) bool
        Voxels that are to be made.
    there : (Z, Y, X) bool
        Voxels that are neighbours: what is made and what is known. Outside a form there is nothing.
    asked : (Z, Y, X) bool
        Voxels of the result, whose shares are to be right; a rim beyond it is made as well and then cut away.

    Notes
    -----
    A torus: every axis is periodic. Where the result is not to be, there is more of the lattice than of the result.
    """

    levels: np.ndarray
    free: np.ndarray
    there: np.ndarray
    asked: np.ndarray

    @property
    def shape(self) -> tuple[int, ...]:
        """Voxels along z, y, x."""
        return self.levels.shape


def colours_along(side: int, reach: int, *, even: bool = False) -> tuple[np.ndarray, int]:
    """A colour for every cell of a ring such that cells of one colour lie more than `reach` apart, and how many there are.

    Colours begin at 0 again in every block. A ring whose length is no multiple of reach + 1 gets longer blocks here and there,
    and a few more colours; so does one that is to have an `even` number of blocks, or one alone.
    """
    blocks = max(1, side // (reach + 1))
    if even and blocks > 1:
        blocks -= blocks % 2
    starts = np.arange(blocks + 1) * side // blocks
    return np.concatenate([np.arange(stop - start) for start, stop in pairwise(starts)]), -(-side // blocks)


def classes_of(lattice: Lattice, width: int, *, turned: bool = False) -> list[Name]:
    """Names of the classes that `sites_of` takes: no two sites of a class are in each other's neighbourhood in any plane.

    Sites of equal colours along all axes lie too far apart for any plane along the axes. Sites whose colours differ along all
    three share none of these planes; so for these the class of all (c, c + a, c + b) is one, and there are m^2 classes. A plane
    of two diagonals reaches twice as far along an axis; so for planes that are turned blocks are told apart like the squares of
    a chessboard, and there are 2 m^3.
    """
    colours = range(_colours(lattice, width, turned)[1])
    return [
        (c, a, b, square)
        for c in (colours if turned else [-1])
        for a in colours
        for b in colours
        for square in ((0, 1) if turned else (-1,))
    ]


def sites_of(lattice: Lattice, width: int, name: Name) -> np.ndarray:
    """The free sites of a class as flat places, rising."""
    first, a, b, square = name
    along, count = _colours(lattice, width, square >= 0)
    found = []
    for colour in range(count) if first < 0 else [first]:
        cells = [
            np.flatnonzero(colours == (colour + more) % count) for colours, more in zip(along, (0, a, b), strict=True)
        ]
        if all(map(len, cells)):
            sites = np.ravel_multi_index(np.ix_(*cells), lattice.shape)
            found.append(sites.ravel() if square < 0 else sites[_squares(along, cells) == square])
    sites = np.sort(np.concatenate(found)) if found else np.empty(0, np.int64)
    return sites if lattice.free.all() else sites[lattice.free.ravel()[sites]]


def _squares(along: Sequence[np.ndarray], cells: Sequence[np.ndarray]) -> np.ndarray:
    """Whether the blocks of these cells are black or white, 0 or 1, for all combinations of cells along three axes."""
    z, y, x = (np.cumsum(colours == 0)[part] for colours, part in zip(along, cells, strict=True))
    return np.asarray((z[:, None, None] + y[:, None] + x) % 2)


def _colours(lattice: Lattice, width: int, turned: bool) -> tuple[list[np.ndarray], int]:
    found = [colours_along(side, width // 2, even=turned) for side in lattice.shape]
    return [colours for colours, _ in found], max(count for _, count in found)


def any_of_eight(marks: np.ndarray) -> np.ndarray:
    """(Z, Y, X) bool at half the resolution: whether any of the eight voxels is marked."""
    padded = np.pad(marks, [(0, side % 2) for side in marks.shape])
    z, y, x = (side // 2 for side in padded.shape)
    return np.asarray(padded.reshape(z, 2, y, 2, x, 2).any(axis=(1, 3, 5)))


def known_halved(values: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Known voxels (uint8 levels) at half the resolution: a cell takes the first of its eight that is known."""
    pads = [(0, side % 2) for side in known.shape]
    padded, marked = np.pad(values, pads), np.pad(known, pads)
    result = np.zeros(tuple(side // 2 for side in marked.shape), values.dtype)
    found = np.zeros(result.shape, bool)
    for corner in np.ndindex(2, 2, 2):
        part = tuple(slice(start, None, 2) for start in corner)
        fresh = marked[part] & ~found
        result[fresh] = padded[part][fresh]
        found |= fresh
    return result, found


def complete_in(lattice: Lattice, planes: Sequence[Plane], width: int) -> np.ndarray:
    """Where all neighbours in these planes are there, and the site itself, (Z, Y, X) bool; of diagonals, all in their box."""
    whole = np.ones(lattice.shape, bool)
    if lattice.there.all():
        return whole
    for plane in planes:
        box = lattice.there
        for axis, steps in enumerate(np.abs([plane.rows, plane.columns]).sum(0).tolist()):
            box = within(box, [axis], steps * (width // 2))  # two diagonals reach twice as far along an axis
        whole &= box
    return whole


def within(marks: np.ndarray, axes: Sequence[int], reach: int) -> np.ndarray:
    """Whether all cells at most `reach` away along these axes (a box) are marked, (Z, Y, X) bool on a torus."""
    for axis in axes:
        whole = marks.copy()
        for step in range(1, reach + 1):
            whole &= np.roll(marks, step, axis)
            whole &= np.roll(marks, -step, axis)
        marks = whole
    return marks
