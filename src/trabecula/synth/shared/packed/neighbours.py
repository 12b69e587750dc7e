"""Which places are near each other in a box that repeats."""

from __future__ import annotations

from functools import partial

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_items


def neighbour_pairs(places: np.ndarray, reach: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Return the pairs of places nearer than the sum of their reaches.

    Parameters
    ----------
    places : (n, 3) float
        Within the box.
    reach : (n,) float
    sides : (3,) float
        Of the box.

    Returns
    -------
    pairs : (P, 2) int64
        The one with the larger reach first, which looks for the others.
    """
    cell = max(2 * float(np.median(reach)), 1.0)
    cells = np.maximum((sides / cell).astype(np.int64), 1)
    head, following = _cells(places, sides, cells)
    counts = np.zeros(len(places) + 1, np.int64)
    nothing = np.empty((0, 2), np.int64)
    given = (places, reach, sides, cells, head, following)
    for_items(partial(_find, *given, counts, nothing), len(places), least=64)
    ends = np.cumsum(counts)
    pairs = np.empty((int(ends[-1]), 2), np.int64)
    for_items(partial(_find, *given, ends, pairs), len(places), least=64)
    return pairs


@kernel
def _cells(places, sides, cells):
    """Return the lists of the places in every cell: the first, and the one after each."""
    head = np.full(cells[0] * cells[1] * cells[2], -1, np.int64)
    following = np.empty(len(places), np.int64)
    for i in range(len(places) - 1, -1, -1):
        c = np.int64(0)
        for axis in range(3):
            c = c * cells[axis] + min(
                np.int64(places[i, axis] / sides[axis] * cells[axis]), cells[axis] - 1
            )
        following[i] = head[c]
        head[c] = i
    return head, following


@inline
def offset_between(one, other, sides):
    """Return the way (3,) from a place to another's nearest image."""
    dz, dy, dx = other[0] - one[0], other[1] - one[1], other[2] - one[2]
    dz -= sides[0] * np.rint(dz / sides[0])
    dy -= sides[1] * np.rint(dy / sides[1])
    dx -= sides[2] * np.rint(dx / sides[2])
    return dz, dy, dx


@kernel
def _find(places, reach, sides, cells, head, following, ends, pairs, start, stop):
    """Count the neighbours of places start..stop into ends[1 + i]; where there are `pairs`, write
    them from ends[i] on.
    """
    low, count = np.empty(3, np.int64), np.empty(3, np.int64)
    for i in range(start, stop):
        at = ends[i] if len(pairs) else 0
        found = 0
        for axis in range(3):
            width = sides[axis] / cells[axis]
            first = np.int64(np.floor((places[i, axis] - 2 * reach[i]) / width))
            last = np.int64(np.floor((places[i, axis] + 2 * reach[i]) / width))
            all_ = last - first + 1 > cells[axis]
            low[axis] = 0 if all_ else first
            count[axis] = cells[axis] if all_ else last - first + 1
        for a in range(count[0]):
            for b in range(count[1]):
                for c in range(count[2]):
                    cell = (low[0] + a) % cells[0]
                    cell = cell * cells[1] + (low[1] + b) % cells[1]
                    cell = cell * cells[2] + (low[2] + c) % cells[2]
                    j = head[cell]
                    while j >= 0:
                        if reach[j] < reach[i] or (reach[j] == reach[i] and j < i):
                            dz, dy, dx = offset_between(places[i], places[j], sides)
                            if dz * dz + dy * dy + dx * dx < (reach[i] + reach[j]) ** 2:
                                if len(pairs):
                                    pairs[at + found, 0] = i
                                    pairs[at + found, 1] = j
                                found += 1
                        j = following[j]
        if not len(pairs):
            ends[i + 1] = found
