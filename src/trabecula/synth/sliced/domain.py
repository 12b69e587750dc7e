"""Where a request is made: a torus where nothing is known, so that no place is special; else the request's own grid."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from trabecula.core.request import Request
from trabecula.synth.shared.content import Bounds
from trabecula.synth.shared.fields import quantise
from trabecula.synth.shared.matching.region import Region


def torus(request: Request, top: int, least: int) -> list[Region]:
    """The regions of levels 0 .. `top`; an open axis goes on to whole voxels of the coarsest, `least` of them at least."""
    whole = [max(least, -(-side // 2**top)) for side in request.shape]
    regions = []
    for index in range(top + 1):
        sides = tuple(
            -(-side // 2**index) if wraps else coarse * 2 ** (top - index)
            for side, coarse, wraps in zip(request.shape, whole, request.periodic, strict=True)
        )
        regions.append(Region(sides, (True, True, True)))
    return regions


def around_known(
    request: Request, bounds: Bounds, top: int, clip_of: Callable[[int], float], *, exact: bool
) -> list[Region]:
    """The regions of levels 0 .. `top` around known voxels, whose field lies within `bounds`.

    A coarser voxel is known where any of its voxels is, with their mean: a single slice would vanish in a mean over all of
    them. `clip_of(index)` is the distance in voxels of the result at which a level saturates; `exact` says whether level 0
    holds the bounds themselves rather than such a mean.
    """
    assert request.known is not None  # checked by the request
    low, high = bounds
    depth = np.where(request.known, np.where(low > 0, high, low), np.float32(0))
    regions = []
    for index in range(top + 1):
        if index == 0 and exact:
            least, most = (quantise(bound, clip=clip_of(0)) for bound in bounds)
            free = ~request.known
        else:
            counts = _blocks(request.known[None].astype(np.float32), 2**index)
            free = counts[0] == 0
            mean = quantise(_blocks(depth, 2**index) / np.maximum(counts, 1), clip=clip_of(index))
            least, most = np.where(free, np.int8(-127), mean), np.where(free, np.int8(127), mean)
        regions.append(Region(free.shape, request.periodic, free, least, most))
    return regions


def _blocks(values: np.ndarray, side: int) -> np.ndarray:
    """Sums of (C, Z, Y, X) over blocks; what reaches beyond the end counts nothing."""
    padded = np.pad(values, [(0, 0)] + [(0, -count % side) for count in values.shape[1:]])
    z, y, x = (count // side for count in padded.shape[1:])
    return np.asarray(padded.reshape(len(values), z, side, y, side, x, side).sum(axis=(2, 4, 6)))
