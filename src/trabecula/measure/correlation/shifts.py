"""Pairs at one offset, by laying the image over its shifted copy."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np


def packed(inside: np.ndarray, axis: int) -> np.ndarray:
    """`axis` first, the other two packed to bits: a shift along `axis` is a slice, and a word holds 64 voxels."""
    lines = np.moveaxis(inside, axis, 0)
    flat = np.packbits(lines.reshape(len(lines), -1), axis=1)
    words = np.zeros((len(flat), -(-flat.shape[1] // 8) * 8), np.uint8)
    words[:, : flat.shape[1]] = flat
    return words.view(np.uint64)


def count_along(
    first: np.ndarray, second: np.ndarray | None, r_max: int, *, axis: int, step: int, wrap: bool
) -> np.ndarray:
    """Pairs along an axis, r = 0 .. r_max times `step` voxels apart; with a second phase the mean of both orders."""
    if second is None:
        ours = packed(first, axis)
        return _shifted(ours, ours, r_max, step, wrap)
    ours, theirs = packed(first, axis), packed(second, axis)
    return (_shifted(ours, theirs, r_max, step, wrap) + _shifted(theirs, ours, r_max, step, wrap)) / 2


def _shifted(ours: np.ndarray, theirs: np.ndarray, r_max: int, step: int, wrap: bool) -> np.ndarray:
    side = len(ours)
    if wrap:
        theirs = np.concatenate([theirs, theirs[: r_max * step]])
    counts = np.empty(r_max + 1)
    for r in range(r_max + 1):
        count = side if wrap else side - r * step
        counts[r] = np.bitwise_count(ours[:count] & theirs[r * step : r * step + count]).sum(dtype=np.int64)
    return counts


def both(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Both ends True."""
    return here & there


def alike(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Both ends with the same label, other than 0."""
    return (here == there) & (here > 0)


def count_offset(
    first: np.ndarray,
    second: np.ndarray,
    offset: tuple[int, ...],
    wraps: tuple[bool, ...],
    match: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> int:
    """Voxels of `first` that match those of `second` one `offset` further."""
    over_z, over_y, over_x = (_overlaps(*axis) for axis in zip(first.shape, offset, wraps, strict=True))
    total = 0
    for here, there in over_z:
        # Plane by plane: what is compared stays in the cache.
        for ours, theirs in zip(first[here], second[there], strict=True):
            for y, x in product(over_y, over_x):
                total += np.count_nonzero(match(ours[y[0], x[0]], theirs[y[1], x[1]]))
    return total


def _overlaps(side: int, step: int, wrap: bool) -> list[tuple[slice, slice]]:
    """The parts of an axis, and where they lie `step` further."""
    ahead, behind = max(0, step), max(0, -step)
    parts = [(slice(behind, side - ahead), slice(ahead, side - behind))]
    if wrap and ahead:
        parts.append((slice(side - ahead, side), slice(0, ahead)))
    if wrap and behind:
        parts.append((slice(0, behind), slice(side - behind, side)))
    return parts
