"""Rounds of search and vote on one grid after another, and what a run that is interrupted leaves of
them.

A round starts from a match of every site and from the field that their votes made; the votes
themselves are needed only at the end, so that they are made into the field and forgotten, and of
the very last ones no field is made.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine.checkpoint import Checkpoint as Left
from trabecula.engine.checkpoint import due, offer, resumed
from trabecula.synth.shared.matching.grid import (
    Grid,
    coherent_search,
    exact_search,
    features_of,
    random_matches,
)
from trabecula.synth.shared.matching.principal_components import (
    grain_of,
    variance_in,
)
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import (
    cast_votes,
    join_to_known,
    match_votes,
    refine_field,
    robust_weights,
)
from trabecula.synth.shared.matching.sources import Candidates, Stack, carry_matches
from trabecula.synth.shared.pyramid import fit_to
from trabecula.synth.shared.slabs import (
    make_by_slabs,
)
from trabecula.synth.shared.statistics.two_point import (
    Correlations,
)
from trabecula.synth.shared.statistics.two_point_steps import (
    accumulate_debt,
    two_point_step,
)
from trabecula.synth.texture.config import TextureConfig
from trabecula.synth.texture.energy import Energy, Feedback
from trabecula.synth.texture.energy_rounds import Balance, energy_vote
from trabecula.synth.texture.graded import (
    FractionTarget,
    guide_grid,
    settle_fractions,
)


@dataclass(frozen=True)
class Course:
    """What the rounds on one grid go by.

    Attributes
    ----------
    name, said : str
        Among the stages of a run that can be resumed, and for who follows its progress.
    stage : int
        Key of its random numbers.
    trims : sequence of int
        One a round: voxels at the rim of a neighbourhood that do not vote.
    target, steps
        The two-point functions to step towards after every round, and how often.
    leaning : Leaning, optional
        Shares of the phase that are asked for around every voxel.
    finest, last : bool
        Whether it is on the finest level, and whether nothing comes after it.
    """

    name: str
    said: str
    grid: Grid
    stage: np.uint64
    trims: Sequence[int]
    target: Correlations | None
    steps: int
    leaning: FractionTarget | None
    finest: bool
    last: bool


@dataclass
class Run:
    """Where a run stands.

    Attributes
    ----------
    match : (sz, sy, sx) int32
        The candidate that each site is matched with.
    field : (C, Z, Y, X) int8
        What their votes made; None once nothing comes after them.
    votes : (C, Z, Y, X) int16
        The last ones, 256 times the weighted mean of what overlaps; None before.
    debt : (C, K), optional
        What the rounds so far owe the two-point functions.
    balance : Balance, optional
        Where rounds go by the energy.
    told : list of dict
        The energies of the grids that are done.
    """

    match: np.ndarray | None = None
    field: np.ndarray | None = None
    votes: np.ndarray | None = None
    debt: np.ndarray | None = None
    balance: Balance | None = None
    told: list[dict[str, Any]] = dataclasses.field(default_factory=list)

    @classmethod
    def resumed(cls, left: dict[str, np.ndarray]) -> Run:
        """From the arrays that an interrupted run offered, which are given up here."""
        told, balance = json.loads(bytes(left.pop("words")))
        return cls(**left, told=told, balance=_balance_of(balance))

    def start(self, course: Course) -> None:
        """Random patches, each of the same weight."""
        grid = course.grid
        self.match = random_matches(grid, course.stage)
        weights = make_by_slabs(lambda start, stop: grid.active[start:stop], grid.shape, np.int32)
        votes = join_to_known(grid.region, cast_votes(grid, self.match, weights))
        del weights
        self._make(course, votes, histogram=True, last=False)

    def go_over(self, course: Course, before: Candidates, *, finer: bool, distances: bool) -> None:
        """To the next grid: the field doubled (a distance doubles too), the matches moved along."""
        assert self.field is not None  # a course that is not the last leaves it
        grid, region, wraps = course.grid, course.grid.region, course.grid.region.wraps
        old, self.field = self.field, None
        shape = region.shape
        fitted = (
            refine_field(old, wraps, distances=distances, shape=shape)
            if finer
            else fit_to(old, shape)
        )
        del old
        self.field = region.clip_to_bounds(fitted)
        self.match = carry_matches(
            self._matched, before, grid.candidates, grid.shape, factor=2 if finer else 1
        )
        self.debt = self.balance = None

    def go_on(self, course: Course, config: TextureConfig, done: int = 0) -> None:
        """All rounds on a grid, of which some may have been done already."""
        count = len(course.trims)
        if self.balance is None:
            self.balance = Balance.at_first(config, count)
        for number in track(range(done, count), course.said, total=count - done):
            if number and config.energetic and self.balance.feedback.done:
                break
            self._round(course, config, number)
            if due() and self.field is not None:
                offer(course.name, number + 1, **self._kept())

    def tell(self, where: Mapping[str, Any]) -> None:
        """Keep the energies of a grid that is done."""
        assert self.balance is not None
        trace = self.balance.trace()
        self.told += [{**where, "energy": trace}] if trace else []

    def _round(self, course: Course, config: TextureConfig, number: int) -> None:
        assert self.field is not None and self.balance is not None
        grid, last, trim = course.grid, number == len(course.trims) - 1, course.trims[number]
        if config.energetic:
            self._search(course, config, number)
            votes, self.balance = energy_vote(
                grid, self.field, self._matched, self.balance, config, trim=trim
            )
            last = last or self.balance.feedback.done
        else:
            weights = robust_weights(grid, self._search(course, config, number), config.robustness)
            self.field = None
            votes = cast_votes(grid, self._matched, weights, trim=trim)
            del weights
        self.field = None
        votes = join_to_known(grid.region, votes)
        steps = course.steps if course.target is not None and not config.energetic else 0
        self._make(course, votes, histogram=config.histogram, last=last and not steps)
        del votes
        if steps:
            self._correct(course, last=last)

    @property
    def _matched(self) -> np.ndarray:
        assert self.match is not None  # from the start on
        return self.match

    def _search(self, course: Course, config: TextureConfig, number: int) -> np.ndarray:
        """A new match for every site, and its distance."""
        assert self.field is not None
        if config.search == "exact":
            features = features_of(course.grid, self.field)
            self.match, distance = exact_search(
                course.grid, self._matched, features, index_penalty=config.index_penalty
            )
            return distance
        self.match, distance = coherent_search(
            course.grid,
            self._matched,
            self.field,
            stage=course.stage,
            first=number * config.sweeps + 1,
            count=config.sweeps,
            tries=config.tries,
            index_penalty=config.index_penalty,
        )
        return distance

    def _make(self, course: Course, votes: np.ndarray, *, histogram: bool, last: bool) -> None:
        """Votes as a field with the histogram, or with the shares that are asked for; the very last
        ones are what is left.
        """
        if course.last and last:
            self.votes = votes
            return
        region = course.grid.region
        made = match_votes(region, votes, course.grid.targets if histogram else None)
        del votes
        self.field = (
            made
            if course.leaning is None
            else region.clip_to_bounds(course.leaning.shift_field(made))
        )

    def _correct(self, course: Course, *, last: bool) -> None:
        """Steps on the two-point function, of the voxels that are made."""
        assert course.target is not None and self.field is not None
        region, target = course.grid.region, course.target
        self.debt = (
            None  # nothing comes after it that would take something back
            if course.finest and last
            else accumulate_debt(
                self.debt, self.field, target, periodic=region.wraps, free=region.free
            )
        )
        for step in range(course.steps):
            before, self.field = self.field, None
            assert before is not None  # the step before was not the last
            votes = two_point_step(
                before, target, debt=self.debt, periodic=region.wraps, free=region.free
            )
            del before
            self._make(course, votes, histogram=True, last=last and step == course.steps - 1)

    def _kept(self) -> dict[str, np.ndarray]:
        """All that the next round starts from."""
        assert self.field is not None and self.balance is not None
        words = json.dumps([self.told, asdict(self.balance)]).encode()
        kept = {
            "match": self._matched,
            "field": self.field,
            "words": np.frombuffer(words, np.uint8),
        }
        return kept if self.debt is None else {**kept, "debt": self.debt}


def _balance_of(kept: Mapping[str, Any]) -> Balance:
    """From plain JSON."""
    feedback = kept["feedback"]
    trace = tuple(Energy(**energy) for energy in feedback["trace"])
    return Balance(Feedback(**{**feedback, "trace": trace}), kept["reference"])


# a coarsest level at less than this scale is too large for neighbourhoods at every voxel
_SPARSE_BELOW = 4


Level = tuple[Candidates, ...]
"""The exemplars' neighbourhoods at one resolution, one entry per width of the config."""


