"""A run of `sliced`: the coarsest level is laid out from noise, then search and vote refine it.

The layout's planes hold the pictures' neighbourhoods, none of them copied. Steps on the two-point
function follow every third sliced round, and every vote.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.synth.shared.coarse_to_fine import RoundStage, at_level
from trabecula.synth.shared.content.fields import noise, votes_of
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.matching.grid import coherent_search, targets_of
from trabecula.synth.shared.matching.planes import RegionViews, cast_plane_votes
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import join_to_known, match_votes, refine_field
from trabecula.synth.shared.pyramid import fit_to
from trabecula.synth.shared.solid.run import ViewRounds, ViewStage
from trabecula.synth.shared.statistics.sliced import transport_planes
from trabecula.synth.shared.statistics.two_point import Correlations
from trabecula.synth.shared.statistics.two_point_steps import two_point_step
from trabecula.synth.sliced.aims import Layout, reweight_target
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

    def enter(self, stage: LayoutStage | SlicedStage, place: int) -> None:
        """Start from noise, or bring the field to a level and its matches to random patches."""
        if isinstance(stage, LayoutStage):
            shape = (len(stage.targets), *stage.region.shape)
            self.field = match_votes(
                stage.region,
                noise(shape, int(key(self.request.seed, "sliced/noise"))),
                stage.targets,
            )
            return
        region = stage.views.region
        self.field = region.clip_to_bounds(
            refine_field(self.field, region.wraps, distances=True, shape=region.shape)
            if stage.index < self.top
            else fit_to(self.field, region.shape)
        )
        self.start_matches(stage)
        self.votes = votes_of(self.field)

    def round(self, stage: LayoutStage | SlicedStage, number: int) -> None:
        """Do a sliced round of the layout, or a round of search and vote."""
        if isinstance(stage, LayoutStage):
            self._lay_out(stage, number)
        else:
            super().round(stage, number)

    def _lay_out(self, stage: LayoutStage, number: int) -> None:
        """Move the planes' neighbourhoods towards the pictures', sometimes with steps after it."""
        region = stage.region
        self.field = match_votes(
            region,
            transport_planes(
                votes_of(self.field),
                stage.layout.views,
                key=key(self.request.seed, "sliced/layout"),
                number=number,
                step=1,
                strength=self.config.strength,
                periodic=region.wraps,
                free=region.free,
            ),
            stage.targets,
        )
        if (number + 1) % _STEP_EVERY == 0:
            for _ in range(self.config.layout_steps):
                votes = two_point_step(
                    self.field, stage.correlations, periodic=region.wraps, free=region.free
                )
                self.field = match_votes(region, votes, stage.targets)
                del votes

    def find_matches(
        self, stage: SlicedStage, place: int, number: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find new matches, and their distances, in one view."""
        config, view = self.config, stage.views.grids[place]
        return coherent_search(
            view.grid,
            self.matches[place],
            view.put_axis_first(self.field),
            stage=stage.stage + np.uint64(place),
            first=1 if number == 0 else 1 + config.sweeps * (_FIRST + number - 1),
            count=config.sweeps * (_FIRST if number == 0 else 1),
            tries=config.tries,
            index_penalty=0.0,
        )

    def vote(self, stage: SlicedStage, number: int) -> None:
        """Make the field that the matches vote for."""
        views = stage.views
        self.votes = join_to_known(
            views.region, cast_plane_votes(views, self.matches, self.weights)
        )
        self.weights = []
        self.field = match_votes(views.region, self.votes, views.targets)

    def correct(self, stage: SlicedStage, number: int) -> None:
        """Take steps on the two-point function of the phases."""
        views = stage.views
        for _ in range(stage.steps):
            self.votes = distance_step(self.field, stage.target, views.region)
            self.field = match_votes(views.region, self.votes, views.targets)

    def arrays(self, stage: LayoutStage | SlicedStage, number: int) -> dict[str, np.ndarray]:
        """Return all that the next round starts from."""
        if isinstance(stage, LayoutStage):
            return {"field": self.field}
        return super().arrays(stage, number)
