"""Search and vote from random patches to the finest level: the paper's way, and `novelty` 0.

The votes are made into the field and dropped; only the very last ones are kept, of which no field
is made.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.synth.shared.coarse_to_fine import CoarseToFine, RoundStage, at_level, trim_schedule
from trabecula.synth.shared.matching.grid import (
    Grid,
    coherent_search,
    exact_search,
    features_of,
    random_matches,
)
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import (
    cast_votes,
    equal_weights,
    join_to_known,
    match_votes,
    refine_field,
    robust_weights,
)
from trabecula.synth.shared.matching.sources import Candidates, Stack, carry_matches
from trabecula.synth.shared.pyramid import fit_to
from trabecula.synth.shared.statistics.two_point import Correlations
from trabecula.synth.shared.statistics.two_point_steps import accumulate_debt, two_point_step
from trabecula.synth.texture.config import TextureConfig
from trabecula.synth.texture.energy_rounds import Balance, energy_vote
from trabecula.synth.texture.graded import FractionTarget, guide_grid, settle_fractions

# a coarsest level at less than this scale is too large for neighbourhoods at every voxel
_SPARSE_BELOW = 4

Level = tuple[Candidates, ...]
"""The exemplars' neighbourhoods at one resolution, one entry per width of the config."""


def level_of(stack: Stack, index: int, config: TextureConfig, *, distances: bool) -> Level:
    """Learn one level; `distances` says whether its field is smooth."""
    return tuple(
        Candidates.of(
            stack,
            width=width,
            step=config.step_of(width),
            variance=config.variance,
            most=config.components,
            smooth=index == 0 and distances,
            k=config.nearest,
        )
        for width in config.neighbourhood
    )


@dataclass(frozen=True)
class GridStage(RoundStage):
    """Rounds on one grid.

    Attributes
    ----------
    index, number : int
        Level, 0 the finest, and place of the neighbourhood's width.
    grid : Grid
    stage : uint64
        Key of its random numbers.
    trims : sequence of int
        Voxels at the rim of a neighbourhood that do not vote, one a round.
    target : Correlations, optional
    steps : int
        Towards the target after every round.
    fractions : FractionTarget, optional
        The volume fraction that is required around every voxel.
    last : bool
        Whether no stage follows.
    """

    index: int
    number: int
    grid: Grid
    stage: np.uint64
    trims: Sequence[int]
    target: Correlations | None
    steps: int
    fractions: FractionTarget | None
    last: bool


