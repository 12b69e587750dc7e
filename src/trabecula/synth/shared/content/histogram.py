"""Histogram matching of a field to an exemplar's, in integers and with few ties.

Votes agree so often that many voxels hold exactly the same value; a rank within such a tie would be
chance, and mapping the whole tie to one value moves the volume fraction by percents. So voxels are
ranked by their value with a small share of their six neighbours' mixed in. The ranks are computed
again when needed, which costs less than memory for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs, sum_slabs

_OWN = 24  # weight of the voxel itself against 1 for each of six neighbours
_BINS = 1 << 16
_PARTS = 1 << 20  # resolution of a reweighted histogram


@dataclass(frozen=True)
class Histogram:
    """The values that occur, rising, and how many of all occurrences lie at or below each (the last
    is all of them).
    """

    values: np.ndarray
    up_to: np.ndarray

    @classmethod
    def of(cls, values: np.ndarray) -> Histogram:
        """Count the values of an array of any type and shape."""
        present, counts = np.unique(values, return_counts=True)
        return cls(present, np.cumsum(counts))

    @classmethod
    def pool(cls, histograms: Sequence[Histogram]) -> Histogram:
        """Pool several of one type of values, as one sample in which each counts alike."""
        present = np.unique(np.concatenate([histogram.values for histogram in histograms]))
        parts = np.zeros(len(present), np.int64)
        for histogram in histograms:
            counts = np.diff(histogram.up_to, prepend=0)
            size = int(counts.sum())
            parts[np.searchsorted(present, histogram.values)] += (
                counts * _PARTS + size // 2
            ) // size
        return cls(present, np.cumsum(parts))

    @classmethod
    def reweight(cls, target: Histogram, positive: float, negative: float) -> Histogram:
        """Return a target of numbers whose values above zero weigh `positive` times as much, and
        those below `negative` times.
        """
        weights = np.where(target.values > 0, positive, np.where(target.values < 0, negative, 1.0))
        return cls._of_shares(target.values, target.shares * weights)

    @classmethod
    def _of_shares(cls, values: np.ndarray, shares: np.ndarray) -> Histogram:
        """Build one from the shares of values, whatever they add up to."""
        parts = np.rint(shares / shares.sum() * _PARTS).astype(np.int64)
        present = parts > 0
        return cls(values[present], np.cumsum(parts[present]))

    @property
    def shares(self) -> np.ndarray:
        """Return the share of all occurrences that each value has."""
        return np.diff(self.up_to, prepend=0) / self.up_to[-1]

    def add(self, changes: np.ndarray) -> Histogram:
        """Return one whose shares differ by `changes`; none falls below 0."""
        return Histogram._of_shares(self.values, np.maximum(self.shares + changes, 0))

    def values_at(self, middle: np.ndarray, size: int) -> np.ndarray:
        """Look up the values at some places of a ranking of `size`."""
        place = middle * int(self.up_to[-1]) // max(1, size)
        return self.values[
            np.minimum(np.searchsorted(self.up_to, place, side="right"), len(self.values) - 1)
        ]


def match_histogram(
    field: np.ndarray,
    target: Histogram,
    inside: np.ndarray | None = None,
    *,
    out: np.ndarray | None = None,
) -> np.ndarray:
    """Map (Z, Y, X) int16 so that its histogram is the target's; order is kept up to ties.

    Parameters
    ----------
    field : (Z, Y, X) int16
    target : Histogram
    inside : (Z, Y, X) bool, optional
        Only these voxels count; the others are mapped alike.
    out : (Z, Y, X) of the target's type, optional
        Where the result goes; it may not be the field.

    Returns
    -------
    (Z, Y, X) of the target's type
    """
    table = matching_table(field, target, inside)
    matched = memmap.empty(field.shape, table.dtype) if out is None else out

    def work(start: int, stop: int) -> None:
        look_up(field, table, matched, 0, start, stop)

    for_slabs(work, len(field))
    return matched


def matching_table(
    field: np.ndarray, target: Histogram, inside: np.ndarray | None = None
) -> np.ndarray:
    """Return the table from every rank of a field to its value (`look_up`), so that its histogram
    is the target's.
    """
    total = rank_counts(field, inside)
    return target.values_at(np.cumsum(total) - total // 2, int(total.sum()))


def rank_counts(field: np.ndarray, inside: np.ndarray | None) -> np.ndarray:
    """Count the voxels (of those inside) of each rank, (65536,) int64."""
    where = np.empty((0, 0, 0), bool) if inside is None else inside

    def tally(start: int, stop: int) -> np.ndarray:
        counts = np.zeros(_BINS, np.int64)
        _count_ranks(field, where, counts, start, stop)
        return counts

    return np.asarray(sum_slabs(tally, len(field)))


def mix_with_neighbours(field: np.ndarray, *, out: np.ndarray | None = None) -> np.ndarray:
    """Rank (Z, Y, X) int16 in uint16, 32768 added, each value mixed with a small share of its
    neighbours': nearly free of ties.
    """
    ranks = memmap.empty(field.shape, np.uint16) if out is None else out
    same = np.arange(_BINS, dtype=np.uint16)

    def work(start: int, stop: int) -> None:
        look_up(field, same, ranks, 0, start, stop)

    for_slabs(work, len(field))
    return ranks


@inline
def row_of_ranks(field, z, y, row):
    """Compute the ranks of a line of voxels: (24 own + six neighbours) // 30 + 32768; a face's
    voxel is repeated beyond it.
    """
    Z, Y, X = field.shape
    own, above, below = field[z, y], field[max(z - 1, 0), y], field[min(z + 1, Z - 1), y]
    before, after = field[z, max(y - 1, 0)], field[z, min(y + 1, Y - 1)]
    for x in range(X):
        around = np.int32(above[x]) + np.int32(below[x]) + np.int32(before[x]) + np.int32(after[x])
        row[x] = around + _OWN * np.int32(own[x]) + (_OWN + 6) * 32768
    for x in range(X - 1):
        row[x] += own[x + 1]
    for x in range(1, X):
        row[x] += own[x - 1]
    row[0] += own[0]
    row[X - 1] += own[X - 1]
    for x in range(X):
        row[x] = np.uint32(row[x]) // np.uint32(_OWN + 6)


@kernel
def look_up(field, table, matched, first, start, stop):
    """Write the table's entry for the rank of every voxel of planes start..stop; `matched` begins
    with plane `first`.
    """
    row = np.empty(field.shape[2], np.int32)
    for z in range(start, stop):
        for y in range(field.shape[1]):
            row_of_ranks(field, z, y, row)
            to = matched[z - first, y]
            for x in range(len(row)):
                to[x] = table[row[x]]


@kernel
def _count_ranks(field, inside, counts, start, stop):
    """Count the ranks of planes start..stop; an empty `inside` means everywhere."""
    row = np.empty(field.shape[2], np.int32)
    for z in range(start, stop):
        for y in range(field.shape[1]):
            row_of_ranks(field, z, y, row)
            for x in range(len(row)):
                if inside.size == 0 or inside[z, y, x]:
                    counts[row[x]] += 1
