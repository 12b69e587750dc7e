"""The joint between free and known voxels: no step across it, and the surroundings' fractions on
both sides.

The votes disagree with known voxels beside the joint by some offset. That offset is spread into
the free voxels as a membrane (the boundary condition of Perez, Gangnet, Blake 2003,
doi:10.1145/882262.882269), so that interfaces meet; the next search then finds neighbourhoods that
fit both sides. And a hole in a dense corner is filled as densely: the known voxels near by and the
exemplar count as one sample, each by how many voxels it stands for.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import kernel
from trabecula.engine.memory import Array, Stage, Workspace
from trabecula.engine.parallel import for_slabs
from trabecula.measure.distance import distance_transform
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.slabs import (
    complement,
    count_true,
    for_plane_groups,
    make_by_slabs,
    tally_by_slabs,
)

_STEPS = 20  # relaxations of the membrane: it reaches about half as many voxels
_PARTS = 1 << 20  # resolution of a mixed histogram


def find_known(free: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Mark the voxels whose value is given, at least its sign."""
    return make_by_slabs(
        lambda a, b: ~free[a:b] & ((low[0, a:b] > -127) | (high[0, a:b] < 127)), free.shape, bool
    )


def surroundings(free: np.ndarray, known: np.ndarray, width: int) -> np.ndarray:
    """Mark the known voxels no farther than `width` voxels from a free one."""
    if not count_true(free):
        return memmap.zeros(known.shape, bool)
    distance = distance_transform(complement(free))
    return make_by_slabs(lambda a, b: known[a:b] & (distance[a:b] <= width), known.shape, bool)


def pool_fractions(near: int, made: int, own: np.ndarray, exemplar: np.ndarray) -> np.ndarray:
    """Average the fractions of the exemplar and of `near` known voxels, as of one sample with the
    `made` free voxels, which follow the exemplar.
    """
    return np.asarray((near * own + made * exemplar) / max(1, near + made))


def pool_histograms(
    targets: Sequence[Histogram], low: np.ndarray, high: np.ndarray, near: np.ndarray, made: int
) -> tuple[Histogram, ...]:
    """Mix the targets (of int8) with the known voxels `near`, whose values are within low .. high
    (C, Z, Y, X) int8.
    """
    mixed = []
    for target, least, most in zip(targets, low, high, strict=True):
        held = tally_by_slabs(partial(_middles, least, most, near), near.shape)
        size = int(held.sum())
        exemplar, own = np.zeros(256), held / max(1, size)
        exemplar[target.values.astype(np.int64) + 128] = (
            np.diff(target.up_to, prepend=0) / target.up_to[-1]
        )
        parts = np.rint(pool_fractions(size, made, own, exemplar) * _PARTS).astype(np.int64)
        present = np.flatnonzero(parts)
        mixed.append(Histogram((present - 128).astype(np.int8), np.cumsum(parts[present])))
    return tuple(mixed)


def _middles(
    low: np.ndarray, high: np.ndarray, near: np.ndarray, start: int, stop: int
) -> np.ndarray:
    """Count the values, from -128 on, in the middle of the bounds of the voxels `near`."""
    at = near[start:stop]
    middle = (low[start:stop][at].astype(np.int64) + high[start:stop][at]) // 2
    return np.bincount(middle + 128, minlength=256)


def spread_offset(
    votes: np.ndarray, low: np.ndarray, high: np.ndarray, free: np.ndarray
) -> np.ndarray:
    """Spread the offset of votes (C, Z, Y, X) int16 from known voxels, low .. high int8, into the
    free ones, in place; return the votes.
    """
    work = Workspace(joint_stages(free.shape))
    work.enter("join")
    known = work.adopt("known", find_known(free, low, high))
    offset, other = work.empty("offset"), work.empty("next offset")
    for channel, least, most in zip(votes, low, high, strict=True):
        for_plane_groups(partial(_miss, channel, least, most, known, offset), free.shape)
        for _ in range(_STEPS):
            for_slabs(partial(_relax, offset, known, free, other), len(free))
            offset, other = other, offset
        for_plane_groups(partial(_move, channel, free, offset), free.shape)
    return votes


def joint_stages(shape: Sequence[int]) -> tuple[Stage, ...]:
    """Declare the arrays of `spread_offset` beside the votes."""
    offset = Array(shape, np.float32)
    arrays = {"known": Array(shape, bool), "offset": offset, "next offset": offset}
    return (Stage("join", arrays),)


def _miss(
    votes: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    known: np.ndarray,
    offset: np.ndarray,
    start: int,
    stop: int,
) -> None:
    """Write the distance of known voxels from their bounds."""
    part = votes[start:stop]
    given = np.clip(
        part, low[start:stop].astype(np.int16) * 256, high[start:stop].astype(np.int16) * 256
    )
    offset[start:stop] = np.where(known[start:stop], given.astype(np.float32) - part, np.float32(0))


def _move(
    votes: np.ndarray,
    free: np.ndarray,
    offset: np.ndarray,
    start: int,
    stop: int,
) -> None:
    moved = votes[start:stop] + np.where(
        free[start:stop], np.rint(offset[start:stop]), np.float32(0)
    )
    votes[start:stop] = np.clip(moved, -32512, 32512)


@kernel
def _relax(old, known, free, new, start, stop):
    """Average the six neighbours of every free voxel; known ones stay."""
    Z, Y, X = old.shape
    for z in range(start, stop):
        for y in range(Y):
            for x in range(X):
                if known[z, y, x]:
                    new[z, y, x] = old[z, y, x]
                elif free[z, y, x]:
                    total = old[max(z - 1, 0), y, x] + old[min(z + 1, Z - 1), y, x]
                    total += old[z, max(y - 1, 0), x] + old[z, min(y + 1, Y - 1), x]
                    total += old[z, y, max(x - 1, 0)] + old[z, y, min(x + 1, X - 1)]
                    new[z, y, x] = total / np.float32(6)
                else:
                    new[z, y, x] = 0
