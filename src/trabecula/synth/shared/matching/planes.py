"""Several views of one volume at one resolution: the planes across an axis, matched with the
picture seen there.

Neighbourhoods are squares in these planes. Every view searches for itself, in the volume turned so
that its axis comes first; what all of them say of a slab of the volume is added up there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs
from trabecula.engine.rows import add_block
from trabecula.synth.shared.content.fields import FULL
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.matching.grid import Grid, targets_of
from trabecula.synth.shared.matching.neighbourhoods import Triple
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import trims_of
from trabecula.synth.shared.matching.sources import Candidates
from trabecula.synth.shared.matching.votes import fold, reach
from trabecula.synth.shared.slabs import put_axis_first

_MOST_WEIGHT = 1023  # of a neighbourhood
_MOST_FACTOR = 256  # times an int8 is an int16
# planes that are summed up at once, at least: sites at their borders are gone through twice
_THICK = 8
_CACHED = 1 << 17  # voxels that are summed up at once where planes are small
_TOGETHER = 16  # planes across x that enter a slab at once: a line of the cache


class ViewLayout(NamedTuple):
    """Geometry of a view's neighbourhoods for kernels: (3,) along the axes of the view, but for the
    width and the axis. `shape` and `strides` are those of the candidates' cells, `sides` those of
    the volume.
    """

    shape: tuple[int, ...]
    sides: tuple[int, ...]
    strides: Triple
    steps: Triple
    width: int
    trims: Triple
    wraps: tuple[bool, ...]
    axis: int


@dataclass(frozen=True)
class ViewGrid:
    """One view: its axis, and the neighbourhoods of the volume with that axis first."""

    axis: int
    grid: Grid

    def put_axis_first(self, field: np.ndarray) -> np.ndarray:
        """Return a field (C, Z, Y, X) with the view's axis first of the three."""
        return put_axis_first(field, self.axis)

    @classmethod
    def over(
        cls, region: Region, axis: int, candidates: Candidates, targets: tuple[Histogram, ...]
    ) -> ViewGrid:
        """Lay the neighbourhoods of a view over a region that is covered."""
        box, steps = candidates.basis.box, candidates.steps
        seen = region.view_along(axis)
        shape = seen.grid(box=box, steps=steps)
        active = seen.active(shape, box=box, steps=steps)
        return cls(axis, Grid(candidates, replace(seen, free=None), shape, active, targets))


