"""New material rather than moved pieces: what `novelty` above 0 does instead of search from random
patches.

The coarsest level is laid out by sliced rounds, which copy nothing; then a few rounds of search and
vote with narrow neighbourhoods make interfaces those of the exemplar. After each a step on the
two-point function keeps what narrow neighbourhoods forget, and a step on long waves keeps the
material as even as the exemplar. All of it on a torus, so that no place is special: an axis that is
not to repeat is cut to its length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine.checkpoint import Checkpoint, offer, resume
from trabecula.engine.parallel import thread_count
from trabecula.synth.shared.histogram import Histogram
from trabecula.synth.shared.matching.grid import Grid, random_matches, swept
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import refined, rematched, robust_weights, voted
from trabecula.synth.shared.matching.sources import Candidates, Stack
from trabecula.synth.shared.pyramid import fit_to
from trabecula.synth.shared.statistics import correlate
from trabecula.synth.shared.statistics.correlate import (
    Correlations,
    corrected,
    correlations_at,
    owed,
)
from trabecula.synth.shared.statistics.long_waves import (
    adjust_long_waves,
    adjusting_bytes,
    adjusting_slab_bytes,
    long_waves_of,
)
from trabecula.synth.shared.statistics.moved import round_bytes
from trabecula.synth.shared.statistics.sliced import sliced_round
from trabecula.synth.shared.statistics.slices import Slices, slices_of
from trabecula.synth.shared.votes import noise, votes_of
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
_LAYOUT, _PASS = "novel layout", "novel pass {}"  # stages of a run that can be interrupted
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
    """What the exemplars say of one level."""

    stack: Stack
    correlations: Correlations
    candidates: tuple[Candidates, ...]  # one per pass on this level


def passes(novelty: float, top: int) -> tuple[Pass, ...]:
    """The passes from the level that sliced rounds lay out to the finest one.

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
    """The level that sliced rounds lay out, for exemplars whose smallest side is this; 0: there is
    no room for one.
    """
    top = COARSEST
    while top and smallest // 2**top < LEAST:
        top -= 1
    return top


def has_room(shape: tuple[int, ...], top: int) -> bool:
    """Whether a result is large enough to be laid out on level `top`."""
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


def slices_for(fields: Sequence[np.ndarray]) -> Slices:
    """What the sliced rounds of the coarsest level aim at."""
    shortest = min(min(field.shape[1:]) for field in fields)
    fitting = [width for width in _SLICED_WIDTHS if shortest >= width + _ROOM]
    return slices_of(fields, width=fitting[0] if fitting else _SLICED_WIDTHS[-1])


