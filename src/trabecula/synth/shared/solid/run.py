"""Rounds of search and vote on the planes of several views of one volume."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine import memmap
from trabecula.synth.shared.coarse_to_fine import (
    CoarseToFine,
    RoundStage,
    at_level,
    levels_for,
    trim_schedule,
)
from trabecula.synth.shared.content.fields import votes_of
from trabecula.synth.shared.matching.grid import (
    coherent_search,
    exact_search,
    features_of,
    random_matches,
)
from trabecula.synth.shared.matching.planes import RegionViews, cast_plane_votes
from trabecula.synth.shared.matching.region import Region, regions_of
from trabecula.synth.shared.matching.rounds import (
    equal_weights,
    join_to_known,
    match_votes,
    refine_field,
    robust_weights,
)
from trabecula.synth.shared.matching.sources import carry_matches
from trabecula.synth.shared.statistics.two_point import Correlations
from trabecula.synth.shared.statistics.two_point_steps import accumulate_debt, two_point_step

if TYPE_CHECKING:
    from trabecula.synth.shared.solid.model import SolidModel


@dataclass(frozen=True)
class ViewStage(RoundStage):
    """Rounds on the views of one region.

    Attributes
    ----------
    index : int
        Level, 0 the finest.
    views : RegionViews
    stage : uint64
        Key of the random numbers of the first view; each other view has the next.
    """

    index: int
    views: RegionViews
    stage: np.uint64


ViewStageT = TypeVar("ViewStageT", bound=ViewStage)


class ViewRounds(CoarseToFine[ViewStageT]):
    """A run on views.

    Attributes
    ----------
    matches : list of (sz, sy, sx) int32
        The candidate of every site, one array a view.
    weights : list of (sz, sy, sx) int32
        Those of the next vote, one array a view; empty between rounds.
    votes : (C, Z, Y, X) int16
        256 times the mean that was voted for.
    field : (C, Z, Y, X) int8
    sources : (Z, Y, X) int32, optional
        The pixel of every voxel.
    debt : (C, bins), optional
        Misfit of the two-point function that the next steps make up for.
    """

    votes: np.ndarray
    field: np.ndarray

    def __init__(self) -> None:
        self.matches: list[np.ndarray] = []
        self.weights: list[np.ndarray] = []
        self.sources: np.ndarray | None = None
        self.debt: np.ndarray | None = None

    def search(self, stage: ViewStageT, number: int) -> None:
        """Find new matches in every view, and what they weigh in the vote."""
        self.weights = []
        for place, view in enumerate(stage.views.grids):
            self.matches[place], distance = self.find_matches(stage, place, number)
            self.weights.append(robust_weights(view.grid, distance, self.robustness))
            del distance

    @property
    @abstractmethod
    def robustness(self) -> float:
        """Return the exponent of the distances that are minimised."""

    @abstractmethod
    def find_matches(
        self, stage: ViewStageT, place: int, number: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find new matches, and their distances, in one view."""

    def start_matches(self, stage: ViewStageT) -> None:
        """Match every site with a random patch."""
        self.matches = [
            random_matches(view.grid, stage.stage + np.uint64(place))
            for place, view in enumerate(stage.views.grids)
        ]

    def arrays(self, stage: ViewStageT, number: int) -> dict[str, np.ndarray]:
        """Return all that the next round starts from."""
        arrays = {f"match{place}": match for place, match in enumerate(self.matches)}
        arrays |= {"votes": self.votes, "field": self.field}
        arrays |= {} if self.sources is None else {"sources": self.sources}
        return arrays | ({} if self.debt is None else {"debt": self.debt})

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Take over the arrays of a checkpoint."""
        count = sum(name.startswith("match") for name in arrays)
        self.matches = [arrays[f"match{place}"] for place in range(count)]
        self.field = arrays["field"]
        if "votes" in arrays:
            self.votes = arrays["votes"]
        self.sources, self.debt = arrays.get("sources"), arrays.get("debt")


@dataclass(frozen=True)
class SolidStage(ViewStage):
    """Rounds on one level.

    Attributes
    ----------
    trims : sequence of int
        Voxels at the rim of a neighbourhood that do not vote, one a round.
    sweeps : int
        Of the search, in a round.
    target : Correlations, optional
    steps : int
        Towards the target after every round.
    """

    trims: Sequence[int]
    sweeps: int
    target: Correlations | None
    steps: int


class SolidRounds(ViewRounds[SolidStage]):
    """A run from random patches on the coarsest level, with as many levels as suit the request."""

    def __init__(self, model: SolidModel, request: Request) -> None:
        super().__init__()
        config = model.config
        self.model, self.config = model, config
        self.request = request
        self.used = levels_for(request.shape, len(model.levels), width=config.neighbourhood)
        self.regions: list[Region] = regions_of(
            request,
            self.used,
            model.content.bounds(request, thin=True),
            model.quantise_level,
            thin=True,
        )

    @property
    def names(self) -> list[str]:
        """List the names of the levels, coarsest first."""
        return [f"level {index}" for index in reversed(range(self.used))]

    @property
    def robustness(self) -> float:
        """Return the exponent of the distances that are minimised."""
        return float(self.config.robustness)

    def open_stage(self, place: int) -> SolidStage:
        """Prepare the views of a level; the region itself is not needed after that."""
        config, model = self.config, self.model
        index = self.used - 1 - place
        level, rounds = model.levels[index], at_level(config.rounds, index)
        if place == 0:
            rounds = config.first_rounds
        del self.regions[index + 1 :]
        views = RegionViews.over(
            self.regions.pop(),
            level.views,
            model.content.target_histograms(level.histograms, self.request),
        )
        trims = trim_schedule(
            rounds,
            config.trim,
            width=config.neighbourhood,
            step=config.step,
            grain=not model.content.distances,
        )
        return SolidStage(
            f"level {index}",
            f"level {self.used - index} of {self.used}",
            rounds,
            index,
            views,
            key(self.request.seed, f"{model.capabilities.name}/{index}"),
            trims=trims if index == 0 else [0] * rounds,
            sweeps=at_level(config.sweeps, index),
            target=level.correlations if self.request.fixed is None else None,
            steps=at_level(config.corrections, index),
        )

    def enter(self, stage: SolidStage, place: int) -> None:
        """Start from random patches, or double the field and move its matches along."""
        views, region = stage.views, stage.views.region
        if place == 0:
            self.start_matches(stage)
            shape = (len(views.targets), *region.shape)
            self.votes, self.field = memmap.zeros(shape, np.int16), memmap.zeros(shape, np.int8)
            self.weights = [equal_weights(view.grid.active) for view in views.grids]
            self.cast(stage, 0)
            return
        coarser = self.model.levels[stage.index + 1].views
        field = refine_field(
            self.field,
            region.wraps,
            distances=self.model.content.distances,
            shape=region.shape,
        )
        self.field = region.clip_to_bounds(field)
        self.matches = [
            carry_matches(match, old, view.grid.candidates, view.grid.shape, factor=2)
            for match, (_, old), view in zip(self.matches, coarser, views.grids, strict=True)
        ]
        self.votes = votes_of(self.field)
        self.sources = self.debt = None

    def find_matches(
        self, stage: SolidStage, place: int, number: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find new matches, and their distances, in one view."""
        config, view = self.config, stage.views.grids[place]
        old = self.matches[place]
        seen = view.put_axis_first(self.field)
        if config.search == "exact":
            return exact_search(
                view.grid, old, features_of(view.grid, seen), index_penalty=config.index_penalty
            )
        return coherent_search(
            view.grid,
            old,
            seen,
            stage=stage.stage + np.uint64(place),
            first=number * stage.sweeps + 1,
            count=stage.sweeps,
            tries=config.tries,
            index_penalty=config.index_penalty,
        )

    def vote(self, stage: SolidStage, number: int) -> None:
        """Make the field that the matches vote for."""
        self.cast(stage, stage.trims[number])

    def cast(self, stage: SolidStage, trim: int) -> None:
        """Cast the votes, each voxel of an exemplar with its factor, and match their histogram."""
        views = stage.views
        votes = cast_plane_votes(
            views, self.matches, self.weights, factors=self.factors(stage), trim=trim
        )
        self.use_votes(stage, votes)
        del votes
        self.weights = []

    def factors(self, stage: SolidStage) -> list[np.ndarray] | None:
        """Return the factor (z, y, x) int16 of every voxel of each view's exemplar; None where all
        count alike.
        """
        return None

    def use_votes(self, stage: SolidStage, votes: np.ndarray) -> None:
        """Make votes the next field: joined to known voxels, with the histograms that are
        required.
        """
        views = stage.views
        self.votes = join_to_known(views.region, votes)
        self.field = match_votes(
            views.region, self.votes, views.targets if self.config.histogram else None
        )

    def correct(self, stage: SolidStage, number: int) -> None:
        """Take steps on the two-point function of the free voxels."""
        views, target = stage.views, stage.target
        region = stage.views.region
        if target is None or not stage.steps:
            return
        last = stage.index == 0 and number == stage.rounds - 1
        self.debt = (
            None  # no later vote takes anything back
            if last
            else accumulate_debt(
                self.debt, self.field, target, periodic=region.wraps, free=region.free
            )
        )
        for _ in range(stage.steps):
            self.votes = two_point_step(
                self.field, target, debt=self.debt, periodic=region.wraps, free=region.free
            )
            self.field = match_votes(region, self.votes, views.targets)
