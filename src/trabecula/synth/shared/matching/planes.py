"""Several views of one volume at one resolution: the planes across an axis, matched with the
picture seen there.

Neighbourhoods are squares in these planes. Every view searches for itself, in the volume turned so
that its axis comes first; what all of them say of a slab of the volume is added up there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs
from trabecula.synth.shared.fields import FULL
from trabecula.synth.shared.histogram import Histogram
from trabecula.synth.shared.matching.grid import Grid, targets_of
from trabecula.synth.shared.matching.plane_kernels import add_votes, compare_pixels, divide, paint
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import trims_of
from trabecula.synth.shared.matching.sources import Candidates
from trabecula.synth.shared.turned import axis_order, put_axis_first

_MOST_WEIGHT = 1023  # of a neighbourhood
_MOST_FACTOR = 256  # times an int8 is an int16
# planes that are summed up at once, at least: sites at their borders are gone through twice
_THICK = 8
_CACHED = 1 << 17  # voxels that are summed up at once where planes are small


@dataclass(frozen=True)
class ViewGrid:
    """One view: the axis it is seen across, and the neighbourhoods of the volume with that axis
    first.
    """

    axis: int
    grid: Grid

    def turned(self, field: np.ndarray) -> np.ndarray:
        """A field (C, Z, Y, X) with the view's axis first of the three."""
        return put_axis_first(field, self.axis)

    @classmethod
    def over(
        cls, region: Region, axis: int, candidates: Candidates, targets: tuple[Histogram, ...]
    ) -> ViewGrid:
        """The view of a region that is covered."""
        box, steps = candidates.basis.box, candidates.steps
        order = axis_order(axis)
        seen = Region(tuple(region.shape[a] for a in order), tuple(region.wraps[a] for a in order))
        shape = seen.grid(box=box, steps=steps)
        free = None if region.free is None else put_axis_first(region.free, axis)
        active = replace(seen, free=free).active(shape, box=box, steps=steps)
        return cls(axis, Grid(candidates, seen, shape, active, targets))


