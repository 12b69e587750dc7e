"""Histogram matching of a field to an exemplar's, in integers and with few ties.

Votes agree so often that many voxels hold exactly the same value; a rank within such a tie would be chance, and mapping the
whole tie to one value moves the volume fraction by percents. So voxels are ranked by their value with a small share of
their six neighbours' mixed in.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.tiles import for_slabs

_OWN = 24  # weight of the voxel itself against 1 for each of six neighbours
_BINS = 1 << 16


def match_histogram(field: np.ndarray, sorted_target: np.ndarray) -> np.ndarray:
    """Map (Z, Y, X) int16 so that its histogram is that of `sorted_target` (int8, rising); order is kept up to ties.

    Returns
    -------
    (Z, Y, X) int8
    """
    ranks, total = _ranked(field)
    middle = np.cumsum(total) - total // 2
    place = middle * len(sorted_target) // field.size
    table = sorted_target[np.minimum(place, len(sorted_target) - 1)].astype(np.int8)
    return table[ranks]


def brightest(field: np.ndarray, count: int) -> np.ndarray:
    """The `count` brightest voxels of (Z, Y, X) int16 as a mask, to the voxel.

    Ties of the mixed value are broken by the sum over 3 x 3 x 3 voxels, and what ties even there by raster order.
    """
    ranks, total = _ranked(field)
    above = np.cumsum(total[::-1])[::-1]  # voxels in this bin and all brighter ones
    straddling = int(np.searchsorted(-above, -count, side="right")) - 1
    if straddling < 0:
        return np.ones(field.shape, bool)
    chosen = ranks > straddling
    tied = np.flatnonzero(ranks.ravel() == straddling)
    places = np.unravel_index(tied, field.shape)
    around = np.zeros(len(tied), np.int32)
    for offset in np.ndindex(3, 3, 3):
        near = [np.clip(p + o - 1, 0, side - 1) for p, o, side in zip(places, offset, field.shape, strict=True)]
        around += field[tuple(near)]
    missing = count - int(np.count_nonzero(chosen))
    chosen.ravel()[tied[np.argsort(-around, kind="stable")[:missing]]] = True
    return chosen


def _ranked(field: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every voxel's mixed value as a bin number (uint16), and how many voxels each bin holds."""
    ranks = np.empty(field.shape, np.uint16)
    for_slabs(lambda a, b: _rank_values(field, ranks, a, b), len(field))
    total = np.zeros(_BINS, np.int64)
    for plane in ranks:  # one at a time, since bincount widens what it is given to 8 bytes a voxel
        total += np.bincount(plane.ravel(), minlength=_BINS)
    return ranks, total


@inline
def _at(field, z, y, x):
    Z, Y, X = field.shape
    return np.int32(field[min(max(z, 0), Z - 1), min(max(y, 0), Y - 1), min(max(x, 0), X - 1)])


@kernel
def _rank_values(field, ranks, start, stop):
    for z in range(start, stop):
        for y in range(field.shape[1]):
            for x in range(field.shape[2]):
                around = _at(field, z - 1, y, x) + _at(field, z + 1, y, x) + _at(field, z, y - 1, x)
                around += _at(field, z, y + 1, x) + _at(field, z, y, x - 1) + _at(field, z, y, x + 1)
                mixed = (np.int32(field[z, y, x]) * _OWN + around) // (_OWN + 6)
                ranks[z, y, x] = np.uint16(mixed + 32768)
