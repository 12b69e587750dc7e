"""New material rather than moved patches: the way of `novelty` above 0, instead of search from
random patches.

The coarsest level is laid out by sliced rounds, which copy nothing; then a few rounds of search and
vote with narrow neighbourhoods make interfaces those of the exemplar. After each a step on the
two-point function keeps what narrow neighbourhoods lose, and a step on long waves keeps the
material as even as the exemplar. All of it on a torus, so that no place is special: an axis that is
not to repeat is cut to its length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine.parallel import thread_count
from trabecula.synth.shared.coarse_to_fine import CoarseToFine, RoundStage
from trabecula.synth.shared.content.fields import noise, votes_of
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.matching.grid import Grid, coherent_search, random_matches
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import (
    cast_votes,
    match_votes,
    refine_field,
    robust_weights,
)
from trabecula.synth.shared.matching.sources import Candidates, Stack
from trabecula.synth.shared.pyramid import fit_to
from trabecula.synth.shared.statistics import two_point_steps
from trabecula.synth.shared.statistics.long_waves import (
    adjust_long_waves,
    adjusting_bytes,
    adjusting_slab_bytes,
    long_waves_of,
)
from trabecula.synth.shared.statistics.sliced import round_bytes, transport_neighbourhoods
from trabecula.synth.shared.statistics.slices import SliceTarget, slice_target
from trabecula.synth.shared.statistics.two_point import Correlations, correlations_at
from trabecula.synth.shared.statistics.two_point_steps import accumulate_debt, two_point_step
from trabecula.synth.texture.config import TextureConfig

COARSEST = 2
"""The level that sliced rounds lay out, at most: 4 times coarser than the result."""

LEAST = 8
"""Voxels that the exemplar and the result need on that level along every axis."""

WIDTH = 6
"""Of the neighbourhoods of the passes, voxels: they keep interfaces and forget where these led."""

_AROUND = (True, True, True)
_SLICED_WIDTHS = (6, 4)  # of the neighbourhoods of sliced rounds: the first for which there is room
_ROOM = 4
_STRENGTH = 2.5
_SLICED_ROUNDS, _STEP_EVERY = 30, 5
_MOVED = 16  # rounds on the coarsest level at hardly any novelty
_WIDE_FROM = 5  # so many of them let finer levels have wide neighbourhoods
_FIRST = 3  # times as many sweeps in the first round, which starts from random matches


@dataclass(frozen=True)
class Pass:
    """Rounds of search and vote on one level, each followed by `steps` on the two-point function.

    `beyond` says how far the last round aims beyond the target, in what the rounds before fell
    short of it: the next pass takes some of that back. Nothing comes after the last pass, which is
    on target.
    """

    level: int
    width: int
    step: int
    rounds: int
    steps: int
    beyond: float = 1.0


@dataclass(frozen=True)
class Aims:
    """Targets of one level, learnt from the exemplars."""

    stack: Stack
    correlations: Correlations
    candidates: tuple[Candidates, ...]  # one per pass on this level


def passes(novelty: float, top: int) -> tuple[Pass, ...]:
    """List the passes from the level that sliced rounds lay out to the finest one.

    Less than full novelty lets neighbourhoods of the exemplar into the layout, and then widens
    those of finer levels.
    """
    moved = round(_MOVED * (1 - novelty))
    wide = moved >= _WIDE_FROM
    schedule = (
        Pass(2, 8, 1, moved, 2),
        Pass(1, 8 if wide else WIDTH, 1, 4, 4),
        Pass(0, WIDTH if wide else 5, 2, 2, 2, beyond=1.7),
        Pass(0, WIDTH, 2, 1, 1, beyond=0.0),
    )
    return tuple(p for p in schedule if p.rounds and (p.level < top or p.level == COARSEST == top))


def top_for(smallest: int) -> int:
    """Return the level that sliced rounds lay out, for exemplars whose smallest side is this; 0:
    there is no room for one.
    """
    top = COARSEST
    while top and smallest // 2**top < LEAST:
        top -= 1
    return top


def has_room(shape: tuple[int, ...], top: int) -> bool:
    """Return whether a result is large enough to be laid out on level `top`."""
    return min(shape) >= LEAST * 2**top


def aims_of(
    stack: Stack,
    fields: Sequence[np.ndarray],
    level: int,
    edges: tuple[float, ...],
    schedule: Sequence[Pass],
    config: TextureConfig,
) -> Aims:
    """Learn one level; `fields` are the exemplars themselves in int8, without turned copies."""
    correlations = correlations_at(fields, level, edges=edges, clip=config.clip)
    waves = long_waves_of(fields, level, softness=correlations.softness)
    correlations = replace(correlations, waves=waves)
    made = [
        Candidates.of(
            stack, width=p.width, step=p.step, variance=config.variance, most=config.components
        )
        for p in schedule
        if p.level == level
    ]
    return Aims(stack, correlations, tuple(made))


def slices_for(fields: Sequence[np.ndarray]) -> SliceTarget:
    """Describe the target of the sliced rounds of the coarsest level."""
    shortest = min(min(field.shape[1:]) for field in fields)
    fitting = [width for width in _SLICED_WIDTHS if shortest >= width + _ROOM]
    return slice_target(fields, width=fitting[0] if fitting else _SLICED_WIDTHS[-1])


def torus_shape(
    shape: tuple[int, ...], periodic: tuple[bool, ...], level: int, top: int
) -> tuple[int, ...]:
    """Return the sides of the torus on a level: an open axis is continued to whole voxels of the
    coarsest level.
    """
    return tuple(
        -(-side // 2**level) if wraps else -(-side // 2**top) * 2 ** (top - level)
        for side, wraps in zip(shape, periodic, strict=True)
    )


@dataclass(frozen=True)
class NovelLayoutStage(RoundStage):
    """Sliced rounds on the coarsest level."""

    aims: Aims
    region: Region


@dataclass(frozen=True)
class PassStage(RoundStage):
    """The rounds of one pass.

    Attributes
    ----------
    part : Pass
    grid : Grid
    target : Correlations
    stage : uint64
        Key of its random numbers.
    last : bool
        Whether no pass follows.
    """

    part: Pass
    grid: Grid
    target: Correlations
    stage: np.uint64
    last: bool


class NovelRounds(CoarseToFine[Any]):
    """A run from noise, on the torus.

    Attributes
    ----------
    field : (C, Z, Y, X) int8
        None while votes are cast, and during the layout.
    votes : (C, Z, Y, X) int16
        Source of the field; during the layout the state itself.
    match : (sz, sy, sx) int32
        The candidate of every site.
    weights : (sz, sy, sx) int32
        Of the next vote; None between rounds.
    debt : (C, bins)
        Misfit of the two-point function that the next steps make up for.
    """

    def __init__(
        self,
        aims: Sequence[Aims],
        slices: SliceTarget,
        schedule: Sequence[Pass],
        request: Request,
        config: TextureConfig,
    ) -> None:
        self.aims, self.slices = aims, slices
        self.schedule = schedule
        self.request, self.config = request, config
        self.top = len(aims) - 1
        self.regions = [
            Region(torus_shape(request.shape, request.periodic, level, self.top), _AROUND)
            for level in range(self.top + 1)
        ]
        unused = [iter(aim.candidates) for aim in aims]
        self.candidates = [next(unused[part.level]) for part in schedule]
        self.field: np.ndarray | None = None
        self.votes: np.ndarray | None = None
        self.match: np.ndarray | None = None
        self.weights: np.ndarray | None = None
        self.debt: np.ndarray | None = None

    @property
    def names(self) -> list[str]:
        """List the names of the layout and of the passes."""
        return ["novel layout", *(f"novel pass {number}" for number in range(len(self.schedule)))]

    def open_stage(self, place: int) -> NovelLayoutStage | PassStage:
        """Prepare the layout, or the grid of a pass."""
        name, number = self.names[place], place - 1
        if place == 0:
            return NovelLayoutStage(
                name, "laying out", _SLICED_ROUNDS, self.aims[self.top], self.regions[self.top]
            )
        part = self.schedule[number]
        return PassStage(
            name,
            f"level {part.level}",
            part.rounds,
            part,
            Grid.over(self.regions[part.level], self.candidates[number]),
            self.aims[part.level].correlations,
            key(self.request.seed, f"novel/pass {number}"),
            number == len(self.schedule) - 1,
        )

    def enter(self, stage: NovelLayoutStage | PassStage, place: int) -> None:
        """Start from noise, or refine the field and start from random matches."""
        if isinstance(stage, NovelLayoutStage):
            shape = (len(stage.aims.stack.histograms), *stage.region.shape)
            votes = noise(shape, int(key(self.request.seed, "novel/noise")))
            self.votes = votes_of(match_votes(stage.region, votes, stage.aims.stack.histograms))
            return
        self.match = self.debt = None
        level = self.top if place == 1 else self.schedule[place - 2].level
        for finer in range(level - 1, stage.part.level - 1, -1):
            assert self.field is not None  # the stage before leaves it
            self.field = fit_to(
                refine_field(self.field, _AROUND, distances=True), self.regions[finer].shape
            )
        self.match = random_matches(stage.grid, stage.stage)

    def round(self, stage: NovelLayoutStage | PassStage, number: int) -> None:
        """Do a sliced round of the layout, or a round of a pass."""
        if isinstance(stage, NovelLayoutStage):
            self._lay_out(stage, number)
        else:
            super().round(stage, number)

    def _lay_out(self, stage: NovelLayoutStage, number: int) -> None:
        """Do a sliced round, and a step on the two-point function after every few of them."""
        assert self.votes is not None
        region, histograms = stage.region, stage.aims.stack.histograms
        self.votes = transport_neighbourhoods(
            self.votes,
            self.slices,
            key=key(self.request.seed, "novel/sliced"),
            number=number,
            strength=_STRENGTH,
        )
        if (number + 1) % _STEP_EVERY == 0:
            target = stage.aims.correlations
            self.votes = two_point_step(
                match_votes(region, self.votes, histograms), target, periodic=_AROUND
            )
            _hold_waves(self.votes, target, region, histograms)
            self.votes = votes_of(match_votes(region, self.votes, histograms))

    def leave(self, stage: NovelLayoutStage | PassStage) -> None:
        """Make the field of the layout: a step was the last, so its votes are those of a field."""
        if isinstance(stage, NovelLayoutStage):
            assert self.votes is not None
            self.field, self.votes = match_votes(stage.region, self.votes, None), None

    def search(self, stage: PassStage, number: int) -> None:
        """Find a new match for every site, and what it weighs in the vote."""
        config = self.config
        assert self.match is not None and self.field is not None
        self.votes = None  # every array that is not needed makes room for the next
        self.match, distance = coherent_search(
            stage.grid,
            self.match,
            self.field,
            stage=stage.stage,
            first=100 * number + 1,
            count=config.sweeps * (_FIRST if number == 0 else 1),
            tries=config.tries,
            index_penalty=config.index_penalty,
        )
        self.field = None
        self.weights = robust_weights(stage.grid, distance, config.robustness)

    def vote(self, stage: PassStage, number: int) -> None:
        """Make the field that the matches vote for."""
        assert self.match is not None and self.weights is not None
        grid = stage.grid
        votes = cast_votes(grid, self.match, self.weights, trim=1 if stage.part.level == 0 else 0)
        self.weights = None
        self.field = match_votes(grid.region, votes, grid.targets)

    def correct(self, stage: PassStage, number: int) -> None:
        """Take steps on the two-point function, the last with one on long waves."""
        assert self.field is not None
        part, grid = stage.part, stage.grid
        periodic = self.request.periodic
        if part.beyond:
            self.debt = accumulate_debt(self.debt, self.field, stage.target, periodic=periodic)
        aim = self.debt
        if aim is not None and number == part.rounds - 1:
            aim = aim * part.beyond
        for step in range(part.steps):
            self.votes = None
            self.votes = two_point_step(self.field, stage.target, debt=aim, periodic=periodic)
            if step == part.steps - 1:
                self.field = None
                _hold_waves(self.votes, stage.target, grid.region, grid.targets)
            self.field = match_votes(grid.region, self.votes, grid.targets)

    def arrays(self, stage: NovelLayoutStage | PassStage, number: int) -> dict[str, np.ndarray]:
        """Return all that the next round starts from; after the last one the votes as well."""
        if isinstance(stage, NovelLayoutStage):
            assert self.votes is not None
            return {"votes": self.votes}
        parts = {
            "field": self.field,
            "match": self.match,
            "debt": self.debt,
            "votes": self.votes if stage.last and number == stage.rounds - 1 else None,
        }
        return {name: part for name, part in parts.items() if part is not None}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Take over the arrays of a checkpoint."""
        for name, array in arrays.items():
            setattr(self, name, array)


