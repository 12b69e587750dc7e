"""Sums over the windows around every voxel: running sums along one axis after the
other, in place.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs
from trabecula.synth.shared.slabs import tally_by_slabs


def window_sums(values: np.ndarray, width: int, wraps: tuple[bool, ...]) -> np.ndarray:
    """Sum over the windows of `width` voxels around every voxel, (Z, Y, X) int32; beyond an open
    face is nothing.
    """
    return window_sums_of_planes(lambda a, b: values[a:b], values.shape, width, wraps)[0]


def window_sums_of_planes(
    values: Callable[[int, int], np.ndarray],
    shape: tuple[int, ...],
    width: int,
    wraps: tuple[bool, ...],
) -> tuple[np.ndarray, int]:
    """Do `window_sums` on a volume whose planes a..b are `values(a, b)`; return the sum of all of
    it as well.
    """
    total = memmap.empty(shape, np.int32)

    def work(start: int, stop: int) -> np.ndarray:
        total[start:stop] = values(start, stop)
        found = total[start:stop].sum(dtype=np.int64)
        _slide_in_planes(total, width, wraps, start, stop)
        return np.asarray(found)

    found = int(tally_by_slabs(work, shape))
    _slide_across(total, width, wraps)
    return total, found


def replace_by_window_sums(
    total: np.ndarray, width: int, wraps: tuple[bool, ...], change: Callable[[int, int], None]
) -> None:
    """Sum over windows, in place, after `change(start, stop)` of the planes of `total`."""

    def work(start: int, stop: int) -> None:
        change(start, stop)
        _slide_in_planes(total, width, wraps, start, stop)

    for_slabs(work, len(total))
    _slide_across(total, width, wraps)


def _slide_in_planes(
    total: np.ndarray, width: int, wraps: tuple[bool, ...], start: int, stop: int
) -> None:
    """Sum along y and x, in place."""
    _slide(total, False, width, wraps[1], start, stop)
    _slide_last(total, width, wraps[2], start, stop)


def _slide_across(total: np.ndarray, width: int, wraps: tuple[bool, ...]) -> None:
    """Sum along z, in place: whole columns, by rows of them."""
    for_slabs(lambda start, stop: _slide(total, True, width, wraps[0], start, stop), total.shape[1])


@inline
def _row(lines, along_first, n, k):
    return lines[k, n] if along_first else lines[n, k]


@kernel
def _slide(lines, along_first, width, wraps, start, stop):
    """Write running sums along the first axis, or the second, for start..stop of the other, in
    place; all of a row at once.
    """
    # of the voxels beside a voxel: itself counts to those after
    before, after = width // 2, width - width // 2
    side, across = lines.shape[0] if along_first else lines.shape[1], lines.shape[2]
    kept, total = np.empty((side, across), np.int32), np.empty(across, np.int32)
    for n in range(start, stop):
        total[:] = 0
        # loops and no sums of arrays: those take Numba seconds to compile
        for k in range(side):
            row = _row(lines, along_first, n, k)
            for x in range(across):
                kept[k, x] = row[x]
        for k in range(-before, after):
            if wraps or 0 <= k < side:
                beside = kept[k % side]
                for x in range(across):
                    total[x] += beside[x]
        for k in range(side):
            row = _row(lines, along_first, n, k)
            low, high = k - before, k + after
            for x in range(across):
                row[x] = total[x]
            if wraps or high < side:
                entering = kept[high % side]
                for x in range(across):
                    total[x] += entering[x]
            if wraps or low >= 0:
                leaving = kept[low % side]
                for x in range(across):
                    total[x] -= leaving[x]


@kernel
def _slide_last(lines, width, wraps, start, stop):
    """Write running sums along the last axis, in place."""
    side, before = lines.shape[2], width // 2
    line = np.zeros(side + width, np.int32)  # continued beyond both ends: there are no cases inside
    for n in range(start, stop):
        for m in range(lines.shape[1]):
            row = lines[n, m]
            for k in range(side):
                line[before + k] = row[k]
            if wraps:
                for k in range(before):
                    line[before - 1 - k] = row[(side - 1 - k) % side]
                for k in range(width - before):
                    line[before + side + k] = row[k % side]
            total = np.int32(0)
            for k in range(width):
                total += line[k]
            for k in range(side):
                row[k] = total
                total += line[k + width] - line[k]
