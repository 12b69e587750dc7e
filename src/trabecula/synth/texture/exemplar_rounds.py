"""Search and vote from random patches to the finest level: the paper's way, and `novelty` 0.

The votes are made into the field and freed; only the very last ones are kept, of which no field is
made.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine.memory import Stage, Workspace, within
from trabecula.synth.shared.coarse_to_fine import CoarseToFine, RoundStage, at_level, trim_schedule
from trabecula.synth.shared.content.fields import UNIT
from trabecula.synth.shared.local_offset import NARROWEST, LocalOffset
from trabecula.synth.shared.matching.grid import (
    Grid,
    coherent_search,
    exact_search,
    features_of,
    random_matches,
)
from trabecula.synth.shared.matching.neighbourhoods import grid_reach
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import cast_votes, equal_weights, refine_field
from trabecula.synth.shared.matching.sources import Candidates, Stack, carry_matches
from trabecula.synth.shared.pyramid import fit_to
from trabecula.synth.shared.stages import LevelMemory
from trabecula.synth.shared.statistics.two_point import Correlations
from trabecula.synth.shared.statistics.two_point_steps import (
    accumulate_debt,
    step_stages,
    two_point_step,
)
from trabecula.synth.shared.turned_exemplars import TurnedExemplars
from trabecula.synth.texture.config import TextureConfig
from trabecula.synth.texture.energy_rounds import Balance, energy_stages, energy_vote
from trabecula.synth.texture.graded import (
    FractionTarget,
    fraction_arrays,
    guide_grid,
    lead_grid,
    lead_guide,
    settle_fractions,
    settle_stages,
    shift_stages,
)
from trabecula.synth.texture.joined import StrutField, join_components, join_stages
from trabecula.synth.texture.turned_guide import guide_count, guide_turned

_FARTHEST = 45.0 * UNIT  # votes by which a field is shifted at most: one and a half voxels

_JOINED = 3  # rounds at the end of a level after which components are joined

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


def target_of(
    index: int, request: Request, config: TextureConfig, targets: Sequence[Correlations]
) -> Correlations | None:
    """Return the target of steps on the two-point function of a level; None where there are
    none.
    """
    even = request.fixed is None and not request.target and not config.energetic
    stepped = even and index < len(targets) and at_level(config.corrections, index)
    return targets[index] if stepped else None


def grid_stages(
    request: Request,
    region: Region,
    candidates: Candidates,
    config: TextureConfig,
    target: Correlations | None,
    *,
    refit: bool,
    mapped: bool = False,
) -> tuple[Stage, ...]:
    """Declare the arrays of a grid, with steps towards a target; `refit` says whether it follows
    another on its level.
    """
    level = LevelMemory(
        request,
        region,
        [(0, candidates)],
        sweeps=config.sweeps,
        exact=config.search == "exact",
        votes_rest=False,
        refit=refit,
        mapped=mapped,
    )
    shape, (sites,) = level.covered.shape, level.grids
    if request.target:
        held = fraction_arrays(shape, sites, config.grading, guide_count(request.target))
        level = replace(level, guides=1 + guide_count(request.target), held=held)
    if target is not None:
        level = replace(level, correction=step_stages(shape, target, region.wraps))
    rest, base = level.rest, {**level.base, **level.votes}
    stages = list(level.stages())
    if config.energetic:
        box, steps = candidates.basis.box, candidates.steps
        reach = grid_reach(sites, box=box, steps=steps)
        stages += within(rest, energy_stages(candidates.stack.field, shape, sites, reach))
    if request.target:
        if config.grading == "shift":
            stages += within({**rest, "shifted": rest["field"]}, shift_stages(shape))
            stages += within(base, settle_stages(shape))
        if config.connected != "none":
            stages += within(rest, join_stages(shape))
    return tuple(stages)


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
        The volume fraction that is required around every voxel, where the field is shifted to it.
    local : LocalOffset, optional
        The same, where it is fed back to the search.
    struts : StrutField, optional
        The solid becomes one component after every vote.
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
    local: LocalOffset | None
    struts: StrutField | None
    last: bool


class ExemplarRounds(CoarseToFine[GridStage]):
    """A run from random patches, on the arrays that `grid_stages` declares.

    Parameters
    ----------
    levels, regions
        As many levels of the exemplar and of the output, finest first; each region is dropped once
        its last stage has begun, so are the fractions.
    request, config
    distances : bool
        Whether fields are smooth.
    targets : sequence of Correlations
        One a level, where `corrections` of the config step towards them.
    fractions : list of (Z, Y, X) float32
        One a level, where the request has a target (`graded`).
    struts : sequence of StrutField or None
        One a level of the exemplar, where the solid is to be one component.
    copies : TurnedExemplars, optional
        What the levels are of, where the request has an orientation or a size.
    window : int
        Voxels a side of the windows whose fraction is held, where the request has a target.

    Attributes
    ----------
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
        regions: list[Region],
        request: Request,
        config: TextureConfig,
        *,
        distances: bool,
        targets: Sequence[Correlations],
        fractions: list[np.ndarray],
        struts: Sequence[StrutField | None] = (),
        copies: TurnedExemplars | None = None,
        window: int = NARROWEST,
    ) -> None:
        self.copies, self.window = copies, window
        self.levels, self.regions = levels, regions
        self.request, self.config = request, config
        self.distances = distances
        self.targets, self.fractions = targets, fractions
        self.graded, self.struts = bool(fractions), struts
        self.debt: np.ndarray | None = None
        self.balance: Balance | None = None
        self.energies: list[dict[str, Any]] = []
        self._before: Candidates | None = None  # of the stage before

    @property
    def places(self) -> list[tuple[int, int]]:
        """List the level and the place of the width of every stage, in their order."""
        return [
            (index, number)
            for index in reversed(range(len(self.levels)))
            for number in range(len(self.levels[index]))
        ]

    @property
    def names(self) -> list[str]:
        """List the names of the stages, coarsest first."""
        return [f"level {index} width {number}" for index, number in self.places]

    @property
    def costs(self) -> list[float]:
        """List rounds times voxels of the stages."""
        return [self._rounds(index) / 8**index for index, _ in self.places]

    def _rounds(self, index: int) -> int:
        """Return the rounds on a level."""
        coarsest = index == len(self.levels) - 1
        return self.config.first_rounds if coarsest else at_level(self.config.rounds, index)

    def open_stage(self, place: int) -> GridStage:
        """Prepare the grid of a stage."""
        index, number = self.places[place]
        config, used = self.config, len(self.levels)
        candidates, coarsest = self.levels[index][number], index == used - 1
        if coarsest and 2**index >= _SPARSE_BELOW and config.step:
            candidates = replace(candidates, step=1)
        grid = Grid.over(self.regions[index], candidates)
        fractions, local = None, None
        if self.graded and config.grading != "shift":
            grid, local = lead_grid(grid, self.fractions[index], index, self.window)
        elif self.graded:
            grid, fractions = guide_grid(grid, self.fractions[index], index)
        if self.copies is not None:
            grid = guide_turned(grid, self.copies, self.request.target, index)
        needed = index + (number < len(self.levels[index]) - 1)
        del self.regions[needed:], self.fractions[needed:]
        rounds = self._rounds(index)
        grain = not self.distances and config.field != "indicator" and not config.energetic
        trims = trim_schedule(
            rounds, config.trim, width=candidates.basis.width, step=candidates.step, grain=grain
        )
        target = target_of(index, self.request, config, self.targets)
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
            at_level(config.corrections, index),
            fractions,
            local,
            self.struts[index] if self.struts else None,
            place == len(self.places) - 1,
        )

    def memory(self, stage: GridStage) -> Iterable[Stage]:
        """Declare the arrays of a stage."""
        candidates, region = stage.grid.candidates, stage.grid.region
        return grid_stages(
            self.request, region, candidates, self.config, stage.target, refit=stage.number > 0
        )

    def enter(self, stage: GridStage, place: int, before: Workspace) -> None:
        """Start from random patches of the same weight, or bring field and matches to this grid."""
        grid, work = stage.grid, self.work
        self._open(stage)
        self.balance = Balance.at_first(self.config, stage.rounds)
        self.debt = None
        if self._before is None:
            work.adopt("match0", random_matches(grid, stage.stage))
            work.adopt("weight0", equal_weights(grid.active))
            self._cast(grid, trim=0)
            self._use_votes(stage, 0, histogram=True, last=False)
            return
        finer, region = stage.number == 0, grid.region
        fitted = (
            refine_field(
                before["field"], region.wraps, distances=self.distances, shape=region.shape
            )
            if finer
            else fit_to(before["field"], region.shape)
        )
        work.adopt("field", region.clip_to_bounds(fitted))
        carried = carry_matches(
            before["match0"], self._before, grid.candidates, grid.shape, factor=2 if finer else 1
        )
        work.adopt("match0", carried)

    def _open(self, stage: GridStage) -> None:
        """Hold the arrays of a stage that stay as they are."""
        target = stage.fractions
        guides = {} if target is None else {"wanted": target.wanted, "counted": target.counted}
        guides |= {} if stage.grid.guide is None else {"guide": stage.grid.guide}
        self.open_region("start", stage.grid.region, {"active0": stage.grid.active, **guides})

    def converges(self, stage: GridStage, number: int) -> bool:
        """Return whether the energy has settled."""
        assert self.balance is not None
        return bool(number and self.config.energetic and self.balance.feedback.is_over)

    def search(self, stage: GridStage, number: int) -> None:
        """Find a new match for every site, and what it weighs in the vote."""
        self.work.enter("search0")
        self.weigh_matches(stage.grid, self._find_matches(stage, number), self.config.robustness)

    def _find_matches(self, stage: GridStage, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Find a new match for every site, and their distances."""
        config, grid, match, field = (
            self.config,
            stage.grid,
            self.work["match0"],
            self.work["field"],
        )
        if config.search == "exact":
            features = features_of(grid, field)
            return exact_search(grid, match, features, index_penalty=config.index_penalty)
        return coherent_search(
            grid,
            match,
            field,
            stage=stage.stage,
            first=number * config.sweeps + 1,
            count=config.sweeps,
            tries=config.tries,
            index_penalty=config.index_penalty,
        )

    def vote(self, stage: GridStage, number: int) -> None:
        """Make the field that the matches vote for."""
        trim, last = stage.trims[number], number == stage.rounds - 1
        if self.config.energetic:
            last = self._cast_by_energy(stage.grid, trim) or last
        else:
            self._cast(stage.grid, trim)
        self._use_votes(
            stage, number, histogram=self.config.histogram, last=last and stage.target is None
        )

    def _cast(self, grid: Grid, trim: int) -> None:
        """Cast the votes of the weighed matches."""
        work = self.work
        work.enter("vote")
        work.adopt("votes", cast_votes(grid, work["match0"], work["weight0"], trim=trim))
        self.join_votes(grid.region)

    def _cast_by_energy(self, grid: Grid, trim: int) -> bool:
        """Cast the votes of equation (1); return whether the energy has settled."""
        work = self.work
        assert self.balance is not None
        work.enter("match")
        votes, self.balance = energy_vote(
            grid, work["field"], work["match0"], self.balance, self.config, trim=trim
        )
        work.adopt("votes", votes)
        work.release("field")
        self.join_votes(grid.region)
        return self.balance.feedback.is_over

    def _use_votes(self, stage: GridStage, number: int, *, histogram: bool, last: bool) -> None:
        """Make the votes a field with the histogram, or with the volume fractions that are
        required; keep the very last ones.
        """
        if stage.last and last:
            return
        work, region = self.work, stage.grid.region
        self.match_field(region, stage.grid.targets if histogram else None)
        if stage.fractions is not None:
            work.enter("shift")
            work.adopt("shifted", stage.fractions.shift_field(work["field"]))
            work.release("field")
            work.adopt("field", region.clip_to_bounds(work.take("shifted")))
        if stage.local is not None:
            # what the votes miss by themselves, so that the next ones have it
            stage.local.integrate(work["field"][0], low=-_FARTHEST, high=_FARTHEST)
            stage.local.add_to(work["field"][0])
            region.clip_to_bounds(work["field"])
            lead_guide(stage.grid, stage.local)
        if stage.struts is not None and stage.rounds - number <= _JOINED:
            work.enter("join components")
            join_components(work["field"], region, stage.struts)
        work.enter("rest")

    def correct(self, stage: GridStage, number: int) -> None:
        """Take steps on the two-point function of the free voxels."""
        target, region, work = stage.target, stage.grid.region, self.work
        if target is None:
            return
        settings: dict[str, Any] = {"periodic": region.wraps, "free": region.free}
        last = number == stage.rounds - 1
        # after the last one no later vote takes anything back
        over = stage.index == 0 and last
        self.debt = None if over else accumulate_debt(self.debt, work["field"], target, **settings)
        for step in range(stage.steps):
            work.enter("match")
            work.adopt("votes", two_point_step(work["field"], target, debt=self.debt, **settings))
            work.release("field")
            self._use_votes(stage, number, histogram=True, last=last and step == stage.steps - 1)

    def leave(self, stage: GridStage) -> None:
        """Report the energies; at the end settle the volume fractions."""
        assert self.balance is not None
        self._before = stage.grid.candidates
        if trace := self.balance.trace():
            self.energies.append(
                {"level": stage.index, "width": self._before.basis.width, "energy": trace}
            )
        if stage.last and stage.fractions is not None:
            work = self.work
            work.enter("settle")
            work.adopt("settled", settle_fractions(work["votes"], stage.fractions))
            work.release("votes")
            work.adopt("votes", work.take("settled"))

    def arrays(self, stage: GridStage, number: int) -> dict[str, np.ndarray]:
        """Return all that the next round starts from; nothing after the last one."""
        if "field" not in self.work or self.balance is None:
            return {}
        words = json.dumps([self.energies, asdict(self.balance)]).encode()
        arrays = {"match": self.work["match0"], "field": self.work["field"]}
        arrays["words"] = np.frombuffer(words, np.uint8)
        if stage.local is not None and stage.grid.guide is not None:
            arrays |= {"guide": stage.grid.guide, **stage.local.arrays()}
        return arrays if self.debt is None else {**arrays, "debt": self.debt}

    def restore(self, stage: GridStage, arrays: dict[str, np.ndarray]) -> None:
        """Take over the arrays of a checkpoint."""
        self.energies, balance = json.loads(bytes(arrays["words"]))
        self.balance = Balance.from_json(balance)
        self._open(stage)
        self.work.adopt("match0", arrays["match"])
        self.work.adopt("field", arrays["field"])
        self.debt = arrays.get("debt")
        if stage.local is not None and stage.grid.guide is not None:
            np.copyto(stage.grid.guide, arrays["guide"])
            stage.local.restore(arrays)


def make_from_patches(rounds: ExemplarRounds) -> tuple[np.ndarray, list[dict[str, Any]]]:
    """Return the last votes (C, Z, Y, X) int16 on the voxels that neighbourhoods cover, and the
    energies of rounds that follow them.
    """
    rounds.run()
    rounds.work.enter("deliver")
    return rounds.work.take("votes"), rounds.energies
