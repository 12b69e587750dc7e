"""Parts of a grid that are swept at once.

A Gauss-Seidel sweep takes one node after the other. A large grid is cut across its first axis into
parts that are swept each by itself, where values of other parts are those from before the sweep. So
threads share them, and what comes out depends on the parts alone, which the grid decides.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

THIN = 8
"""Planes of a part, at least: the fewer, the more a sweep forgets."""


class SweptNodes(NamedTuple):
    """The nodes, or segments, of a part, in order of planes: those before `edge` are of its first
    plane, those from `back` on of its last.
    """

    start: int
    edge: int
    back: int
    stop: int

    @property
    def inside(self) -> slice:
        """Return all of them."""
        return slice(self.start, self.stop)

    @property
    def edges(self) -> tuple[int, int]:
        """Return `edge` and `back`, counted from the part's first."""
        return self.edge - self.start, self.back - self.start


def cut_planes(
    begins: np.ndarray, weights: np.ndarray, allowed: np.ndarray, least: int
) -> list[SweptNodes]:
    """Return the parts of a grid of some planes.

    Parameters
    ----------
    begins : (planes + 1,) int64
        First node of every plane, and their number.
    weights : (planes,) int64
        What each plane adds to a part, which gets `least` of it at least.
    allowed : (planes,) bool
        Whether a part may begin with a plane.
    """
    bounds, last = [0], 0
    before = np.concatenate([[0], np.cumsum(weights)])
    for plane in np.flatnonzero(allowed):
        rest = before[-1] - before[plane]
        if plane - last >= THIN and min(before[plane] - before[last], rest) >= least:
            bounds.append(int(plane))
            last = int(plane)
    bounds.append(len(weights))
    nodes = begins.tolist()
    return [
        SweptNodes(
            nodes[a],
            nodes[a + 1] if a else nodes[a],
            nodes[b - 1] if b < len(weights) else nodes[b],
            nodes[b],
        )
        for a, b in pairwise(bounds)
    ]
