"""Monotone transport along axes: every value goes where its rank lies among others, through
histograms.

Values that share a bin of the common histogram go together, to the mean of the others over the
ranks that they cover. All of them are whole numbers, so that the result depends neither on how they
are cut into parts nor on the order of these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from trabecula.engine.parallel import for_slabs, sum_slabs
from trabecula.synth.shared.statistics.sliced_kernels import (
    destinations,
    extremes,
    moves,
    tally,
    tally_sums,
)

BINS = 1024
"""Of a histogram along an axis."""

AT_ONCE = 1024
"""Values an axis that are worked on together: so many rows of 64 lie in the cache."""

Parts = Callable[[int, int], Iterable[np.ndarray]]
"""Rows (n, P) float32 of whole numbers that slab start..stop holds, a few at a time."""


@dataclass(frozen=True)
class Transport:
    """Along every axis of (n, P): bins of `size` (P,) from `low` (P,), and where the values of each
    go, `table` (P, BINS).
    """

    low: np.ndarray
    size: np.ndarray
    table: np.ndarray

    @classmethod
    def between(cls, ours: Parts, length: int, theirs: np.ndarray) -> Transport:
        """From all parts of slabs that cover 0..length, a row at least, to `theirs` (m, P) float32."""
        others = partial(_few, theirs)
        low, high = theirs.min(axis=0).astype(np.int64), theirs.max(axis=0).astype(np.int64)
        low, high = _ends(ours, length, low, high)
        size = (high - low) // BINS + 1

        def counted(start: int, stop: int) -> np.ndarray:
            counts = np.zeros((len(low), BINS), np.int64)
            for rows in ours(start, stop):
                tally(rows, low, size, counts)
            return counts

        def summed(start: int, stop: int) -> np.ndarray:
            counts = np.zeros((2, len(low), BINS), np.int64)
            for rows in others(start, stop):
                tally_sums(rows, low, size, counts)
            return counts

        mine = sum_slabs(counted, length, least=2)
        table = np.zeros((len(low), BINS))
        destinations(mine, sum_slabs(summed, len(theirs), least=4 * AT_ONCE), table)
        return cls(low, size, table)

    def moves(self, rows: np.ndarray) -> np.ndarray:
        """How far each value of (n, P) float32 goes, float64."""
        found = np.empty(rows.shape)
        moves(rows, self.low, self.size, self.table, found)
        return found


def _ends(
    ours: Parts, length: int, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The least and the largest value along every axis, where others lie from `low` to `high`."""
    least, most = np.tile(low, (length, 1)), np.tile(high, (length, 1))

    def work(start: int, stop: int) -> None:
        for rows in ours(start, stop):
            extremes(rows, least[start], most[start])

    for_slabs(work, length, least=2)
    return least.min(axis=0), most.max(axis=0)


def _few(rows: np.ndarray, start: int, stop: int) -> Iterator[np.ndarray]:
    for first in range(start, stop, AT_ONCE):
        yield rows[first : min(first + AT_ONCE, stop)]
