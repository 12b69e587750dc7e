"""The brightest voxels of a field, to the voxel: which ones they are among equals does not depend
on how work is cut.

Three passes: counts of the ranks (`histogram`) say in which rank the last of them lies, and what
lies above is taken; the sums over 3 x 3 x 3 voxels of those in that rank are counted; the largest
of these sums are taken, the last ones in raster order.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import in_order, sum_slabs
from trabecula.synth.shared.histogram import rank_counts, row_of_ranks

_TIED = 2  # beside 0 and 1, until it is settled


def brightest_voxels(field: np.ndarray, count: int, inside: np.ndarray | None = None) -> np.ndarray:
    """The `count` brightest voxels of (Z, Y, X) int16 (of those `inside`) as a mask, to the voxel.

    Ties of the mixed value are broken by the sum over 3 x 3 x 3 voxels, and what ties even there by
    raster order.
    """
    total = rank_counts(field, inside)
    above = np.cumsum(total[::-1])[::-1]  # voxels of this rank and all brighter ones
    # the rank of the last; -1 where there are too few
    level = int(np.searchsorted(-above, -count, side="right")) - 1
    missing = count - int(above[level + 1]) if 0 <= level < len(above) - 1 else count
    chosen = memmap.empty(field.shape, np.uint8)
    tied = np.zeros(len(field), np.int64)  # in every plane
    where = np.empty((0, 0, 0), bool) if inside is None else inside

    def split(start: int, stop: int) -> _Sums:
        _split(field, where, level, chosen, tied, start, stop)
        planes = start + np.flatnonzero(tied[start:stop])
        return sum(
            (_Sums.of(_sums_of_tied(field, chosen, z, int(tied[z]))) for z in planes), _Sums.of([])
        )

    sums = sum_slabs(split, len(field))
    if len(sums.values):
        _settle(field, chosen, tied, sums, missing)
    return chosen.view(bool)


@dataclass(frozen=True)
class _Sums:
    """How often each of some sums occurs."""

    values: np.ndarray  # rising
    counts: np.ndarray

    @classmethod
    def of(cls, sums: Any) -> _Sums:
        return cls(*np.unique(np.asarray(sums, np.int32), return_counts=True))

    def __add__(self, other: _Sums) -> _Sums:
        values, place = np.unique(np.concatenate([self.values, other.values]), return_inverse=True)
        counts = np.zeros(len(values), np.int64)
        counts[place[: len(self.values)]] = self.counts
        counts[place[len(self.values) :]] += other.counts
        return _Sums(values, counts)


def _settle(
    field: np.ndarray, chosen: np.ndarray, tied: np.ndarray, sums: _Sums, missing: int
) -> None:
    """Of the voxels marked as tied take as many as are missing: the largest sums, and of equal ones
    the first.
    """
    above = np.cumsum(sums.counts[::-1])[::-1]  # voxels of this sum and all larger ones
    place = int(np.searchsorted(-above, -missing, side="right")) - 1
    last = int(sums.values[place])
    left = missing - (int(above[place + 1]) if place + 1 < len(above) else 0)

    def settle(start: int, stop: int) -> None:
        nonlocal left
        for z in start + np.flatnonzero(tied[start:stop]):
            found = _sums_of_tied(field, chosen, z, int(tied[z]))
            equal = found == last
            taken = (found > last) | (equal & (np.cumsum(equal) <= left))
            left -= min(left, int(np.count_nonzero(equal)))
            plane = chosen[z].reshape(-1)
            plane[plane == _TIED] = taken

    in_order(settle, len(field))


def _sums_of_tied(field: np.ndarray, chosen: np.ndarray, z: int, count: int) -> np.ndarray:
    sums = np.empty(count, np.int32)
    _sum_tied(field, chosen[z], z, sums)
    return sums


@kernel
def _split(field, inside, level, chosen, tied, start, stop):
    """1 above a rank, `_TIED` in it, else 0 (an empty `inside` means everywhere); and how many of
    each plane are tied.
    """
    row = np.empty(field.shape[2], np.int32)
    for z in range(start, stop):
        count = 0
        for y in range(field.shape[1]):
            row_of_ranks(field, z, y, row)
            for x in range(len(row)):
                if inside.size > 0 and not inside[z, y, x]:
                    chosen[z, y, x] = 0
                elif row[x] == level:
                    chosen[z, y, x] = _TIED
                    count += 1
                else:
                    chosen[z, y, x] = 1 if row[x] > level else 0
        tied[z] = count


@kernel
def _sum_tied(field, marks, z, sums):
    """For the tied voxels of a plane, in raster order, the sum over 3 x 3 x 3 voxels."""
    _, Y, X = field.shape
    n = 0
    for y in range(Y):
        for x in range(X):
            if marks[y, x] == _TIED:
                sums[n] = _around(field, z, y, x)
                n += 1


@inline
def _around(field, z, y, x):
    """Beyond a face its voxel lies again."""
    Z, Y, X = field.shape
    total = np.int32(0)
    for dz in range(-1, 2):
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                total += field[
                    min(max(z + dz, 0), Z - 1),
                    min(max(y + dy, 0), Y - 1),
                    min(max(x + dx, 0), X - 1),
                ]
    return total
