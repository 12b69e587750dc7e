"""`chen`: the loop of `shared.solid` with voxels that are pixels, and with two histograms pushed
towards even use.

The index histogram (how often a neighbourhood was chosen) makes distances longer in the search; the
position histogram (of how many voxels a pixel is the source) makes a pixel count less in the vote,
and cost more as a source.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.engine import memmap
from trabecula.engine.compile import inline, kernel
from trabecula.engine.memory import Workspace
from trabecula.engine.parallel import for_slabs, sum_slabs
from trabecula.exemplar.views import View
from trabecula.synth.chen import CAPABILITIES
from trabecula.synth.chen.config import ChenConfig
from trabecula.synth.shared.content.fields import votes_of
from trabecula.synth.shared.content.kinds import complete
from trabecula.synth.shared.matching.planes import (
    RegionViews,
    planes_at_once,
    view_layout,
)
from trabecula.synth.shared.matching.rounds import round_votes
from trabecula.synth.shared.matching.votes import reach
from trabecula.synth.shared.orient import apply_symmetry, symmetries
from trabecula.synth.shared.solid.method import Solid
from trabecula.synth.shared.solid.model import SolidModel
from trabecula.synth.shared.solid.run import SolidRounds, SolidStage

_LARGEST_COST = 64  # times that of a pixel used evenly


class Chen(Solid):
    """Solid texture synthesis with position and index histograms."""

    capabilities = CAPABILITIES
    config_type = ChenConfig

    def _learn(self, exemplars: Sequence[Image], views: tuple[View, ...]) -> ChenModel:
        return ChenModel(self.config, exemplars, views)


class ChenRounds(SolidRounds):
    """A run in which voxels become pixels of the pictures, all of them used evenly."""

    config: ChenConfig

    def vote(self, stage: SolidStage, number: int | None) -> None:
        """Cast the votes, and give every voxel the matched pixel that is nearest to their mean."""
        views, work, config = stage.views, self.work, self.config
        trim = 0 if number is None else stage.trims[number]
        before = [work[name] for name in ("sources",) if name in work]
        excess = position_excess(before.pop() if before else None, views, config.position_penalty)
        factors = [np.maximum(np.rint(views.full / over), 1).astype(np.int16) for over in excess]
        self.cast(stage, factors, trim)
        self.match_field(views.region, views.targets if config.histogram else None)
        if config.discrete:
            costs = [
                np.minimum(np.rint(over * 4), 4 * _LARGEST_COST).astype(np.int32) for over in excess
            ]
            work.enter("choose")
            mean = work["field" if config.histogram else "votes"]
            matches, weights = self.each("match", stage), self.each("weight", stage)
            field, sources = choose_pixels(views, matches, weights, mean, costs=costs, trim=trim)
            del mean
            for name in ("field", "votes"):
                work.release(name)
            work.adopt("field", views.region.clip_to_bounds(field))
            work.adopt("sources", sources)
            work.adopt("votes", votes_of(field))


class ChenModel(SolidModel):
    """Pictures as pyramids of fields."""

    capabilities = CAPABILITIES
    rounds_type = ChenRounds
    config: ChenConfig

    @property
    def _chooses(self) -> bool:
        """Return whether voxels become pixels of the pictures."""
        return self.config.discrete

    def _to_values(
        self, work: Workspace, request: Request
    ) -> np.ndarray | tuple[np.ndarray, Mapping[str, Any]]:
        """Return the pixels' own grey values and colours: matching channel by channel would make
        new colours.
        """
        if self.content.distances or "sources" not in work:
            return super()._to_values(work, request)
        sources = work["sources"]
        pixels = np.concatenate([self._pixels(place) for place in range(len(self.views))])
        depth, height, across = request.shape
        values = memmap.empty((*request.shape, *pixels.shape[1:]), pixels.dtype)

        def look_up(start: int, stop: int) -> None:
            for z in range(start, stop):
                values[z] = pixels[sources[z, :height, :across]]

        for_slabs(look_up, depth)
        return complete(values, request, empty=0)

    def _pixels(self, place: int) -> np.ndarray:
        """Return the values of a view's pixels in the order of its sources on the finest level:
        (n,) or (n, 3).
        """
        image, candidates = self.views[place].image, self.levels[0].views[place][1]
        numbers = np.arange(
            image.values[..., 0].size if image.kind == "colour" else image.values.size
        )
        order = np.zeros(candidates.stack.field.shape[1:], np.int64)
        turns = symmetries(self.config.orientations, ndim=2, spacing=image.spacing)
        for start, turn in zip(candidates.stack.starts, turns, strict=True):
            turned = apply_symmetry(numbers.reshape(1, *image.shape), turn)[0]
            order[start, : turned.shape[0], : turned.shape[1]] = turned
        return image.values.reshape(len(numbers), -1)[order.ravel()].reshape(
            -1, *image.values.shape[2:]
        )


def choose_pixels(
    views: RegionViews,
    matches: Sequence[np.ndarray],
    weights: Sequence[np.ndarray],
    mean: np.ndarray,
    *,
    costs: Sequence[np.ndarray],
    trim: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Choose, for every voxel, the pixel nearest to the mean of all that the matched neighbourhoods
    of all views lay on it.

    Parameters
    ----------
    matches, weights, trim
        As in `cast_plane_votes`.
    mean : (C, Z, Y, X) int16 or int8
        256 times the field to come near to, or in int8 that field.
    costs : sequence of (z, y, x) int32
        Factor of the squared distance of every voxel of a view's exemplar, 1 or more.

    Returns
    -------
    field : (C, Z, Y, X) int8
        The pixels' values; the mean where no neighbourhood reaches.
    sources : (Z, Y, X) int32
        Their numbers: view after view, in the order of each view's stack; -1 where there is none.
    """
    exemplars = [view.grid.candidates.stack.field for view in views.grids]
    pixels = np.concatenate([exemplar.reshape(len(mean), -1) for exemplar in exemplars], axis=1)
    begins = np.cumsum([0] + [exemplar[0].size for exemplar in exemplars])[:-1]
    arguments = [
        (int(begin), *arrays, view_layout(view, trim))
        for view, begin, *arrays in zip(
            views.grids, begins, exemplars, costs, matches, weights, strict=True
        )
    ]
    shape = views.region.shape
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
            for each in arguments:
                axis = each[-1].axis
                seen, least, taken = (
                    np.ascontiguousarray(np.moveaxis(part, axis - 3, -3))
                    for part in (aim, cost, found)
                )
                compare_pixels(seen, least, taken, first, *each)
                cost, found = (np.moveaxis(part, 0, axis) for part in (least, taken))
            field[:, here], sources[here] = round_votes(aim), found
            paint(pixels, sources[here], field, first)

    for_slabs(work, shape[0], anywhere=True)
    return field, sources


