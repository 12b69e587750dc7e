"""Where what is made meets what is known: no step across the joint, and the surroundings' share of every value.

The votes disagree with known voxels beside the joint by some offset. That offset is spread into what is made as a membrane
(the boundary condition of Perez, Gangnet, Blake 2003, doi:10.1145/882262.882269), so that interfaces meet; the next search
then finds neighbourhoods that fit both sides. And a hole in a dense corner is filled as densely: the known voxels near by
and the exemplar count as one sample, each by how many voxels it stands for.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.tiles import for_slabs
from trabecula.measure.distance import distance_transform
from trabecula.synth.shared.histogram import Histogram

_STEPS = 20  # relaxations of the membrane: it reaches about half as many voxels
_PARTS = 1 << 20  # resolution of a mixed histogram


def known_of(free: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The voxels whose value is given, at least its sign."""
    return np.asarray(~free & ((low[0] > -127) | (high[0] < 127)))


def surroundings(free: np.ndarray, known: np.ndarray, width: int) -> np.ndarray:
    """The known voxels no farther than `width` voxels from one that is to be made."""
    near = known & (distance_transform(~free) <= width) if free.any() else np.zeros_like(known)
    return np.asarray(near)


def mixed_share(near: int, made: int, own: np.ndarray, exemplar: np.ndarray) -> np.ndarray:
    """Shares of the exemplar and of `near` known voxels, as of one sample; `made` voxels are to follow it."""
    return np.asarray((near * own + made * exemplar) / max(1, near + made))


def mixed_histograms(
    targets: Sequence[Histogram], low: np.ndarray, high: np.ndarray, near: np.ndarray, made: int
) -> tuple[Histogram, ...]:
    """The targets (of int8) mixed with the known voxels `near`, whose values lie in low .. high (C, Z, Y, X) int8."""
    mixed = []
    for target, least, most in zip(targets, low, high, strict=True):
        middle = (least[near].astype(np.int64) + most[near]) // 2
        exemplar, own = np.zeros(256), np.bincount(middle + 128, minlength=256) / max(1, len(middle))
        exemplar[target.values.astype(np.int64) + 128] = np.diff(target.up_to, prepend=0) / target.up_to[-1]
        parts = np.rint(mixed_share(len(middle), made, own, exemplar) * _PARTS).astype(np.int64)
        present = np.flatnonzero(parts)
        mixed.append(Histogram((present - 128).astype(np.int8), np.cumsum(parts[present])))
    return tuple(mixed)


def joined(votes: np.ndarray, low: np.ndarray, high: np.ndarray, free: np.ndarray) -> np.ndarray:
    """Votes (C, Z, Y, X) int16 with their offset from what is known, low .. high int8, spread into what is free."""
    result = votes.copy()
    known = known_of(free, low, high)
    for channel, least, most in zip(result, low, high, strict=True):
        given = np.clip(channel, least.astype(np.int16) * 256, most.astype(np.int16) * 256)
        offset = np.where(known, given.astype(np.float32) - channel, np.float32(0))
        for _ in range(_STEPS):
            new = np.empty_like(offset)
            for_slabs(partial(_relax, offset, known, free, new), len(free))
            offset = new
        moved = channel + np.where(free, np.rint(offset), np.float32(0))
        channel[:] = np.clip(moved, -32512, 32512)
    return result


@kernel
def _relax(old, known, free, new, start, stop):
    """The mean of the six neighbours where a voxel is free; what is known stays."""
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
