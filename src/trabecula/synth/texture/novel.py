"""New material rather than moved pieces: what `novelty` above 0 does instead of search from random patches.

The coarsest level is laid out by sliced rounds, which copy nothing; then a few rounds of search and vote with narrow
neighbourhoods make interfaces those of the exemplar, and after each a step on the two-point function keeps what narrow
neighbourhoods forget. All of it on a torus, so that no place is special: an axis that is not to repeat is cut to its length.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.synth.shared.histogram import match_histogram
from trabecula.synth.shared.matching.grid import Grid, random_matches, swept
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import refined, rematched, robust_weights, voted
from trabecula.synth.shared.matching.sources import Candidates, Stack
from trabecula.synth.shared.pyramid import fit_to
from trabecula.synth.shared.statistics.correlate import Correlations, corrected, correlations_at, owed
from trabecula.synth.shared.statistics.pairs import Pairs
from trabecula.synth.shared.statistics.sliced import UNIT, Slices, sliced_round, slices_of
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

    `beyond` says how far the last round aims beyond the target, in what the rounds before fell short of it: the next pass
    takes some of that back. Nothing comes after the last pass, which is on target.
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

    Less than full novelty lets neighbourhoods of the exemplar into the layout, and then widens those of finer levels.
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
    """The level that sliced rounds lay out, for exemplars whose smallest side is this; 0: there is no room for one."""
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
    made = [
        Candidates.of(stack, width=p.width, step=p.step, variance=config.variance, most=config.components)
        for p in schedule
        if p.level == level
    ]
    return Aims(stack, correlations, tuple(made))


def slices_for(fields: Sequence[np.ndarray]) -> Slices:
    """What the sliced rounds of the coarsest level aim at."""
    shortest = min(min(field.shape[1:]) for field in fields)
    fitting = [width for width in _SLICED_WIDTHS if shortest >= width + _ROOM]
    return slices_of(fields, width=fitting[0] if fitting else _SLICED_WIDTHS[-1])


def domain(shape: tuple[int, ...], periodic: tuple[bool, ...], level: int, top: int) -> tuple[int, ...]:
    """Sides of the torus on a level: an open axis goes on to whole voxels of the coarsest level."""
    return tuple(
        -(-side // 2**level) if wraps else -(-side // 2**top) * 2 ** (top - level)
        for side, wraps in zip(shape, periodic, strict=True)
    )


def made_new(
    aims: Sequence[Aims], slices: Slices, schedule: Sequence[Pass], request: Request, config: TextureConfig
) -> np.ndarray:
    """The last votes (C, Z, Y, X) int16 on the torus."""
    top, seed, periodic = len(aims) - 1, request.seed, request.periodic
    sides = [domain(request.shape, periodic, level, top) for level in range(top + 1)]
    field = _laid_out(aims[top], slices, sides[top], seed)
    votes, level = field.astype(np.int16) * np.int16(UNIT), top
    unused = [list(aim.candidates) for aim in aims]
    for number, p in enumerate(schedule):
        while level > p.level:
            level -= 1
            field = fit_to(refined(field, _AROUND, distances=True), sides[level])
        grid = Grid.over(Region(sides[level], _AROUND), unused[level].pop(0))
        field, votes = _passed(grid, field, p, number, aims[level].correlations, periodic, seed, config)
    return votes


def step_bytes(correlations: Correlations, request: Request, top: int) -> int:
    """Memory of a step on the two-point function on the finest level: spectra and fields in float32."""
    sides = domain(request.shape, request.periodic, 0, top)
    pairs = Pairs(sides, correlations.r_max, request.periodic, correlations.edges)
    return 16 * int(np.prod(pairs.sides, dtype=np.int64)) + 20 * int(np.prod(sides, dtype=np.int64))


def _laid_out(aims: Aims, slices: Slices, shape: tuple[int, ...], seed: int) -> np.ndarray:
    """Sliced rounds from noise, with a step on the two-point function every few of them: (C, Z, Y, X) int8."""
    channels = len(aims.stack.field)

    def matched(votes: np.ndarray) -> np.ndarray:
        pairs = zip(votes, aims.stack.histograms, strict=True)
        return np.stack([match_histogram(vote, histogram) for vote, histogram in pairs])

    raw = np.random.Philox(key=int(key(seed, "novel/noise"))).random_raw(channels * int(np.prod(shape)))
    votes = ((raw >> np.uint64(50)).astype(np.int16) - np.int16(8192)).reshape(channels, *shape)
    field = matched(votes)
    votes = field.astype(np.int16) * np.int16(UNIT)
    stage = key(seed, "novel/sliced")
    for number in track(range(_SLICED_ROUNDS), "laying out"):
        votes = sliced_round(votes, slices, key=stage, number=number, strength=_STRENGTH)
        if (number + 1) % _STEP_EVERY == 0:
            votes = corrected(matched(votes), aims.correlations, periodic=_AROUND)
            field = matched(votes)
            votes = field.astype(np.int16) * np.int16(UNIT)
    return field


def _passed(
    grid: Grid,
    field: np.ndarray,
    p: Pass,
    number: int,
    target: Correlations,
    periodic: tuple[bool, ...],
    seed: int,
    config: TextureConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """One pass: the field, and the votes that it came from."""
    stage = key(seed, f"novel/pass {number}")
    match, debt = random_matches(grid, stage), None
    for round_ in track(range(p.rounds), f"level {p.level}"):
        count = config.sweeps * (_FIRST if round_ == 0 else 1)
        match, distance = swept(
            grid,
            match,
            field,
            stage=stage,
            first=100 * round_ + 1,
            count=count,
            tries=config.tries,
            index_penalty=config.index_penalty,
        )
        weights = robust_weights(grid, distance, config.robustness)
        votes = voted(grid, match, weights, trim=1 if p.level == 0 else 0)
        field = rematched(grid.region, votes, grid.targets)
        if p.beyond:
            debt = owed(debt, field, target, periodic=periodic)
        aim = debt * p.beyond if debt is not None and round_ == p.rounds - 1 else debt
        for _ in range(p.steps):
            votes = corrected(field, target, debt=aim, periodic=periodic)
            field = rematched(grid.region, votes, grid.targets)
    return field, votes
