"""Histogram matching of a field to an exemplar's, in integers and with few ties.

Votes agree so often that many voxels hold exactly the same value; a rank within such a tie would be chance, and mapping the
whole tie to one value moves the volume fraction by percents. So voxels are ranked by their value with a small share of
their six neighbours' mixed in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from threading import Lock

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.tiles import for_slabs

_OWN = 24  # weight of the voxel itself against 1 for each of six neighbours
_BINS = 1 << 16
_PARTS = 1 << 20  # resolution of a histogram that leans


@dataclass(frozen=True)
class Histogram:
    """The values that occur, rising, and how many of all occurrences lie at or below each (the last is all of them)."""

    values: np.ndarray
    up_to: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray) -> Histogram:
        """Of an array of any type and shape."""
        present, counts = np.unique(values, return_counts=True)
        return cls(present, np.cumsum(counts))

    @classmethod
    def pooled(cls, histograms: Sequence[Histogram]) -> Histogram:
        """Of several of one type of values, as of one sample in which each counts alike."""
        present = np.unique(np.concatenate([histogram.values for histogram in histograms]))
        parts = np.zeros(len(present), np.int64)
        for histogram in histograms:
            counts = np.diff(histogram.up_to, prepend=0)
            size = int(counts.sum())
            parts[np.searchsorted(present, histogram.values)] += (counts * _PARTS + size // 2) // size
        return cls(present, np.cumsum(parts))

    @classmethod
    def leaning(cls, target: Histogram, positive: float, negative: float) -> Histogram:
        """A target of numbers whose values above zero weigh `positive` times as much, and those below `negative` times."""
        counts = np.diff(target.up_to, prepend=0) / target.up_to[-1]
        counts = counts * np.where(target.values > 0, positive, np.where(target.values < 0, negative, 1.0))
        parts = np.rint(counts / counts.sum() * _PARTS).astype(np.int64)
        present = parts > 0
        return cls(target.values[present], np.cumsum(parts[present]))

    def ranked(self, middle: np.ndarray, size: int) -> np.ndarray:
        """The values at these places of a ranking of `size`."""
        place = middle * int(self.up_to[-1]) // max(1, size)
        return self.values[np.minimum(np.searchsorted(self.up_to, place, side="right"), len(self.values) - 1)]


def match_histogram(field: np.ndarray, target: Histogram, inside: np.ndarray | None = None) -> np.ndarray:
    """Map (Z, Y, X) int16 so that its histogram is the target's; order is kept up to ties.

    Parameters
    ----------
    field : (Z, Y, X) int16
    target : Histogram
    inside : (Z, Y, X) bool, optional
        Only these voxels count; the others are mapped alike.

    Returns
    -------
    (Z, Y, X) of the target's type
    """
    ranks, total = _ranked(field, inside)
    table = target.ranked(np.cumsum(total) - total // 2, int(total.sum()))
    matched = np.empty(field.shape, table.dtype)

    def work(start: int, stop: int) -> None:
        _look_up(table, ranks, matched, start, stop)

    for_slabs(work, len(field))
    return matched


def brightest(field: np.ndarray, count: int, inside: np.ndarray | None = None) -> np.ndarray:
    """The `count` brightest voxels of (Z, Y, X) int16 (of those `inside`) as a mask, to the voxel.

    Ties of the mixed value are broken by the sum over 3 x 3 x 3 voxels, and what ties even there by raster order.
    """
    ranks, total = _ranked(field, inside)
    above = np.cumsum(total[::-1])[::-1]  # voxels in this bin and all brighter ones
    straddling = int(np.searchsorted(-above, -count, side="right")) - 1
    chosen = ranks > straddling
    if straddling < 0:
        chosen[:] = True
    if inside is not None:
        chosen &= inside
    if straddling < 0:
        return chosen
    tied = np.flatnonzero((ranks == straddling) if inside is None else (ranks == straddling) & inside)
    places = np.unravel_index(tied, field.shape)
    around = np.zeros(len(tied), np.int32)
    for offset in np.ndindex(3, 3, 3):
        near = [np.clip(p + o - 1, 0, side - 1) for p, o, side in zip(places, offset, field.shape, strict=True)]
        around += field[tuple(near)]
    missing = count - int(np.count_nonzero(chosen))
    chosen.ravel()[tied[np.argsort(-around, kind="stable")[:missing]]] = True
    return chosen


def mixed_with_neighbours(field: np.ndarray) -> np.ndarray:
    """(Z, Y, X) int16 in uint16, 32768 added, each value with a small share of its neighbours': nearly free of ties."""
    return _ranked(field, None)[0]


def _ranked(field: np.ndarray, inside: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Every voxel's mixed value as a bin number (uint16), and how many of the voxels inside each bin holds."""
    ranks = np.empty(field.shape, np.uint16)
    where = np.empty((0, 0, 0), bool) if inside is None else inside
    total, lock = np.zeros(_BINS, np.int64), Lock()

    def work(start: int, stop: int) -> None:
        counts = np.zeros(_BINS, np.int64)
        _rank_values(field, where, ranks, counts, start, stop)
        with lock:
            total[:] += counts

    for_slabs(work, len(field))
    return ranks, total


@inline
def _at(field, z, y, x):
    Z, Y, X = field.shape
    return np.int32(field[min(max(z, 0), Z - 1), min(max(y, 0), Y - 1), min(max(x, 0), X - 1)])


@kernel
def _look_up(table, ranks, matched, start, stop):
    """In a kernel, since NumPy would widen every index to 8 bytes and let no other thread work meanwhile."""
    for z in range(start, stop):
        for y in range(ranks.shape[1]):
            for x in range(ranks.shape[2]):
                matched[z, y, x] = table[ranks[z, y, x]]


@kernel
def _rank_values(field, inside, ranks, counts, start, stop):
    """An empty `inside` means everywhere."""
    for z in range(start, stop):
        for y in range(field.shape[1]):
            for x in range(field.shape[2]):
                around = _at(field, z - 1, y, x) + _at(field, z + 1, y, x) + _at(field, z, y - 1, x)
                around += _at(field, z, y + 1, x) + _at(field, z, y, x - 1) + _at(field, z, y, x + 1)
                mixed = (np.int32(field[z, y, x]) * _OWN + around) // (_OWN + 6)
                rank = np.uint16(mixed + 32768)
                ranks[z, y, x] = rank
                if inside.size == 0 or inside[z, y, x]:
                    counts[rank] += 1