def level_of(stack: Stack, index: int, config: TextureConfig, *, distances: bool) -> Level:
    """Learn one level; `distances` says whether its field is smooth."""
    made = []
    for width in config.neighbourhood:
        grain = grain_of(width, smooth=index == 0 and distances)
        made.append(
            Candidates.of(
                stack,
                width=width,
                step=config.step_of(width),
                variance=variance_in(grain, config.variance),
                most=config.components,
                grain=grain,
                k=config.nearest,
            )
        )
    return tuple(made)


@dataclass(frozen=True)
class Job:
    """What is to be made of what.

    Levels and regions are as many, finest first, as are `targets` where `corrections` of the config
    step towards them, and `shares` where the request asks for a phase here more and there less
    (`grading`). `distances` says that fields are smooth.
    """

    levels: Sequence[Level]
    regions: Sequence[Region]
    request: Request
    config: TextureConfig
    distances: bool
    targets: Sequence[Correlations] = ()
    shares: Sequence[np.ndarray] = ()

    def stages(self) -> list[tuple[int, int]]:
        """Level and place of the width of every grid, in the order in which they are gone over."""
        return [
            (index, n)
            for index in reversed(range(len(self.regions)))
            for n in range(len(self.levels[index]))
        ]

    def course(self, index: int, number: int) -> Course:
        """What the rounds on one grid go by."""
        config, used = self.config, len(self.regions)
        candidates, first = self.levels[index][number], index == used - 1
        if first and 2**index >= _SPARSE_BELOW and config.step:
            candidates = replace(candidates, step=1)
        grid, leaning = Grid.over(self.regions[index], candidates), None
        if self.shares:
            grid, leaning = guide_grid(grid, self.shares[index], index)
        rounds = config.first_rounds if first else config.rounds[min(index, len(config.rounds) - 1)]
        even = self.request.fixed is None and not self.shares
        target = self.targets[index] if index < len(self.targets) and even else None
        return Course(
            name=_name(index, number),
            said=f"level {used - index} of {used}",
            grid=grid,
            stage=key(self.request.seed, f"texture/{index}" + (f"/{number}" if number else "")),
            trims=_trims(grid, rounds, config, distances=self.distances)
            if index == 0
            else [0] * rounds,
            target=target,
            steps=config.corrections[min(index, len(config.corrections) - 1)] if target else 0,
            leaning=leaning,
            finest=index == 0,
            last=(index, number) == self.stages()[-1],
        )