class ExemplarRounds(CoarseToFine[GridStage]):
    """A run from random patches.

    Parameters
    ----------
    levels, regions
        As many levels of the exemplar and of the output, finest first.
    request, config
    distances : bool
        Whether fields are smooth.
    targets : sequence of Correlations
        One a level, where `corrections` of the config step towards them.
    fractions : sequence of (Z, Y, X) float32
        One a level, where the request has a target (`graded`).

    Attributes
    ----------
    match : (sz, sy, sx) int32
        The candidate of each site.
    field : (C, Z, Y, X) int8
        The field that the matches voted for; None while votes are cast, and at the end.
    weights : (sz, sy, sx) int32
        Of the next vote; None between rounds.
    votes : (C, Z, Y, X) int16
        The last ones, 256 times the weighted mean; None before.
    debt : (C, K), optional
        Misfit of the two-point functions that the next steps make up for.
    balance : Balance, optional
        Where rounds follow the energy.
    energies : list of dict
        Those of the stages that are done.
    """

    def __init__(
        self,
        levels: Sequence[Level],
        regions: Sequence[Region],
        request: Request,
        config: TextureConfig,
        *,
        distances: bool,
        targets: Sequence[Correlations] = (),
        fractions: Sequence[np.ndarray] = (),
    ) -> None:
        self.levels, self.regions = levels, regions
        self.request, self.config = request, config
        self.distances = distances
        self.targets, self.fractions = targets, fractions
        self.match: np.ndarray | None = None
        self.field: np.ndarray | None = None
        self.weights: np.ndarray | None = None
        self.votes: np.ndarray | None = None
        self.debt: np.ndarray | None = None
        self.balance: Balance | None = None
        self.energies: list[dict[str, Any]] = []
        self._before: Candidates | None = None  # of the stage before

    @property
    def places(self) -> list[tuple[int, int]]:
        """List the level and the place of the width of every stage, in their order."""
        return [
            (index, number)
            for index in reversed(range(len(self.regions)))
            for number in range(len(self.levels[index]))
        ]

    @property
    def names(self) -> list[str]:
        """List the names of the stages, coarsest first."""
        return [f"level {index} width {number}" for index, number in self.places]

    def open_stage(self, place: int) -> GridStage:
        """Prepare the grid of a stage."""
        index, number = self.places[place]
        config, used = self.config, len(self.regions)
        candidates, coarsest = self.levels[index][number], index == used - 1
        if coarsest and 2**index >= _SPARSE_BELOW and config.step:
            candidates = replace(candidates, step=1)
        grid, fractions = Grid.over(self.regions[index], candidates), None
        if self.fractions:
            grid, fractions = guide_grid(grid, self.fractions[index], index)
        rounds = config.first_rounds if coarsest else at_level(config.rounds, index)
        grain = not self.distances and config.field != "indicator" and not config.energetic
        trims = trim_schedule(
            rounds, config.trim, width=candidates.basis.width, step=candidates.step, grain=grain
        )
        even = self.request.fixed is None and not self.fractions and not config.energetic
        target = self.targets[index] if index < len(self.targets) and even else None
        return GridStage(
            self.names[place],
            f"level {used - index} of {used}",
            rounds,
            index,
            number,
            grid,
            key(self.request.seed, f"texture/{index}" + (f"/{number}" if number else "")),
            trims if index == 0 else [0] * rounds,
            target,
            at_level(config.corrections, index) if target else 0,
            fractions,
            place == len(self.places) - 1,
        )

    def enter(self, stage: GridStage, place: int) -> None:
        """Start from random patches of the same weight, or bring field and matches to this grid."""
        grid = stage.grid
        if self._before is None:
            self.match = random_matches(grid, stage.stage)
            votes = join_to_known(
                grid.region, cast_votes(grid, self.match, equal_weights(grid.active))
            )
            self._use_votes(stage, votes, histogram=True, last=False)
        else:
            self._refine(stage, self._before, finer=stage.number == 0)
        self.balance = Balance.at_first(self.config, stage.rounds)

    def _refine(self, stage: GridStage, before: Candidates, *, finer: bool) -> None:
        """Bring the field to the next grid (a distance doubles too), and move the matches along."""
        assert self.field is not None  # a stage that is not the last leaves it
        region, (old, self.field) = stage.grid.region, (self.field, None)
        fitted = (
            refine_field(old, region.wraps, distances=self.distances, shape=region.shape)
            if finer
            else fit_to(old, region.shape)
        )
        del old
        self.field = region.clip_to_bounds(fitted)
        self.match = carry_matches(
            self._matches,
            before,
            stage.grid.candidates,
            stage.grid.shape,
            factor=2 if finer else 1,
        )
        self.debt = None

    @property
    def _matches(self) -> np.ndarray:
        assert self.match is not None  # from the start on
        return self.match

    def converges(self, stage: GridStage, number: int) -> bool:
        """Return whether the energy has settled."""
        assert self.balance is not None
        return bool(number and self.config.energetic and self.balance.feedback.is_over)

    def search(self, stage: GridStage, number: int) -> None:
        """Find a new match for every site, and what it weighs in the vote."""
        distance = self._find_matches(stage, number)
        if not self.config.energetic:
            self.weights = robust_weights(stage.grid, distance, self.config.robustness)

    def _find_matches(self, stage: GridStage, number: int) -> np.ndarray:
        """Find a new match for every site; return their distances."""
        assert self.field is not None
        config, grid = self.config, stage.grid
        if config.search == "exact":
            features = features_of(grid, self.field)
            self.match, distance = exact_search(
                grid, self._matches, features, index_penalty=config.index_penalty
            )
            return distance
        self.match, distance = coherent_search(
            grid,
            self._matches,
            self.field,
            stage=stage.stage,
            first=number * config.sweeps + 1,
            count=config.sweeps,
            tries=config.tries,
            index_penalty=config.index_penalty,
        )
        return distance

    def vote(self, stage: GridStage, number: int) -> None:
        """Make the field that the matches vote for."""
        grid, trim = stage.grid, stage.trims[number]
        last = number == stage.rounds - 1
        if self.config.energetic:
            assert self.field is not None and self.balance is not None
            votes, self.balance = energy_vote(
                grid, self.field, self._matches, self.balance, self.config, trim=trim
            )
            self.field = None
            last = last or self.balance.feedback.is_over
        else:
            assert self.weights is not None
            self.field = None
            votes = cast_votes(grid, self._matches, self.weights, trim=trim)
            self.weights = None
        votes = join_to_known(grid.region, votes)
        self._use_votes(
            stage, votes, histogram=self.config.histogram, last=last and not stage.steps
        )

    def _use_votes(
        self, stage: GridStage, votes: np.ndarray, *, histogram: bool, last: bool
    ) -> None:
        """Make votes a field with the histogram, or with the volume fractions that are required;
        keep the very last ones.
        """
        if stage.last and last:
            self.votes = votes
            return
        region = stage.grid.region
        field = match_votes(region, votes, stage.grid.targets if histogram else None)
        if stage.fractions is not None:
            field = region.clip_to_bounds(stage.fractions.shift_field(field))
        self.field = field

    def correct(self, stage: GridStage, number: int) -> None:
        """Take steps on the two-point function of the free voxels."""
        target, region = stage.target, stage.grid.region
        if target is None or not stage.steps:
            return
        assert self.field is not None
        last = number == stage.rounds - 1
        self.debt = (
            None  # no later vote takes anything back
            if stage.index == 0 and last
            else accumulate_debt(
                self.debt, self.field, target, periodic=region.wraps, free=region.free
            )
        )
        for step in range(stage.steps):
            before, self.field = self.field, None
            assert before is not None  # the step before was not the last
            votes = two_point_step(
                before, target, debt=self.debt, periodic=region.wraps, free=region.free
            )
            del before
            self._use_votes(stage, votes, histogram=True, last=last and step == stage.steps - 1)

    def leave(self, stage: GridStage) -> None:
        """Report the energies; at the end settle the volume fractions."""
        assert self.balance is not None
        self._before = stage.grid.candidates
        if trace := self.balance.trace():
            self.energies.append(
                {"level": stage.index, "width": self._before.basis.width, "energy": trace}
            )
        if stage.last and stage.fractions is not None:
            assert self.votes is not None
            self.votes = settle_fractions(self.votes, stage.fractions)

    def arrays(self, stage: GridStage, number: int) -> dict[str, np.ndarray]:
        """Return all that the next round starts from; nothing after the last one."""
        if self.field is None or self.balance is None:
            return {}
        words = json.dumps([self.energies, asdict(self.balance)]).encode()
        arrays = {
            "match": self._matches,
            "field": self.field,
            "words": np.frombuffer(words, np.uint8),
        }
        return arrays if self.debt is None else {**arrays, "debt": self.debt}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Take over the arrays of a checkpoint."""
        self.energies, balance = json.loads(bytes(arrays["words"]))
        self.balance = Balance.from_json(balance)
        self.match, self.field = arrays["match"], arrays["field"]
        self.debt = arrays.get("debt")


def make_from_patches(rounds: ExemplarRounds) -> tuple[np.ndarray, list[dict[str, Any]]]:
    """Return the last votes (C, Z, Y, X) int16 on the voxels that neighbourhoods cover, and the
    energies of rounds that follow them.
    """
    rounds.run()
    assert rounds.votes is not None  # the last stage leaves them
    return rounds.votes, rounds.energies
