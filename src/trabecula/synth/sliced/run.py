"""A run of `sliced`: the coarsest level is laid out from noise, then search and vote refine it.

The layout's planes hold the pictures' neighbourhoods, none of them copied. Steps on the two-point
function follow every third sliced round, and every vote.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine import memmap
from trabecula.engine.memory import Stage, Workspace
from trabecula.engine.parallel import for_slabs
from trabecula.synth.shared.coarse_to_fine import RoundStage, at_level
from trabecula.synth.shared.content.bounds import Bounds
from trabecula.synth.shared.content.fields import noise, quantise, votes_of
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.matching.grid import coherent_search, targets_of
from trabecula.synth.shared.matching.planes import RegionViews
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import refine_field
from trabecula.synth.shared.pyramid import fit_to
from trabecula.synth.shared.slabs import complement
from trabecula.synth.shared.solid.run import ViewRounds, ViewStage
from trabecula.synth.shared.statistics.sliced import transport_neighbourhoods
from trabecula.synth.shared.statistics.two_point import Correlations, reweight_target
from trabecula.synth.shared.statistics.two_point_steps import two_point_step
from trabecula.synth.sliced.aims import Layout
from trabecula.synth.sliced.steps import distance_step

if TYPE_CHECKING:
    from trabecula.synth.sliced.method import SlicedModel

_STEP_EVERY = 3  # sliced rounds between steps on the two-point function
_FIRST = 4  # times as many sweeps in the first round, which starts from random matches


@dataclass(frozen=True)
class LayoutStage(RoundStage):
    """Sliced rounds on the coarsest level, in `region`, towards `targets` and `correlations`."""

    layout: Layout
    region: Region
    targets: tuple[Histogram, ...]
    correlations: Correlations


@dataclass(frozen=True)
class SlicedStage(ViewStage):
    """Search and vote on one level, with so many steps towards `target` after every round."""

    target: Correlations
    steps: int


class SlicedRounds(ViewRounds[Any]):
    """A run from noise on the coarsest level.

    `regions` are those of all levels, finest first; each is dropped once its stage has begun.
    """

    def __init__(self, model: SlicedModel, request: Request, regions: list[Region]) -> None:
        super().__init__()
        self.model, self.config = model, model.config
        self.request = request
        self.regions, self.top = regions, len(regions) - 1
        # The layout is made of coarse neighbourhoods already, but not beside known voxels.
        self.first = self.top - bool(self.top and request.fixed is None)

    @property
    def names(self) -> list[str]:
        """List the names of the layout and of the levels, coarsest first."""
        return ["layout", *(f"level {index}" for index in range(self.first, -1, -1))]

    @property
    def costs(self) -> list[float]:
        """List rounds times voxels of the layout and of the levels."""
        levels = range(self.first, -1, -1)
        rounds = [at_level(self.config.rounds, index) / 8**index for index in levels]
        return [self.config.layout_rounds / 8**self.top, *rounds]

    @property
    def robustness(self) -> float:
        """Return the exponent of the distances that are minimised."""
        return self.config.robustness

    def open_stage(self, place: int) -> LayoutStage | SlicedStage:
        """Prepare the layout, or the views of a level."""
        config, content = self.config, self.model.content
        index = self.first + 1 - place
        if place == 0:
            layout, region = self.model.layouts[self.top], self.regions[self.top]
            histograms = content.target_histograms(layout.histograms, self.request)
            targets = targets_of(region, histograms, width=config.layout_width)
            correlations = reweight_target(
                layout.correlations,
                layout.histograms,
                targets,
                softness=layout.correlations.softness,
            )
            return LayoutStage(
                "layout", "laying out", config.layout_rounds, layout, region, targets, correlations
            )
        level = self.model.levels[index]
        del self.regions[index + 1 :]
        views = RegionViews.over(
            self.regions.pop(),
            level.views,
            content.target_histograms(level.histograms, self.request),
        )
        return SlicedStage(
            f"level {index}",
            f"level {index}",
            at_level(config.rounds, index),
            index,
            views,
            key(self.request.seed, f"sliced/{index}"),
            reweight_target(level.correlations, level.histograms, views.targets, softness=1.0),
            at_level(config.corrections, index),
        )

    def memory(self, stage: LayoutStage | SlicedStage) -> Iterable[Stage]:
        """Declare the arrays of the layout, or of a level."""
        if isinstance(stage, LayoutStage):
            return self.model.layout_stages(self.request, stage.region)
        return self.model.level_memory(self.request, stage.index, stage.views.region).stages()

    def enter(self, stage: LayoutStage | SlicedStage, place: int, before: Workspace) -> None:
        """Start from noise, or bring the field to a level and its matches to random patches."""
        work = self.work
        if isinstance(stage, LayoutStage):
            shape = (len(stage.targets), *stage.region.shape)
            work.enter("match")
            work.adopt("votes", noise(shape, int(key(self.request.seed, "sliced/noise"))))
            self.match_field(stage.region, stage.targets)
            return
        self.open_level(stage)
        region, coarse = stage.views.region, before["field"]
        field = work.adopt(
            "field",
            refine_field(coarse, region.wraps, distances=True, shape=region.shape)
            if stage.index < self.top
            else fit_to(coarse, region.shape),
        )
        work.adopt("votes", votes_of(region.clip_to_bounds(field)))
        self.start_matches(stage)

    def round(self, stage: LayoutStage | SlicedStage, number: int) -> None:
        """Do a sliced round of the layout, or a round of search and vote."""
        if isinstance(stage, LayoutStage):
            self._lay_out(stage, number)
        else:
            super().round(stage, number)

    def _lay_out(self, stage: LayoutStage, number: int) -> None:
        """Move the planes' neighbourhoods towards the pictures', sometimes with steps after it."""
        region, work = stage.region, self.work
        settings: dict[str, Any] = {"periodic": region.wraps, "free": region.free}
        work.enter("match")
        if "votes" in work:
            work.release("votes")
        work.adopt("votes", votes_of(work["field"]))
        work.enter("transport")
        work.adopt(
            "moved",
            transport_neighbourhoods(
                work["votes"],
                stage.layout.views,
                key=key(self.request.seed, "sliced/layout"),
                number=number,
                step=1,
                strength=self.config.strength,
                **settings,
            ),
        )
        work.release("votes")
        work.adopt("votes", work.take("moved"))
        self.match_field(region, stage.targets)
        steps = self.config.layout_steps if (number + 1) % _STEP_EVERY == 0 else 0
        for _ in range(steps):
            work.release("votes")
            work.adopt("votes", two_point_step(work["field"], stage.correlations, **settings))
            self.match_field(region, stage.targets)

    def find_matches(
        self, stage: SlicedStage, place: int, number: int, field: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find new matches, and their distances, in one view of the field, its axis first."""
        config, view = self.config, stage.views.grids[place]
        return coherent_search(
            view.grid,
            self.work[f"match{place}"],
            field,
            stage=stage.stage + np.uint64(place),
            first=1 if number == 0 else 1 + config.sweeps * (_FIRST + number - 1),
            count=config.sweeps * (_FIRST if number == 0 else 1),
            tries=config.tries,
            index_penalty=0.0,
        )

    def vote(self, stage: SlicedStage, number: int) -> None:
        """Make the field that the matches vote for."""
        self.cast(stage)
        self.match_field(stage.views.region, stage.views.targets)

    def correct(self, stage: SlicedStage, number: int) -> None:
        """Take steps on the two-point function of the phases."""
        views, work = stage.views, self.work
        for _ in range(stage.steps):
            work.enter("rest")
            work.release("votes")
            work.adopt("votes", distance_step(work["field"], stage.target, views.region))
            self.match_field(views.region, views.targets)

    def arrays(self, stage: LayoutStage | SlicedStage, number: int) -> dict[str, np.ndarray]:
        """Return all that the next round starts from."""
        if isinstance(stage, LayoutStage):
            return {"field": self.work["field"]}
        return super().arrays(stage, number)

    def restore(self, stage: LayoutStage | SlicedStage, arrays: dict[str, np.ndarray]) -> None:
        """Take over the arrays of a checkpoint."""
        if isinstance(stage, LayoutStage):
            self.work.enter("rest")
            self.work.adopt("field", arrays["field"])
        else:
            super().restore(stage, arrays)


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