def domain(
    shape: tuple[int, ...], periodic: tuple[bool, ...], level: int, top: int
) -> tuple[int, ...]:
    """Sides of the torus on a level: an open axis goes on to whole voxels of the coarsest level."""
    return tuple(
        -(-side // 2**level) if wraps else -(-side // 2**top) * 2 ** (top - level)
        for side, wraps in zip(shape, periodic, strict=True)
    )


def made_new(
    aims: Sequence[Aims],
    slices: Slices,
    schedule: Sequence[Pass],
    request: Request,
    config: TextureConfig,
) -> np.ndarray:
    """The last votes (C, Z, Y, X) int16 on the torus."""
    top = len(aims) - 1
    regions = [
        Region(domain(request.shape, request.periodic, level, top), _AROUND)
        for level in range(top + 1)
    ]
    unused = [iter(aim.candidates) for aim in aims]
    candidates = [next(unused[p.level]) for p in schedule]
    begin, state = _resumed(len(schedule))
    if state is None:
        run, level = _Run(_laid_out(aims[top], slices, regions[top], request.seed)), top
    else:
        run, level = _Run(**state.arrays), schedule[begin].level
    for number in range(begin, len(schedule)):
        p = schedule[number]
        while level > p.level:
            level -= 1
            run.field = fit_to(refined(run.field, _AROUND, distances=True), regions[level].shape)
        grid = Grid.over(regions[level], candidates[number])
        done = 0 if state is None else state.number
        state = None  # nor does anybody else hold on to what it was
        for round_ in track(range(done, p.rounds), f"level {level}", total=p.rounds - done):
            run.go_on(grid, p, number, round_, aims[level].correlations, request, config)
            last = number == len(schedule) - 1 and round_ == p.rounds - 1
            offer(_PASS.format(number), round_ + 1, **run.kept(last=last))
    return votes_of(run.field) if run.votes is None else run.votes


def step_bytes(correlations: Correlations, request: Request, top: int) -> int:
    """Memory of a step on the two-point function on the finest level, or on long waves, beside the
    field and its votes.
    """
    shape = domain(request.shape, request.periodic, 0, top)
    return max(correlate.step_bytes(shape, correlations, request.periodic), adjusting_bytes(shape))


def slab_bytes(correlations: Correlations, slices: Slices, request: Request, top: int) -> int:
    """Memory of what `made_new` does to the field where arrays lie in scratch files, beside search
    and vote.
    """
    shape = domain(request.shape, request.periodic, 0, top)
    adjusting = thread_count() * adjusting_slab_bytes(shape)
    return max(
        correlate.step_slab_bytes(shape, correlations, request.periodic),
        adjusting,
        round_bytes(slices),
    )


def _resumed(count: int) -> tuple[int, Checkpoint | None]:
    """The pass in which an interrupted run goes on, and its state; the first, and none."""
    for number in reversed(range(count)):
        state = resume(_PASS.format(number))
        if state is not None:
            return number, state
    return 0, None


def _laid_out(aims: Aims, slices: Slices, region: Region, seed: int) -> np.ndarray:
    """Sliced rounds from noise, with a step on the two-point function every few of them: (C, Z, Y,
    X) int8.
    """
    stage, histograms = key(seed, "novel/sliced"), aims.stack.histograms
    state = resume(_LAYOUT)
    if state is None:
        begin, votes = 0, noise((len(histograms), *region.shape), int(key(seed, "novel/noise")))
        votes = votes_of(rematched(region, votes, histograms))
    else:
        begin, votes = state.number, state.arrays.pop("votes")
    for number in track(range(begin, _SLICED_ROUNDS), "laying out", total=_SLICED_ROUNDS - begin):
        votes = sliced_round(votes, slices, key=stage, number=number, strength=_STRENGTH)
        if (number + 1) % _STEP_EVERY == 0:
            votes = corrected(
                rematched(region, votes, histograms), aims.correlations, periodic=_AROUND
            )
            _hold_waves(votes, aims.correlations, region, histograms)
            votes = votes_of(rematched(region, votes, histograms))
        offer(_LAYOUT, number + 1, votes=votes)
    return rematched(region, votes, None)  # a step was the last: these are votes of a field


def _hold_waves(
    votes: np.ndarray,
    target: Correlations,
    region: Region,
    histograms: tuple[Histogram, ...] | None,
) -> None:
    """Bring the long waves of votes to the exemplars', in place."""
    assert target.waves is not None  # `aims_of` learns them
    adjust_long_waves(votes, target.waves, lambda made: rematched(region, made, histograms))


@dataclass
class _Run:
    """Where the passes stand: a field (C, Z, Y, X) int8 and the votes that it came from, the match
    of every site, and what earlier rounds of the pass owe the two-point function."""

    field: np.ndarray
    match: np.ndarray | None = None
    votes: np.ndarray | None = None
    debt: np.ndarray | None = None

    def kept(self, *, last: bool) -> dict[str, np.ndarray]:
        """All that the next round starts from; after the last one the votes are the result."""
        parts = {
            "field": self.field,
            "match": self.match,
            "debt": self.debt,
            "votes": self.votes if last else None,
        }
        return {name: part for name, part in parts.items() if part is not None}

    def go_on(
        self,
        grid: Grid,
        p: Pass,
        number: int,
        round_: int,
        target: Correlations,
        request: Request,
        config: TextureConfig,
    ) -> None:
        """One round of pass `number`, which is `p`."""
        if round_ == 0:
            self.match, self.debt = (
                random_matches(grid, key(request.seed, f"novel/pass {number}")),
                None,
            )
        periodic = request.periodic
        self.votes = None  # every array that is not needed makes room before the next is made
        self._vote(grid, p, number, round_, request.seed, config)
        if p.beyond:
            self.debt = owed(self.debt, self.field, target, periodic=periodic)
        aim = self.debt
        if aim is not None and round_ == p.rounds - 1:
            aim = aim * p.beyond
        for step in range(p.steps):
            self.votes = None
            self.votes = corrected(self.field, target, debt=aim, periodic=periodic)
            if step == p.steps - 1:
                del self.field
                _hold_waves(self.votes, target, grid.region, grid.targets)
            self.field = rematched(grid.region, self.votes, grid.targets)

    def _vote(
        self, grid: Grid, p: Pass, number: int, round_: int, seed: int, config: TextureConfig
    ) -> None:
        """Search and vote."""
        assert self.match is not None  # the first round begins with some
        self.match, distance = swept(
            grid,
            self.match,
            self.field,
            stage=key(seed, f"novel/pass {number}"),
            first=100 * round_ + 1,
            count=config.sweeps * (_FIRST if round_ == 0 else 1),
            tries=config.tries,
            index_penalty=config.index_penalty,
        )
        del self.field
        weights = robust_weights(grid, distance, config.robustness)
        del distance
        votes = voted(grid, self.match, weights, trim=1 if p.level == 0 else 0)
        del weights
        self.field = rematched(grid.region, votes, grid.targets)
