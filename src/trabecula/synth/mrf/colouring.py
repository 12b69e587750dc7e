"""Which sites may change at once: classes of sites that are not in each other's neighbourhoods."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.synth.mrf.lattice import Lattice, marks_of

Name = tuple[int, int, int, int]


def colours_along(side: int, reach: int, *, even: bool = False) -> tuple[np.ndarray, int]:
    """A colour for every cell of a ring such that cells of one colour lie more than `reach` apart,
    and how many there are.

    Colours begin at 0 again in every block. A ring whose length is no multiple of reach + 1 gets
    longer blocks here and there, and a few more colours; so does one that is to have an `even`
    number of blocks, or one alone.
    """
    blocks = max(1, side // (reach + 1))
    if even and blocks > 1:
        blocks -= blocks % 2
    starts = np.arange(blocks + 1) * side // blocks
    return np.concatenate([np.arange(stop - start) for start, stop in pairwise(starts)]), -(
        -side // blocks
    )


class Classes:
    """The classes of a lattice: no two sites of one are in each other's neighbourhood in any plane.

    Sites of equal colours along all axes lie too far apart for any plane along the axes. Sites
    whose colours differ along all three share none of these planes; so for these the class of all
    (c, c + a, c + b) is one, and there are m^2 classes. A plane of two diagonals reaches twice as
    far along an axis; so for planes that are `turned` blocks are told apart like the squares of a
    chessboard, and there are 2 m^3.

    Parameters
    ----------
    lattice : Lattice
    width : int
        Of the neighbourhoods.
    turned : bool
    """

    def __init__(self, lattice: Lattice, width: int, *, turned: bool = False) -> None:
        self.lattice = lattice
        found = [colours_along(side, width // 2, even=turned) for side in lattice.shape]
        self._colours = tuple(colours for colours, _ in found)
        self._blocks = tuple(np.cumsum(colours == 0) for colours in self._colours)
        self._count = max(count for _, count in found)
        every = range(self._count)
        self.names: list[Name] = [
            (c, a, b, square)
            for c in (every if turned else [-1])
            for a in every
            for b in every
            for square in ((0, 1) if turned else (-1,))
        ]

    def sites(self, name: Name, first: int, last: int) -> np.ndarray:
        """The free sites of a class in the planes first .. last as flat places, rising (int64)."""
        found: np.ndarray = _sites(
            name, self._count, first, last, self._colours, self._blocks, marks_of(self.lattice.free)
        )
        return found


@kernel
def _sites(name, count, first, last, colours, blocks, free):
    along_z, along_y, along_x = colours
    block_z, block_y, block_x = blocks
    colour, a, b, square = name
    Y, X = len(along_y), len(along_x)
    marks = free.ravel()
    places = np.empty(0, np.int64)
    for fill in range(2):  # how many there are first
        found = 0
        for z in range(first, last):
            if colour >= 0 and along_z[z] != colour:
                continue
            for y in range(Y):
                if along_y[y] != (along_z[z] + a) % count:
                    continue
                for x in range(X):
                    fits = along_x[x] == (along_z[z] + b) % count
                    if square >= 0:
                        fits = fits and (block_z[z] + block_y[y] + block_x[x]) % 2 == square
                    place = (z * Y + y) * X + x
                    if fits and (len(marks) == 0 or marks[place]):
                        if fill:
                            places[found] = place
                        found += 1
        if not fill:
            places = np.empty(found, np.int64)
    return places
