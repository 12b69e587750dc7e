"""The regions of a request: a torus where nothing is known, so that no place is special; else the
request's own grid.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from trabecula.core.request import Request
from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs
from trabecula.synth.shared.content.bounds import Bounds
from trabecula.synth.shared.content.fields import quantise
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.slabs import complement


def torus_regions(request: Request, top: int, least: int) -> list[Region]:
    """Return the regions of levels 0 .. `top`; an open axis is continued to whole voxels of the
    coarsest, `least` of them at least.
    """
    whole = [max(least, -(-side // 2**top)) for side in request.shape]
    regions = []
    for index in range(top + 1):
        sides = tuple(
            -(-side // 2**index) if wraps else coarse * 2 ** (top - index)
            for side, coarse, wraps in zip(request.shape, whole, request.periodic, strict=True)
        )
        regions.append(Region(sides, (True, True, True)))
    return regions


def regions_around_known(
    request: Request, bounds: Bounds, top: int, clip_of: Callable[[int], float], *, exact: bool
) -> list[Region]:
    """Return the regions of levels 0 .. `top` around known voxels, whose field is within `bounds`.

    A coarser voxel is known where any of its voxels is, with their mean: a single slice would
    vanish in a mean over all of them. `clip_of(index)` is the distance in voxels of the result at
    which a level saturates; `exact` says whether level 0 holds the bounds themselves rather than
    such a mean.
    """
    assert request.known is not None  # checked by the request
    regions = []
    for index in range(top + 1):
        if index == 0 and exact:
            least, most = (quantise(bound, clip=clip_of(0)) for bound in bounds)
            regions.append(
                Region(request.shape, request.periodic, complement(request.known), least, most)
            )
        else:
            regions.append(
                _coarse(request.known, bounds, 2**index, clip_of(index), request.periodic)
            )
    return regions


def _coarse(
    known: np.ndarray, bounds: Bounds, side: int, clip: float, wraps: tuple[bool, ...]
) -> Region:
    """Return the region of voxels `side` times as long."""
    low, high = bounds
    shape = tuple(-(-count // side) for count in known.shape)
    free = memmap.empty(shape, bool)
    least, most = (memmap.empty((len(low), *shape), np.int8) for _ in range(2))

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            planes = slice(z * side, (z + 1) * side)
            here, below = known[planes], low[:, planes]
            above = high[:, planes]
            depth = np.where(here, np.where(below > 0, above, below), np.float32(0))
            counts = _blocks(here[None].astype(np.float32), side)
            sums = _blocks(depth, side)[:, 0] / np.maximum(counts[:, 0], 1)
            mean = np.stack([quantise(channel, clip=clip) for channel in sums])
            free[z] = counts[0, 0] == 0
            least[:, z] = np.where(free[z], np.int8(-127), mean)
            most[:, z] = np.where(free[z], np.int8(127), mean)

    for_slabs(work, shape[0])
    return Region(shape, wraps, free, least, most)


def _blocks(values: np.ndarray, side: int) -> np.ndarray:
    """Sum (C, Z, Y, X) over blocks; beyond the end nothing counts."""
    padded = np.pad(values, [(0, 0)] + [(0, -count % side) for count in values.shape[1:]])
    z, y, x = (count // side for count in padded.shape[1:])
    return np.asarray(padded.reshape(len(values), z, side, y, side, x, side).sum(axis=(2, 4, 6)))