def position_excess(
    sources: np.ndarray | None, views: RegionViews, strength: float
) -> list[np.ndarray]:
    """Return 1 + strength times (n - 1) for every pixel (z, y, x) of every view that is the source
    of n > 1 times its even share.
    """
    shapes = [view.grid.candidates.stack.field.shape[1:] for view in views.grids]
    sizes = [int(np.prod(shape)) for shape in shapes]
    if sources is None or not strength:
        return [np.ones(shape) for shape in shapes]

    def count(start: int, stop: int) -> np.ndarray:
        found = np.zeros(sum(sizes), np.int64)
        count_sources(sources, found, start, stop)
        return found

    counts = sum_slabs(count, len(sources))
    even = max(1, int(counts.sum())) / sum(sizes)
    over = 1 + strength * np.maximum(counts / even - 1, 0)
    parts = np.split(over, np.cumsum(sizes)[:-1])
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]


@kernel
def compare_pixels(mean, cost, chosen, start, first, field, costs, match, weight, layout):
    """Compare the exemplar's voxels matched with each voxel of a slab, from plane `start` on, and
    keep the one nearest in value to `mean`.

    mean (C, ...) int16, 256 times a value; cost (...) int64 the least so far and chosen (...) int32
    the voxel that it belongs to, numbered from `first`, both updated; all three of the slab, with
    the axis of the view first. field (C, z, y, x) int8; costs (z, y, x) int32, a factor of the
    squared distance. Of equals the first one stays. The rest as in `add_votes`.
    """
    shape, sides, strides, steps, width, trims, wraps, axis = layout
    C, EY, EX = len(field), field.shape[2], field.shape[3]
    SY, SX = match.shape[1:]
    low = 0 if axis == 0 else start
    high = low + cost.shape[1]
    for plane in range(len(cost)):
        site = start + plane if axis == 0 else plane
        for sy in range(SY):
            y0, y1 = reach(sy, SY, width, trims[1], wraps[1])
            if not _meets(sy * steps[1] + y0, sy * steps[1] + y1, low, high, sides[1]):
                continue
            for sx in range(SX):
                if weight[site, sy, sx] == 0:
                    continue
                x0, x1 = reach(sx, SX, width, trims[2], wraps[2])
                m = match[site, sy, sx]
                ez = m // (shape[2] * shape[1]) * strides[0]
                ey = (m // shape[2]) % shape[1] * strides[1]
                ex = m % shape[2] * strides[2]
                for dy in range(y0, y1):
                    y = _around(sy * steps[1] + dy, sides[1]) - low
                    if y < 0 or y >= cost.shape[1]:
                        continue
                    for dx in range(x0, x1):
                        x = _around(sx * steps[2] + dx, sides[2])
                        apart = np.int64(0)
                        for c in range(C):
                            d = (np.int64(field[c, ez, ey + dy, ex + dx]) << 8) - mean[
                                c, plane, y, x
                            ]
                            apart += d * d
                        # A distance of 0 would hide the cost.
                        apart = (apart + 256) * costs[ez, ey + dy, ex + dx]
                        if apart < cost[plane, y, x]:
                            cost[plane, y, x] = apart
                            chosen[plane, y, x] = first + (ez * EY + ey + dy) * EX + ex + dx


@inline
def _around(place, side):
    """Return a place along an axis that wraps."""
    while place >= side:
        place -= side
    return place


@inline
def _meets(begin, end, low, high, side):
    """Return whether any of begin .. end, around an axis of `side`, is within low .. high."""
    meets = False
    for row in range(begin, end):
        meets |= low <= _around(row, side) < high
    return meets


@kernel
def paint(pixels, chosen, field, start):
    """Give voxels of (C, Z, Y, X) int8 from plane `start` on the value (C, n) of the pixel that was
    chosen, where one was.
    """
    for z in range(chosen.shape[0]):
        for y in range(chosen.shape[1]):
            for x in range(chosen.shape[2]):
                if chosen[z, y, x] >= 0:
                    for c in range(len(field)):
                        field[c, start + z, y, x] = pixels[c, chosen[z, y, x]]


@kernel
def count_sources(sources, counts, start, stop):
    """Count the voxels of planes start..stop of (Z, Y, X) of which each pixel is the source, added
    to counts (n,); -1 is none.
    """
    for z in range(start, stop):
        for y in range(sources.shape[1]):
            for x in range(sources.shape[2]):
                if sources[z, y, x] >= 0:
                    counts[sources[z, y, x]] += 1
