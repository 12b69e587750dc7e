"""Where something is made: the output's grid at one resolution, which axes wrap, what is free and what is known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trabecula.core.request import Request
from trabecula.synth.shared.content import free_of
from trabecula.synth.shared.neighbourhoods import Triple, covered_shape, grid_shape
from trabecula.synth.shared.pyramid import halve


@dataclass(frozen=True)
class Region:
    """The output at one resolution.

    `shape` is its extent in voxels; `wraps` says which axes are periodic. `free` (Z, Y, X) bool marks the voxels that are to
    be made (None: all); `low` and `high` (C, Z, Y, X) int8 are the least and most that a voxel may become (None: no limit),
    equal where its value is known.
    """

    shape: tuple[int, ...]
    wraps: tuple[bool, ...] = (False, False, False)
    free: np.ndarray | None = None
    low: np.ndarray | None = None
    high: np.ndarray | None = None

    def grid(self, *, box: Triple, steps: Triple) -> Triple:
        """Sites along each axis: they cover an open axis, and go once around one that wraps."""
        opened = grid_shape(self.shape, box=box, steps=steps)
        around = (-(-side // step) for side, step in zip(self.shape, steps, strict=True))
        z, y, x = (a if wrap else o for a, o, wrap in zip(around, opened, self.wraps, strict=True))
        return z, y, x

    def covered(self, *, box: Triple, steps: Triple) -> Region:
        """The region with its open axes continued to what a grid of neighbourhoods covers; what is added is not free."""
        reach = covered_shape(self.grid(box=box, steps=steps), box=box, steps=steps)
        shape = tuple(side if wrap else far for side, far, wrap in zip(self.shape, reach, self.wraps, strict=True))
        pads = [(0, new - old) for new, old in zip(shape, self.shape, strict=True)]

        def grown(values: np.ndarray | None, fill: int) -> np.ndarray | None:
            if values is None:
                return None
            return np.pad(values, [(0, 0)] * (values.ndim - 3) + pads, constant_values=fill)

        return Region(shape, self.wraps, grown(self.free, 0), grown(self.low, -127), grown(self.high, 127))

    def active(self, grid: Sequence[int], *, box: Triple, steps: Triple) -> np.ndarray:
        """The sites whose neighbourhood holds a voxel that is to be made, of a region that is covered."""
        if self.free is None:
            return np.ones(grid, bool)
        found = self.free
        for axis, (count, side, wrap) in enumerate(zip(grid, self.shape, self.wraps, strict=True)):
            sums = np.cumsum(found, axis=axis, dtype=np.int32)
            sums = np.concatenate([np.zeros_like(sums.take([0], axis)), sums], axis)
            first = np.arange(count) * steps[axis]
            last = first + box[axis]
            inside = sums.take(np.minimum(last, side), axis) - sums.take(first, axis)
            if wrap:
                inside = inside + sums.take(np.clip(last - side, 0, side), axis)
            found = inside > 0
        return found

    def seen(self, axis: int) -> Region:
        """The region with `axis` first: what its planes across that axis are, one after the other."""
        order = (axis, *(a for a in range(3) if a != axis))

        def turned(values: np.ndarray | None) -> np.ndarray | None:
            return None if values is None else np.ascontiguousarray(np.moveaxis(values, axis - 3, -3))

        return Region(
            tuple(self.shape[a] for a in order),
            tuple(self.wraps[a] for a in order),
            turned(self.free),
            turned(self.low),
            turned(self.high),
        )

    def halved(self) -> Region:
        """At half the resolution: free where any of eight voxels is; bounds are not carried over."""
        shape = tuple(-(-side // 2) for side in self.shape)
        if self.free is None:
            return Region(shape, self.wraps)
        padded = np.pad(self.free, [(0, side % 2) for side in self.shape])
        z, y, x = shape
        return Region(shape, self.wraps, np.asarray(padded.reshape(z, 2, y, 2, x, 2).any(axis=(1, 3, 5))))

    def bounded(self, field: np.ndarray) -> np.ndarray:
        """A field (C, Z, Y, X) with what is known put back."""
        if self.low is None or self.high is None:
            return field
        return np.clip(field, self.low, self.high)


def regions_of(
    request: Request,
    count: int,
    bounds: tuple[np.ndarray, np.ndarray] | None,
    quantised: Callable[[np.ndarray, int], np.ndarray],
    *,
    thin: bool = False,
) -> list[Region]:
    """The request at `count` resolutions, finest first; `bounds` are halved like any field, and `quantised` per level.

    With `thin` a coarse voxel of which any part is known is known: a single slice is felt on every level. Otherwise it is as
    free as its freest part, which suits known blocks.
    """
    region = Region(request.shape, request.periodic, free_of(request))
    known = request.known if thin else None
    regions = []
    for index in range(count):
        if bounds is None:
            regions.append(region)
        else:
            low, high = (quantised(bound, index) for bound in bounds)
            regions.append(replace(region, low=low, high=high))
        region = region.halved()
        if bounds is not None and known is None:
            bounds = (halve(bounds[0]), halve(bounds[1]))
        elif bounds is not None and known is not None:
            share = halve(known[None].astype(np.float32))
            bounds = (_halved_known(bounds[0], known, share), _halved_known(bounds[1], known, share))
            known = share[0] > 0
            region = replace(region, free=None if region.free is None else region.free & ~known)
    return regions


def _halved_known(bound: np.ndarray, known: np.ndarray, share: np.ndarray) -> np.ndarray:
    """A bound (C, Z, Y, X) at half the resolution: the mean over the voxels that are known, else what it is anywhere."""
    sums = halve(np.where(known, bound, np.float32(0)))
    free = bound[(slice(None), ~known)]
    anywhere = free[:, 0, None, None, None] if free.size else np.float32(0)
    return np.where(share > 0, sums / np.maximum(share, np.float32(1e-6)), anywhere).astype(np.float32)