def make_from_patches(job: Job) -> tuple[np.ndarray, list[dict[str, Any]]]:
    """The last votes (C, Z, Y, X) int16 on what neighbourhoods cover, and the energies where rounds
    go by them.
    """
    stages = job.stages()
    begin, left = _resumed(stages)
    run = Run() if left is None else Run.resumed(left.arrays)
    before: Candidates | None = None
    for index, number in stages[begin:]:
        course = job.course(index, number)
        done = 0 if left is None else left.number
        if left is None and before is None:
            run.start(course)
        elif left is None and before is not None:
            run.go_over(course, before, finer=number == 0, distances=job.distances)
        left = None  # nor does anybody else hold on to its arrays
        run.go_on(course, job.config, done)
        before = course.grid.candidates
        run.tell({"level": index, "width": before.basis.width})
    assert run.votes is not None  # the last course leaves them
    return run.votes if course.leaning is None else settle_fractions(
        run.votes, course.leaning
    ), run.told


def _name(index: int, number: int) -> str:
    """Of a level and the place of a width, among the stages that an interrupted run can go on from."""
    return f"level {index} width {number}"


def _resumed(stages: Sequence[tuple[int, int]]) -> tuple[int, Left | None]:
    """The stage in which an interrupted run goes on, and its state; the first, and none."""
    for place in reversed(range(len(stages))):
        left = resumed(_name(*stages[place]))
        if left is not None:
            return place, left
    return 0, None


def _trims(grid: Grid, rounds: int, config: TextureConfig, *, distances: bool) -> list[int]:
    """How much of a neighbourhood's rim does not vote, round by round of the finest level."""
    trims = [config.trim] * rounds
    if not distances and config.field != "indicator" and not config.energetic:
        # A mean of grey values loses their grain: in the end every voxel takes one neighbourhood's.
        trims[-2:] = [(grid.candidates.basis.width - grid.candidates.step) // 2] * len(trims[-2:])
    return trims
