"""Pairs at one offset: the image laid over its shifted copy."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np


def pack_lines(inside: np.ndarray, axis: int) -> np.ndarray:
    """Put `axis` first and pack the other two to bits: a shift along `axis` is a slice, and a word
    holds 64 voxels.
    """
    lines = np.moveaxis(inside, axis, 0)
    flat = np.packbits(lines.reshape(len(lines), -1), axis=1)
    words = np.zeros((len(flat), -(-flat.shape[1] // 8) * 8), np.uint8)
    words[:, : flat.shape[1]] = flat
    return words.view(np.uint64)


def count_along(
    first: np.ndarray, second: np.ndarray | None, r_max: int, *, axis: int, step: int, wrap: bool
) -> np.ndarray:
    """Count pairs along an axis, r = 0 .. r_max times `step` voxels apart; with a second phase the
    mean of both orders.
    """
    before = r_max * step if wrap else 0
    ours = prepend_wrapped(pack_lines(first, axis), before)
    if second is None:
        return count_pairs_ending(ours, ours, r_max, step=step, before=before)
    theirs = prepend_wrapped(pack_lines(second, axis), before)
    there = count_pairs_ending(ours, theirs, r_max, step=step, before=before)
    return (there + count_pairs_ending(theirs, ours, r_max, step=step, before=before)) / 2


def prepend_wrapped(lines: np.ndarray, before: int) -> np.ndarray:
    """Return the packed lines of a periodic axis, with the last `before` of them in front."""
    return np.concatenate([lines[len(lines) - before :], lines]) if before else lines


def count_pairs_ending(
    ours: np.ndarray, theirs: np.ndarray, r_max: int, *, step: int = 1, before: int = 0
) -> np.ndarray:
    """Count the pairs of packed lines r = 0 .. r_max times `step` apart that end, in `theirs`, at
    line `before` or a later one.

    The lines in front are those that such pairs may begin in: the last ones of a periodic axis, or
    of the slab before.
    """
    counts = np.empty(r_max + 1)
    for r in range(r_max + 1):
        first = max(before, r * step)
        begin = ours[first - r * step : max(0, len(ours) - r * step)]
        counts[r] = np.bitwise_count(begin & theirs[first:]).sum(dtype=np.int64)
    return counts


def count_segments_ending(lines: np.ndarray, r_max: int, *, before: int = 0) -> np.ndarray:
    """Count the runs of r + 1 packed lines, r = 0 .. r_max, that are True all along and end at line
    `before` or a later one.
    """
    counts = np.empty(r_max + 1)
    ends = lines[before:]
    for r in range(r_max + 1):
        # A segment of r + 1 voxels is one of r voxels with another in front: no need to look at
        # every length anew.
        if r:
            ends = ends[int(r > before) :] & lines[max(0, before - r) : max(0, len(lines) - r)]
        counts[r] = np.bitwise_count(ends).sum(dtype=np.int64)
    return counts


def both(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return whether both ends are True."""
    return here & there


def alike(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return whether both ends have the same label, other than 0."""
    return (here == there) & (here > 0)


def count_offset(
    first: np.ndarray,
    second: np.ndarray,
    offset: tuple[int, ...],
    wraps: tuple[bool, ...],
    match: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> int:
    """Count the voxels of `first` that match those of `second` one `offset` further."""
    over_z, over_y, over_x = (
        _overlaps(*axis) for axis in zip(first.shape, offset, wraps, strict=True)
    )
    total = 0
    for here, there in over_z:
        # Plane by plane: what is compared stays in the cache.
        for ours, theirs in zip(first[here], second[there], strict=True):
            for y, x in product(over_y, over_x):
                total += np.count_nonzero(match(ours[y[0], x[0]], theirs[y[1], x[1]]))
    return total


def _overlaps(side: int, step: int, wrap: bool) -> list[tuple[slice, slice]]:
    """Return the parts of an axis, and their places `step` further."""
    ahead, behind = max(0, step), max(0, -step)
    parts = [(slice(behind, side - ahead), slice(ahead, side - behind))]
    if wrap and ahead:
        parts.append((slice(side - ahead, side), slice(0, ahead)))
    if wrap and behind:
        parts.append((slice(0, behind), slice(side - behind, side)))
    return parts