def make_novel(
    aims: Sequence[Aims],
    slices: SliceTarget,
    schedule: Sequence[Pass],
    request: Request,
    config: TextureConfig,
) -> np.ndarray:
    """Return the last votes (C, Z, Y, X) int16 on the torus."""
    rounds = NovelRounds(aims, slices, schedule, request, config)
    rounds.run()
    if rounds.votes is not None:
        return rounds.votes
    assert rounds.field is not None
    return votes_of(rounds.field)


def step_bytes(correlations: Correlations, request: Request, top: int) -> int:
    """Forecast the memory of a step on the two-point function on the finest level, or on long
    waves, beside the field and its votes.
    """
    shape = torus_shape(request.shape, request.periodic, 0, top)
    return max(
        two_point_steps.step_bytes(shape, correlations, request.periodic), adjusting_bytes(shape)
    )


def slab_bytes(correlations: Correlations, slices: SliceTarget, request: Request, top: int) -> int:
    """Forecast the memory of `make_novel` where arrays are memory-mapped, beside search
    and vote.
    """
    shape = torus_shape(request.shape, request.periodic, 0, top)
    adjusting = thread_count() * adjusting_slab_bytes(shape)
    return max(
        two_point_steps.step_slab_bytes(shape, correlations, request.periodic),
        adjusting,
        round_bytes(slices),
    )


def _hold_waves(
    votes: np.ndarray,
    target: Correlations,
    region: Region,
    histograms: tuple[Histogram, ...] | None,
) -> None:
    """Bring the long waves of votes to the exemplars', in place."""
    assert target.waves is not None  # `aims_of` learns them
    adjust_long_waves(votes, target.waves, lambda made: match_votes(region, made, histograms))