@dataclass(frozen=True)
class RegionViews:
    """All views of a region at one resolution."""

    region: Region  # covered in every view
    planes: tuple[ViewGrid, ...]
    targets: tuple[Histogram, ...]  # that the free voxels are to have, one a channel

    @property
    def full(self) -> int:
        """The integer factor of a voxel of an exemplar that counts fully: as fine as sums of all
        votes in int32 allow.
        """
        candidates = self.planes[0].grid.candidates
        overlaps = len(self.planes) * (-(-candidates.basis.width // candidates.step)) ** 2
        room = (2**31 - 1) // (_MOST_WEIGHT * FULL * overlaps)
        return min(_MOST_FACTOR, 1 << (room.bit_length() - 1))

    @classmethod
    def over(
        cls,
        region: Region,
        views: Sequence[tuple[int, Candidates]],
        histograms: tuple[Histogram, ...],
    ) -> RegionViews:
        """The views (axis, neighbourhoods) of a region; `histograms` are those of the pictures
        together.
        """
        widths = {candidates.basis.width for _, candidates in views}
        steps = {candidates.step for _, candidates in views}
        # one for all views: a voxel of the cover belongs to all of them
        (width,), (step,) = widths, steps
        covered = region.covered(box=(width,) * 3, steps=(step,) * 3)
        targets = targets_of(covered, histograms, width=width)
        planes = tuple(ViewGrid.over(covered, axis, candidates, targets) for axis, candidates in views)
        return cls(covered, planes, targets)


def cast_plane_votes(
    frame: RegionViews,
    matches: Sequence[np.ndarray],
    weights: Sequence[np.ndarray],
    *,
    factors: Sequence[np.ndarray] | None = None,
    trim: int = 0,
) -> np.ndarray:
    """The weighted mean (C, Z, Y, X) int16 of all matched neighbourhoods of all views, times 256; 0
    where none reaches.

    Parameters
    ----------
    matches, weights : sequences of (sz, sy, sx) int32
        One a view, on its grid.
    factors : sequence of (z, y, x) int, optional
        How much every voxel of a view's exemplar counts, 1 .. `frame.full`. Default: all alike.
    trim : int
        Voxels at the rim of a neighbourhood that do not vote.
    """
    views: list[tuple[Any, ...]] = []
    for place, plane in enumerate(frame.planes):
        field = plane.grid.candidates.stack.field
        factor = np.int16(1) if factors is None else factors[place].astype(np.int16)
        values = np.concatenate([field * factor, np.broadcast_to(factor, (1, *field.shape[1:]))])
        views.append((values, matches[place], weights[place], *_laid(plane, trim)))
    shape = frame.region.shape
    votes = memmap.empty((len(frame.targets), *shape), np.int16)

    def work(start: int, stop: int) -> None:
        thick = planes_at_once(shape)
        for first in range(start, stop, thick):
            total = np.zeros((len(votes) + 1, min(thick, stop - first), *shape[1:]), np.int32)
            for view in views:
                add_votes(total, first, *view)
            divide(total, votes, first)

    for_slabs(work, shape[0], anywhere=True)
    return votes


def choose_pixels(
    frame: RegionViews,
    matches: Sequence[np.ndarray],
    weights: Sequence[np.ndarray],
    mean: np.ndarray,
    *,
    dear: Sequence[np.ndarray],
    trim: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Of all pixels that the matched neighbourhoods of all views lay on a voxel, the one nearest to
    the mean.

    Parameters
    ----------
    matches, weights, trim
        As in `cast_plane_votes`.
    mean : (C, Z, Y, X) int16 or int8
        256 times the field to come near to, or in int8 that field.
    dear : sequence of (z, y, x) int32
        What the squared distance of every voxel of a view's exemplar is multiplied by, 1 or more.

    Returns
    -------
    field : (C, Z, Y, X) int8
        The pixels' values; the mean where no neighbourhood reaches.
    sources : (Z, Y, X) int32
        Their numbers: view after view, in the order of each view's stack; -1 where there is none.
    """
    exemplars = [plane.grid.candidates.stack.field for plane in frame.planes]
    pixels = np.concatenate([exemplar.reshape(len(mean), -1) for exemplar in exemplars], axis=1)
    begins = np.cumsum([0] + [exemplar[0].size for exemplar in exemplars])[:-1]
    laid = [_laid(plane, trim) for plane in frame.planes]
    views: list[tuple[int, tuple[Any, ...]]] = [
        (plane.axis, (int(begin), *own, *how))
        for plane, *own, how, begin in zip(
            frame.planes, exemplars, dear, matches, weights, laid, begins, strict=True
        )
    ]
    shape = frame.region.shape
    field, sources = memmap.empty(mean.shape, np.int8), memmap.empty(shape, np.int32)

    def work(start: int, stop: int) -> None:
        thick = planes_at_once(shape)
        for first in range(start, stop, thick):
            here = slice(first, min(first + thick, stop))
            aim = mean[:, here]
            aim = aim * np.int16(256) if aim.dtype == np.int8 else aim
            cost, found = (
                np.full(aim.shape[1:], 2**62, np.int64),
                np.full(aim.shape[1:], -1, np.int32),
            )
            for axis, view in views:
                seen, least, taken = (
                    np.ascontiguousarray(np.moveaxis(part, axis - 3, -3))
                    for part in (aim, cost, found)
                )
                compare_pixels(seen, least, taken, first, *view)
                cost, found = (np.moveaxis(part, 0, axis) for part in (least, taken))
            field[:, here], sources[here] = round_votes(aim), found
            paint(pixels, sources[here], field, first)

    for_slabs(work, shape[0], anywhere=True)
    return field, sources


def round_votes(votes: np.ndarray) -> np.ndarray:
    """Votes int16 as the field int8 that they are 256 times of, rounded."""
    return np.clip((votes.astype(np.int32) + 128) >> 8, -FULL, FULL).astype(np.int8)


def planes_at_once(shape: tuple[int, ...]) -> int:
    """Planes of a volume in which what all views say is summed up at once."""
    return max(_THICK, _CACHED // (shape[1] * shape[2]))


def _laid(plane: ViewGrid, trim: int) -> tuple[Any, ...]:
    """How the neighbourhoods of a view lie, as kernels want it: (3,) along its axes, but for the
    width and its axis.
    """
    grid, candidates = plane.grid, plane.grid.candidates
    width, trims = candidates.basis.width, trims_of(grid, trim)
    sides, wraps = grid.region.shape, grid.region.wraps
    return (
        candidates.shape,
        sides,
        candidates.strides,
        candidates.steps,
        width,
        trims,
        wraps,
        plane.axis,
    )
