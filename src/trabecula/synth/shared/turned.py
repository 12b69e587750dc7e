"""Volumes seen along y or x: copies with another axis first, there and back, plane by plane of the
one that lies as it is.

A plane stays in the cache while its lines go where they belong; turned as a whole every value would
be fetched from memory by itself. Of arrays in scratch files no more than the pages of a slab is
touched at a time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs


def axis_order(axis: int) -> tuple[int, int, int]:
    """The axes of a volume with `axis` first."""
    rows, columns = (other for other in range(3) if other != axis)
    return axis, rows, columns


def put_axis_first(values: np.ndarray, axis: int) -> np.ndarray:
    """An array (..., Z, Y, X) with `axis` (0 z, 1 y, 2 x) first of its last three, contiguous.

    Along z it is the array itself, where that is contiguous.
    """
    if axis == 0 and values.flags.c_contiguous:
        return values
    seen = memmap.empty((*values.shape[:-3], *shape_with_axis_first(values.shape[-3:], axis)), values.dtype)
    back = _back(seen, axis)

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            back[..., z, :, :] = values[..., z, :, :]

    for_slabs(work, values.shape[-3])
    return seen


def restore_axis_order(seen: np.ndarray, axis: int, values: np.ndarray, *, add: bool = False) -> None:
    """`put_axis_first` backwards, into `values` (..., Z, Y, X); with `add` added to what is there."""
    back = _back(seen, axis)

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            if add:
                values[..., z, :, :] += back[..., z, :, :]
            else:
                values[..., z, :, :] = back[..., z, :, :]

    for_slabs(work, values.shape[-3])


def shape_with_axis_first(shape: Sequence[int], axis: int) -> tuple[int, int, int]:
    """The sides of a volume with `axis` first."""
    z, y, x = (shape[a] for a in axis_order(axis))
    return z, y, x


def _back(seen: np.ndarray, axis: int) -> np.ndarray:
    """A turned array in the order of the volume, not copied."""
    return np.moveaxis(seen, -3, axis - 3)
