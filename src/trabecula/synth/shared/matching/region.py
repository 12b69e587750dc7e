"""Regions: the output's grid at one resolution, its axes that wrap, its free voxels, and its known
ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trabecula.core.request import Request
from trabecula.engine import memmap
from trabecula.synth.shared.content.kinds import free_voxels
from trabecula.synth.shared.matching.neighbourhoods import Triple, grid_reach, grid_shape
from trabecula.synth.shared.pyramid import halve
from trabecula.synth.shared.slabs import (
    axis_order,
    complement,
    for_plane_groups,
    intersection,
    make_by_slabs,
    put_axis_first,
)


@dataclass(frozen=True)
class Region:
    """The output at one resolution.

    `shape` is its extent in voxels; `wraps` says which axes are periodic. `free` (Z, Y, X) bool
    marks the voxels that are to be made (None: all); `low` and `high` (C, Z, Y, X) int8 are the
    least and most that a voxel may become (None: no limit), equal where its value is known.
    """

    shape: tuple[int, ...]
    wraps: tuple[bool, ...] = (False, False, False)
    free: np.ndarray | None = None
    low: np.ndarray | None = None
    high: np.ndarray | None = None

    def grid(self, *, box: Triple, steps: Triple) -> Triple:
        """Count the sites along each axis: they cover an open axis, and go once around one that
        wraps.
        """
        opened = grid_shape(self.shape, box=box, steps=steps)
        around = (-(-side // step) for side, step in zip(self.shape, steps, strict=True))
        z, y, x = (a if wrap else o for a, o, wrap in zip(around, opened, self.wraps, strict=True))
        return z, y, x

    def cover(self, *, box: Triple, steps: Triple) -> Region:
        """Continue the open axes to the voxels that a grid of neighbourhoods covers; added voxels
        are not free.
        """
        reach = grid_reach(self.grid(box=box, steps=steps), box=box, steps=steps)
        shape = tuple(
            side if wrap else far
            for side, far, wrap in zip(self.shape, reach, self.wraps, strict=True)
        )

        def extend(values: np.ndarray | None, fill: int) -> np.ndarray | None:
            return None if values is None else _extend(values, shape, fill)

        return Region(
            shape, self.wraps, extend(self.free, 0), extend(self.low, -127), extend(self.high, 127)
        )

    def first_planes(self, count: int) -> Region:
        """Return the first planes of a region, which do not wrap unless they are all."""
        if count == self.shape[0]:
            return self
        low, high = self.low, self.high
        return Region(
            (count, *self.shape[1:]),
            (False, *self.wraps[1:]),
            None if self.free is None else self.free[:count],
            None if low is None else low[:, :count],
            None if high is None else high[:, :count],
        )

    def continue_on_torus(self, shape: tuple[int, ...]) -> Region:
        """Continue the region to a torus of `shape`; added voxels are free."""

        def extend(values: np.ndarray | None, fill: int) -> np.ndarray | None:
            return None if values is None else _extend(values, shape, fill)

        return Region(
            shape,
            (True, True, True),
            extend(self.free, 1),
            extend(self.low, -127),
            extend(self.high, 127),
        )

    def active(self, grid: Sequence[int], *, box: Triple, steps: Triple) -> np.ndarray:
        """Mark the sites whose neighbourhood holds a free voxel, of a region that is covered."""
        free = self.free

        def planes(start: int, stop: int) -> np.ndarray | bool:
            return (
                True
                if free is None
                else np.stack(
                    [self._active_plane(free, z, grid, box, steps) for z in range(start, stop)]
                )
            )

        return make_by_slabs(planes, grid, bool)

    def _active_plane(
        self, free: np.ndarray, z: int, grid: Sequence[int], box: Triple, steps: Triple
    ) -> np.ndarray:
        """Mark the active sites of one plane."""
        planes = np.arange(z * steps[0], z * steps[0] + box[0])
        around = free[planes % len(free)] if self.wraps[0] else free[planes[0] : planes[-1] + 1]
        found = np.asarray(around.any(axis=0))
        for axis in (0, 1):
            found = _in_windows(
                found,
                grid[1 + axis],
                box[1 + axis],
                steps[1 + axis],
                axis,
                wrap=self.wraps[1 + axis],
            )
        return found

    def view_along(self, axis: int) -> Region:
        """Return the region with `axis` first, without the bounds."""
        order = axis_order(axis)
        shape, wraps = tuple(self.shape[a] for a in order), tuple(self.wraps[a] for a in order)
        free = None if self.free is None else put_axis_first(self.free, axis)
        return Region(shape, wraps, free)

    def halve(self) -> Region:
        """Halve the resolution: a voxel is free where any of its eight is; bounds are not carried
        over.
        """
        shape = tuple(-(-side // 2) for side in self.shape)
        free = self.free
        if free is None:
            return Region(shape, self.wraps)

        def any_of_eight(start: int, stop: int) -> np.ndarray:
            part = free[2 * start : 2 * stop]
            part = np.pad(part, [(0, side % 2) for side in part.shape])
            z, y, x = (side // 2 for side in part.shape)
            return np.asarray(part.reshape(z, 2, y, 2, x, 2).any(axis=(1, 3, 5)))

        return Region(shape, self.wraps, make_by_slabs(any_of_eight, shape, bool))

    def unsettled(self) -> np.ndarray | None:
        """Mark the voxels whose field the bounds leave open; None without bounds."""
        low, high = self.low, self.high
        if low is None or high is None:
            return None
        return make_by_slabs(
            lambda a, b: (low[:, a:b] < high[:, a:b]).any(axis=0), self.shape, bool
        )

    def clip_to_bounds(self, field: np.ndarray) -> np.ndarray:
        """Clip a field (C, Z, Y, X), which nobody else holds, to the bounds of known voxels, in
        place.
        """
        low, high = self.low, self.high
        if low is None or high is None:
            return field

        def work(start: int, stop: int) -> None:
            planes = (slice(None), slice(start, stop))
            np.clip(field[planes], low[planes], high[planes], out=field[planes])

        for_plane_groups(work, self.shape)
        return field


def regions_of(
    request: Request,
    count: int,
    bounds: tuple[np.ndarray, np.ndarray] | None,
    quantised: Callable[[np.ndarray, int], np.ndarray],
    *,
    thin: bool = False,
) -> list[Region]:
    """Return the request at `count` resolutions, finest first; `bounds` are halved like any field,
    and `quantised` per level.

    With `thin` a coarse voxel of which any part is known is known: a single slice is felt on every
    level. Otherwise it is as free as its freest part, which suits known blocks.
    """
    region = Region(request.shape, request.periodic, free_voxels(request))
    known = request.known if thin else None
    regions = []
    for index in range(count):
        if bounds is None:
            regions.append(region)
        else:
            low, high = (quantised(bound, index) for bound in bounds)
            regions.append(replace(region, low=low, high=high))
        if index == count - 1:
            break
        region = region.halve()
        if bounds is not None and known is None:
            bounds = (halve(bounds[0]), halve(bounds[1]))
        elif bounds is not None and known is not None:
            share = _share(known)
            bounds = (
                _halve_known(bounds[0], known, share),
                _halve_known(bounds[1], known, share),
            )
            known = make_by_slabs(
                lambda a, b, share=share: share[0, a:b] > 0,  # type: ignore[misc]
                share.shape[1:],
                bool,
            )
            region = replace(region, free=intersection(region.free, complement(known)))
    return regions


def has_cube(mask: np.ndarray, width: int) -> bool:
    """Return whether a cube of `width` voxels fits into a mask (one that is
    thinner along an axis may fill that axis).
    """
    reach = [min(width, side) for side in mask.shape]
    deep = np.zeros(mask.shape[1:], np.int32)  # planes up to this one in which a line is inside
    for plane in mask:
        deep = np.where(plane, deep + 1, 0)
        room = deep >= reach[0]
        for axis in (0, 1):
            sums = np.cumsum(room, axis=axis, dtype=np.int32)
            sums = np.concatenate([np.zeros_like(sums.take([0], axis)), sums], axis)
            cells = np.arange(room.shape[axis] - reach[1 + axis] + 1)
            room = (
                sums.take(cells + reach[1 + axis], axis) - sums.take(cells, axis) == reach[1 + axis]
            )
        if room.any():
            return True
    return False


def _share(known: np.ndarray) -> np.ndarray:
    """Return the known share of every coarser voxel, (1, Z, Y, X) float32."""
    return halve(make_by_slabs(lambda a, b: known[a:b], (1, *known.shape), np.float32))


def _halve_known(bound: np.ndarray, known: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Halve the resolution of a bound (C, Z, Y, X): the mean over the known voxels, elsewhere that
    of unknown ones.
    """
    sums = halve(
        make_by_slabs(
            lambda a, b: np.where(known[a:b], bound[:, a:b], np.float32(0)), bound.shape, np.float32
        )
    )
    anywhere = _first_free(bound, known)

    def mean(start: int, stop: int) -> np.ndarray:
        part = share[:, start:stop]
        return np.where(
            part > 0, sums[:, start:stop] / np.maximum(part, np.float32(1e-6)), anywhere
        )

    return make_by_slabs(mean, sums.shape, np.float32)


