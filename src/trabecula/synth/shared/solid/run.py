"""Rounds of search and vote on the planes of several views of one volume."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine.memory import Stage, Workspace
from trabecula.synth.shared.coarse_to_fine import (
    CoarseToFine,
    RoundStage,
    at_level,
    levels_for,
    trim_schedule,
)
from trabecula.synth.shared.content.fields import votes_of
from trabecula.synth.shared.content.histogram import Histogram
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
    refine_field,
)
from trabecula.synth.shared.matching.sources import carry_matches
from trabecula.synth.shared.statistics.two_point import Correlations
from trabecula.synth.shared.statistics.two_point_steps import accumulate_debt, two_point_step

if TYPE_CHECKING:
    from trabecula.synth.shared.solid.model import SolidLevel, SolidModel


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

    Its arrays, as `LevelMemory` declares them: of every view `match` (the candidate of every site)
    and `weight` (in the next vote); `votes` (256 times the mean that was voted for), `field`, and
    where voxels are pixels their `sources`.

    Attributes
    ----------
    debt : (C, bins), optional
        Misfit of the two-point function that the next steps make up for.
    """

    def __init__(self) -> None:
        self.debt: np.ndarray | None = None

    def search(self, stage: ViewStageT, number: int) -> None:
        """Find new matches in every view, and what they weigh in the vote."""
        for place in range(len(stage.views.grids)):
            self._search_view(stage, place, number)
            self.work.release("distance")

    def _search_view(self, stage: ViewStageT, place: int, number: int) -> None:
        work, view = self.work, stage.views.grids[place]
        work.enter(f"search{place}")
        if view.axis:
            work.adopt("seen", view.put_axis_first(work["field"]))
        field = work["seen" if view.axis else "field"]
        found = self.find_matches(stage, place, number, field)
        del field
        self.weigh_matches(view.grid, found, self.robustness, place)

    @property
    @abstractmethod
    def robustness(self) -> float:
        """Return the exponent of the distances that are minimised."""

    @abstractmethod
    def find_matches(
        self, stage: ViewStageT, place: int, number: int, field: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find new matches, and their distances, in one view of the field, its axis first."""

    def open_level(self, stage: ViewStageT) -> None:
        """Hold the arrays of a level that stay as they are."""
        views = stage.views
        active = {f"active{place}": view.grid.active for place, view in enumerate(views.grids)}
        self.open_region("start", views.region, active)

    def start_matches(self, stage: ViewStageT) -> None:
        """Match every site with a random patch."""
        for place, view in enumerate(stage.views.grids):
            match = random_matches(view.grid, stage.stage + np.uint64(place))
            self.work.adopt(f"match{place}", match)

    def each(self, name: str, stage: ViewStageT) -> list[np.ndarray]:
        """List the arrays "match" or "weight" of all views."""
        return [self.work[f"{name}{place}"] for place in range(len(stage.views.grids))]

    def cast(
        self, stage: ViewStageT, factors: Sequence[np.ndarray] | None = None, trim: int = 0
    ) -> None:
        """Cast the votes, each voxel of an exemplar with its factor; join them to known voxels."""
        views, work = stage.views, self.work
        work.enter("vote")
        work.release("votes")
        matches, weights = self.each("match", stage), self.each("weight", stage)
        work.adopt("votes", cast_plane_votes(views, matches, weights, factors=factors, trim=trim))
        self.join_votes(views.region)

    def arrays(self, stage: ViewStageT, number: int) -> dict[str, np.ndarray]:
        """Return all that the next round starts from."""
        names = [f"match{place}" for place in range(len(stage.views.grids))]
        names += ["votes", "field", *(["sources"] if "sources" in self.work else [])]
        debt = {} if self.debt is None else {"debt": self.debt}
        return {name: self.work[name] for name in names} | debt

    def restore(self, stage: ViewStageT, arrays: dict[str, np.ndarray]) -> None:
        """Take over the arrays of a checkpoint."""
        self.debt = arrays.pop("debt", None)
        self.open_level(stage)
        for name, array in arrays.items():
            self.work.adopt(name, array)


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
    def costs(self) -> list[float]:
        """List rounds times voxels of the levels."""
        return [self._rounds(index) / 8**index for index in reversed(range(self.used))]

    def _rounds(self, index: int) -> int:
        """Return the rounds on a level."""
        coarsest = index == self.used - 1
        return self.config.first_rounds if coarsest else at_level(self.config.rounds, index)

    @property
    def robustness(self) -> float:
        """Return the exponent of the distances that are minimised."""
        return float(self.config.robustness)

    def open_stage(self, place: int) -> SolidStage:
        """Prepare the views of a level; the region itself is not needed after that."""
        config, model = self.config, self.model
        index = self.used - 1 - place
        level, rounds = model.levels[index], self._rounds(index)
        del self.regions[index + 1 :]
        self.debt = None
        views = RegionViews.over(self.regions.pop(), level.views, self.targets(level))
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

    def targets(self, level: SolidLevel) -> tuple[Histogram, ...]:
        """Return the histograms that the field of a level is matched to."""
        return self.model.content.target_histograms(level.histograms, self.request)

    def memory(self, stage: SolidStage) -> Iterable[Stage]:
        """Declare the arrays of a level."""
        return self.model.level_memory(self.request, stage.index, stage.views.region).stages()

    def enter(self, stage: SolidStage, place: int, before: Workspace) -> None:
        """Start from random patches, or double the field and move its matches along."""
        views, region, work = stage.views, stage.views.region, self.work
        self.open_level(stage)
        if place == 0:
            self.start_matches(stage)
            work.zeros("votes")
            for number, view in enumerate(views.grids):
                work.adopt(f"weight{number}", equal_weights(view.grid.active))
            self.vote(stage, None)
            return
        content = self.model.content
        field = refine_field(
            before["field"],
            region.wraps,
            distances=content.distances,
            features=content.features,
            shape=region.shape,
        )
        work.adopt("field", region.clip_to_bounds(field))
        work.adopt("votes", votes_of(field))
        coarser = self.model.levels[stage.index + 1].views
        for number, ((_, old), view) in enumerate(zip(coarser, views.grids, strict=True)):
            match, grid = before[f"match{number}"], view.grid
            carried = carry_matches(match, old, grid.candidates, grid.shape, factor=2)
            work.adopt(f"match{number}", carried)

    def find_matches(
        self, stage: SolidStage, place: int, number: int, field: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find new matches, and their distances, in one view of the field, its axis first."""
        config, view = self.config, stage.views.grids[place]
        old = self.work[f"match{place}"]
        if config.search == "exact":
            features = features_of(view.grid, field)
            return exact_search(view.grid, old, features, index_penalty=config.index_penalty)
        return coherent_search(
            view.grid,
            old,
            field,
            stage=stage.stage + np.uint64(place),
            first=number * stage.sweeps + 1,
            count=stage.sweeps,
            tries=config.tries,
            index_penalty=config.index_penalty,
        )

    def vote(self, stage: SolidStage, number: int | None) -> None:
        """Make the field that the matches vote for; without a `number`, before the first round."""
        trim = 0 if number is None else stage.trims[number]
        self.cast(stage, self.factors(stage), trim)
        self.match_field(stage.views.region, stage.views.targets if self.config.histogram else None)

    def factors(self, stage: SolidStage) -> list[np.ndarray] | None:
        """Return the factor (z, y, x) int16 of every voxel of each view's exemplar; None where all
        count alike.
        """
        return None

    def correct(self, stage: SolidStage, number: int) -> None:
        """Take steps on the two-point function of the free voxels."""
        views, target, work = stage.views, stage.target, self.work
        if target is None or not stage.steps:
            return
        settings: dict[str, Any] = {"periodic": views.region.wraps, "free": views.region.free}
        work.enter("rest")
        last = stage.index == 0 and number == stage.rounds - 1
        # no later vote takes anything back
        self.debt = None if last else accumulate_debt(self.debt, work["field"], target, **settings)
        for _ in range(stage.steps):
            work.enter("rest")
            work.release("votes")
            work.adopt("votes", two_point_step(work["field"], target, debt=self.debt, **settings))
            self.match_field(views.region, views.targets)
