"""Where something is made: the output's grid at one resolution, which axes wrap, what is free and what is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from trabecula.core.request import Request
from trabecula.synth.shared.neighbourhoods import covered_shape, grid_shape
from trabecula.synth.shared.pyramid import halve
from trabecula.synth.texture.content import free_of


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

    def grid(self, *, width: int, step: int) -> tuple[int, ...]:
        """Sites along each axis: they cover an open axis, and go once around one that wraps."""
        opened = grid_shape(self.shape, width=width, step=step)
        around = tuple(-(-side // step) for side in self.shape)
        return tuple(a if wrap else o for a, o, wrap in zip(around, opened, self.wraps, strict=True))

    def covered(self, *, width: int, step: int) -> Region:
        """The region with its open axes continued to what a grid of neighbourhoods covers; what is added is not free."""
        reach = covered_shape(self.grid(width=width, step=step), width=width, step=step)
        shape = tuple(side if wrap else far for side, far, wrap in zip(self.shape, reach, self.wraps, strict=True))
        pads = [(0, new - old) for new, old in zip(shape, self.shape, strict=True)]

        def grown(values: np.ndarray | None, fill: int) -> np.ndarray | None:
            if values is None:
                return None
            return np.pad(values, [(0, 0)] * (values.ndim - 3) + pads, constant_values=fill)

        return Region(shape, self.wraps, grown(self.free, 0), grown(self.low, -127), grown(self.high, 127))

    def active(self, grid: tuple[int, ...], *, width: int, step: int) -> np.ndarray:
        """The sites whose neighbourhood holds a voxel that is to be made, of a region that is covered."""
        if self.free is None:
            return np.ones(grid, bool)
        found = self.free
        for axis, (count, side, wrap) in enumerate(zip(grid, self.shape, self.wraps, strict=True)):
            sums = np.cumsum(found, axis=axis, dtype=np.int32)
            sums = np.concatenate([np.zeros_like(sums.take([0], axis)), sums], axis)
            first = np.arange(count) * step
            last = first + width
            inside = sums.take(np.minimum(last, side), axis) - sums.take(first, axis)
            if wrap:
                inside = inside + sums.take(np.clip(last - side, 0, side), axis)
            found = inside > 0
        return found

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
) -> list[Region]:
    """The request at `count` resolutions, finest first; `bounds` are halved like any field, and `quantised` per level."""
    region = Region(request.shape, request.periodic, free_of(request))
    regions = []
    for index in range(count):
        if bounds is None:
            regions.append(region)
        else:
            low, high = (quantised(bound, index) for bound in bounds)
            regions.append(replace(region, low=low, high=high))
            bounds = (halve(bounds[0]), halve(bounds[1]))
        region = region.halved()
    return regions