def _first_free(bound: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return the bound of voxels that are not known, (C, 1, 1, 1): it is the same at
    all of them.
    """
    for z, plane in enumerate(known):
        if not plane.all():
            y, x = np.unravel_index(int(np.argmin(plane)), plane.shape)
            return bound[:, z, y, x].astype(np.float32)[:, None, None, None]
    return np.zeros((len(bound), 1, 1, 1), np.float32)


def _extend(values: np.ndarray, shape: tuple[int, ...], fill: int) -> np.ndarray:
    """Continue (..., Z, Y, X) by a value to `shape`; return it itself where there is nothing to
    add.
    """
    have = values.shape[-3:]
    if have == shape:
        return values
    grown = memmap.empty((*values.shape[:-3], *shape), values.dtype)

    def work(start: int, stop: int) -> None:
        part = grown[..., start:stop, :, :]
        part[...] = fill
        inside = values[..., start : min(stop, have[0]), :, :]
        part[..., : inside.shape[-3], : have[1], : have[2]] = inside

    for_plane_groups(work, shape)
    return grown


def _in_windows(
    values: np.ndarray, count: int, width: int, step: int, axis: int, *, wrap: bool
) -> np.ndarray:
    """Mark the windows, `count` along an axis, in which any voxel of a plane (Y, X)
    bool is True.
    """
    side = values.shape[axis]
    sums = np.cumsum(values, axis=axis, dtype=np.int32)
    sums = np.concatenate([np.zeros_like(sums.take([0], axis)), sums], axis)
    first = np.arange(count) * step
    last = first + width
    inside = sums.take(np.minimum(last, side), axis) - sums.take(first, axis)
    if wrap:
        inside = inside + sums.take(np.clip(last - side, 0, side), axis)
    return np.asarray(inside > 0)
