"""Arrays made, counted and turned slab by slab, so that no whole temporary array is needed, and
large ones may be memory-mapped.

A volume seen along y or x is a copy with another axis first, made plane by plane of the original: a
plane stays in the cache while its lines are written; turned as a whole every value would be a cache
miss. Of memory-mapped arrays no more than the pages of a slab are touched at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs, sum_slabs

AT_ONCE = 1 << 18
"""Voxels: what NumPy makes of so many in between is small, and still in the cache."""


def for_plane_groups(
    work: Callable[[int, int], object], shape: Sequence[int], *, at_once: int = AT_ONCE
) -> None:
    """Call `work` on groups of planes of (..., Z, Y, X) that hold `at_once` voxels at most, by
    `for_slabs`.
    """
    thick = _thickness(shape, at_once)

    def pieces(start: int, stop: int) -> None:
        for first in range(start, stop, thick):
            work(first, min(first + thick, stop))

    for_slabs(pieces, shape[-3])


def make_by_slabs(make: Callable[[int, int], Any], shape: Sequence[int], dtype: Any) -> np.ndarray:
    """Make (..., Z, Y, X) of the planes (or the one value for all of them) that `make(start, stop)`
    returns.
    """
    made = memmap.empty(shape, dtype)

    def work(start: int, stop: int) -> None:
        made[..., start:stop, :, :] = make(start, stop)

    for_plane_groups(work, made.shape)
    return made


def count_true(inside: np.ndarray) -> int:
    """Count the voxels of (Z, Y, X) bool that are True."""
    return int(
        sum_slabs(lambda start, stop: int(np.count_nonzero(inside[start:stop])), len(inside))
    )


def tally_by_slabs(tally: Callable[[int, int], np.ndarray], shape: Sequence[int]) -> np.ndarray:
    """Sum the counts of whole numbers that `tally(start, stop)` returns over all planes of (..., Z,
    Y, X).
    """
    thick = _thickness(shape)

    def pieces(start: int, stop: int) -> np.ndarray:
        parts = (tally(first, min(first + thick, stop)) for first in range(start, stop, thick))
        return np.asarray(sum(parts))

    return np.asarray(sum_slabs(pieces, shape[-3]))


def _thickness(shape: Sequence[int], at_once: int = AT_ONCE) -> int:
    return max(1, at_once // max(1, shape[-2] * shape[-1]))


def intersection(first: np.ndarray | None, second: np.ndarray | None) -> np.ndarray | None:
    """Mark the voxels of both of two masks (Z, Y, X); None stands for one that is True
    everywhere.
    """
    if first is None or second is None:
        return second if first is None else first
    return make_by_slabs(lambda a, b: first[a:b] & second[a:b], first.shape, bool)


def complement(mask: np.ndarray) -> np.ndarray:
    """Mark the voxels outside a mask (Z, Y, X)."""
    return make_by_slabs(lambda a, b: ~mask[a:b], mask.shape, bool)


def axis_order(axis: int) -> tuple[int, int, int]:
    """Return the axes of a volume with `axis` first."""
    rows, columns = (other for other in range(3) if other != axis)
    return axis, rows, columns


def put_axis_first(values: np.ndarray, axis: int) -> np.ndarray:
    """Return an array (..., Z, Y, X) with `axis` (0 z, 1 y, 2 x) first of its last three,
    contiguous.

    Along z it is the array itself, where that is contiguous.
    """
    if axis == 0 and values.flags.c_contiguous:
        return values
    seen = memmap.empty(
        (*values.shape[:-3], *shape_with_axis_first(values.shape[-3:], axis)), values.dtype
    )
    back = _back(seen, axis)

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            back[..., z, :, :] = values[..., z, :, :]

    for_slabs(work, values.shape[-3])
    return seen


def restore_axis_order(
    seen: np.ndarray, axis: int, values: np.ndarray, *, add: bool = False
) -> None:
    """Undo `put_axis_first`, into `values` (..., Z, Y, X); with `add`, add to them."""
    back = _back(seen, axis)

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            if add:
                values[..., z, :, :] += back[..., z, :, :]
            else:
                values[..., z, :, :] = back[..., z, :, :]

    for_slabs(work, values.shape[-3])


def shape_with_axis_first(shape: Sequence[int], axis: int) -> tuple[int, int, int]:
    """Return the sides of a volume with `axis` first."""
    z, y, x = (shape[a] for a in axis_order(axis))
    return z, y, x


def _back(seen: np.ndarray, axis: int) -> np.ndarray:
    """View a turned array in the order of the volume."""
    return np.moveaxis(seen, -3, axis - 3)