@dataclass(frozen=True)
class RegionViews:
    """All views of a region at one resolution."""

    region: Region  # covered in every view
    grids: tuple[ViewGrid, ...]
    targets: tuple[Histogram, ...]  # that the free voxels are to have, one a channel

    @property
    def full(self) -> int:
        """Return the integer factor of a voxel of an exemplar that counts fully: as fine as sums of
        all votes in int32 allow.
        """
        candidates = self.grids[0].grid.candidates
        overlaps = len(self.grids) * (-(-candidates.basis.width // candidates.step)) ** 2
        room = (2**31 - 1) // (_MOST_WEIGHT * FULL * overlaps)
        return min(_MOST_FACTOR, 1 << (room.bit_length() - 1))

    @classmethod
    def over(
        cls,
        region: Region,
        views: Sequence[tuple[int, Candidates]],
        histograms: tuple[Histogram, ...],
    ) -> RegionViews:
        """Lay the views (axis, neighbourhoods) over a region; `histograms` are those of the
        pictures together.
        """
        widths = {candidates.basis.width for _, candidates in views}
        steps = {candidates.step for _, candidates in views}
        # one for all views: a voxel of the cover belongs to all of them
        (width,), (step,) = widths, steps
        covered = region.cover(box=(width,) * 3, steps=(step,) * 3)
        targets = targets_of(covered, histograms, width=width)
        planes = tuple(
            ViewGrid.over(covered, axis, candidates, targets) for axis, candidates in views
        )
        return cls(covered, planes, targets)


def cast_plane_votes(
    views: RegionViews,
    matches: Sequence[np.ndarray],
    weights: Sequence[np.ndarray],
    *,
    factors: Sequence[np.ndarray] | None = None,
    trim: int = 0,
) -> np.ndarray:
    """Return the weighted mean (C, Z, Y, X) int16 of all matched neighbourhoods of all views, times
    256; 0 where none reaches.

    Parameters
    ----------
    matches, weights : sequences of (sz, sy, sx) int32
        One a view, on its grid.
    factors : sequence of (z, y, x) int, optional
        How much every voxel of a view's exemplar counts, 1 .. `views.full`. Default: all alike.
    trim : int
        Voxels at the rim of a neighbourhood that do not vote.
    """
    arguments: list[tuple[Any, ...]] = []
    for place, view in enumerate(views.grids):
        field = view.grid.candidates.stack.field
        factor = np.int16(1) if factors is None else factors[place].astype(np.int16)
        values = np.concatenate([field * factor, np.broadcast_to(factor, (1, *field.shape[1:]))])
        arguments.append((values, matches[place], weights[place], view_layout(view, trim)))
    shape = views.region.shape
    votes = memmap.empty((len(views.targets), *shape), np.int16)

    def work(start: int, stop: int) -> None:
        thick = planes_at_once(shape)
        for first in range(start, stop, thick):
            total = np.zeros((len(votes) + 1, min(thick, stop - first), *shape[1:]), np.int32)
            for each in arguments:
                add_votes(total, first, *each)
            divide(total, votes, first)

    for_slabs(work, shape[0], anywhere=True)
    return votes


def planes_at_once(shape: tuple[int, ...]) -> int:
    """Count the planes of a volume in which the votes of all views are summed at once."""
    return max(_THICK, _CACHED // (shape[1] * shape[2]))


def view_layout(view: ViewGrid, trim: int) -> ViewLayout:
    """Return the geometry of a view's neighbourhoods."""
    grid, candidates = view.grid, view.grid.candidates
    return ViewLayout(
        candidates.shape,
        grid.region.shape,
        candidates.strides,
        candidates.steps,
        candidates.basis.width,
        trims_of(grid, trim),
        grid.region.wraps,
        view.axis,
    )


@kernel
def add_votes(total, start, values, match, weight, layout):
    """Add the weighted sums of a view's matched neighbourhoods to a slab of the volume that begins
    at plane `start`.

    total (C, ...) int32, of the volume; values (C, z, y, x) int16, what the exemplar's voxels add;
    match, weight (Z, Y, X) int32, where a site of weight 0 does not vote. The rim of `trims` voxels
    does not vote, except at a border that does not wrap.
    """
    C, depth, height, across = total.shape
    axis = layout.axis
    rows = height if axis == 0 else depth
    together = _TOGETHER if axis == 2 else 1
    covered = (match.shape[2] - 1) * layout.steps[2] + layout.width
    planes = np.empty((together, C, rows, covered), np.int32)
    if axis == 0:
        for z in range(depth):
            m, w = match[start + z], weight[start + z]
            _vote_rows(values, m, w, layout, 0, planes[0])
            for c in range(C):
                add_block(total[c, z], planes[0, c])
    elif axis == 1:
        for y in range(height):
            m, w = match[y], weight[y]
            _vote_rows(values, m, w, layout, start, planes[0])
            for c in range(C):
                add_block(total[c, :, y], planes[0, c])
    else:
        for first in range(0, across, together):
            count = min(together, across - first)
            for n in range(count):
                m, w = match[first + n], weight[first + n]
                _vote_rows(values, m, w, layout, start, planes[n])
            for c in range(C):
                for z in range(depth):
                    for y in range(height):
                        for n in range(count):
                            total[c, z, y, first + n] += planes[n, c, z, y]


@inline
def _vote_rows(values, match, weight, layout, start, plane):
    """Sum the weighted votes of the sites of one plane, in as many of its rows from `start` on as
    `plane` (C, rows, ...) has.
    """
    shape, sides, strides, steps, width, trims, wraps, _ = layout
    C, SY, SX, step = len(values), match.shape[0], match.shape[1], steps[2]
    weights = np.empty(width, np.int32)
    plane[:] = 0
    for turn in range(2 if wraps[1] else 1):
        low = start + turn * sides[1]
        high = low + plane.shape[1]
        for sy in range(
            max(0, (low - width + steps[1]) // steps[1]), min(SY, (high - 1) // steps[1] + 1)
        ):
            y0, y1 = reach(sy, SY, width, trims[1], wraps[1])
            y0, y1 = max(y0, low - sy * steps[1]), min(y1, high - sy * steps[1])
            if y0 >= y1:
                continue
            for sx in range(SX):
                w = weight[sy, sx]
                if w == 0:
                    continue
                # Whole rows, with weight 0 at the rim: the compiler makes eight voxels one
                # addition.
                x0, x1 = reach(sx, SX, width, trims[2], wraps[2])
                weights[:] = w
                weights[:x0] = 0
                weights[x1:] = 0
                m = match[sy, sx]
                ez = m // (shape[2] * shape[1]) * strides[0]
                ey = (m // shape[2]) % shape[1] * strides[1]
                ex = m % shape[2] * strides[2]
                for c in range(C):
                    for dy in range(y0, y1):
                        to = plane[c, sy * steps[1] + dy - low, sx * step : sx * step + width]
                        row = values[c, ez, ey + dy, ex : ex + width]
                        for x in range(width):
                            to[x] += weights[x] * np.int32(row[x])
    fold(plane, plane.shape[1], sides[2], (False, False, wraps[2]))


@kernel
def divide(total, votes, start):
    """Divide 256 times the sums (C + 1, ...) by the last of them, the weights: votes (C, Z, Y, X)
    int16 from plane `start` on.
    """
    C, depth, height, across = total.shape
    for c in range(C - 1):
        for z in range(depth):
            for y in range(height):
                for x in range(across):
                    below = max(total[C - 1, z, y, x], np.int32(1))
                    votes[c, start + z, y, x] = np.int64(total[c, z, y, x]) * 256 // below
