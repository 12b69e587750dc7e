"""Search and vote from random patches to the finest level: the paper's way, and `novelty` 0."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.synth.shared.matching.grid import Grid, features_of, nearest_matches, random_matches, swept
from trabecula.synth.shared.matching.levels import grain_of, variance_in
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import joined_votes, refined, rematched, robust_weights, voted
from trabecula.synth.shared.matching.sources import Candidates, Stack, carried
from trabecula.synth.shared.pyramid import fit_to
from trabecula.synth.shared.statistics.correlate import Correlations, corrected, owed
from trabecula.synth.texture.balance import Balance, balanced
from trabecula.synth.texture.config import TextureConfig
from trabecula.synth.texture.grading import Leaning, leaning_grid, settled

_SPARSE_BELOW = 4  # a coarsest level at less than this scale is too large for neighbourhoods at every voxel

Level = tuple[Candidates, ...]
"""The exemplars' neighbourhoods at one resolution, one entry per width of the config."""


@dataclass(frozen=True)
class State:
    """The output at one resolution."""

    match: np.ndarray  # (sz, sy, sx) int32, index of the nearest neighbourhood per site
    votes: np.ndarray  # (C, Z, Y, X) int16, the weighted mean of what overlaps, times 256
    field: np.ndarray  # (C, Z, Y, X) int8, the same with the exemplar's histogram


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


def made_plain(
    levels: Sequence[Level],
    regions: Sequence[Region],
    request: Request,
    config: TextureConfig,
    targets: Sequence[Correlations] = (),
    *,
    distances: bool,
    shares: Sequence[np.ndarray] = (),
) -> tuple[np.ndarray, list[dict[str, Any]]]:
    """The last votes (C, Z, Y, X) int16 on what neighbourhoods cover, and the energies where rounds go by them.

    Levels and regions are as many, finest first, as are `targets` where `corrections` of the config step towards them, and
    `shares` where the request asks for a phase here more and there less (`grading`).
    """
    state: State | None = None
    before: Candidates | None = None
    told: list[dict[str, Any]] = []
    used = len(regions)
    for index in reversed(range(used)):
        first = index == used - 1
        for number, candidates in enumerate(levels[index]):
            if first and 2**index >= _SPARSE_BELOW and config.step:
                candidates = replace(candidates, step=1)
            leaning = None
            grid = Grid.over(regions[index], candidates)
            if shares:
                grid, leaning = leaning_grid(grid, shares[index], index)
            stage = key(request.seed, f"texture/{index}" + (f"/{number}" if number else ""))
            if state is None or before is None:
                begin = partial(_started, grid, stage, leaning)
            else:
                begin = partial(_continued, grid, before, state, finer=number == 0, distances=distances)
            rounds = config.first_rounds if first else config.rounds[min(index, len(config.rounds) - 1)]
            trims = _trims(grid, rounds, config, distances=distances) if index == 0 else [0] * rounds
            even = request.fixed is None and not shares
            target = targets[index] if index < len(targets) and even else None
            steps = config.corrections[min(index, len(config.corrections) - 1)] if target else 0
            said = f"level {used - index} of {used}"
            state, trace = _optimised(
                grid, begin, stage, trims, config, target, steps, leaning, finest=index == 0, said=said
            )
            told += [{"level": index, "width": candidates.basis.width, "energy": trace}] if trace else []
            before = candidates
    assert state is not None  # there is at least one level
    return state.votes if leaning is None else settled(state.votes, leaning), told


def _cast(
    grid: Grid,
    match: np.ndarray,
    weights: np.ndarray,
    leaning: Leaning | None,
    *,
    trim: int = 0,
    histogram: bool = True,
) -> State:
    """Vote and match the histogram: the matches become a field."""
    votes = joined_votes(grid.region, voted(grid, match, weights, trim=trim))
    return State(match, votes, _field_of(grid, votes, leaning, histogram=histogram))


def _field_of(grid: Grid, votes: np.ndarray, leaning: Leaning | None, *, histogram: bool) -> np.ndarray:
    """With the histogram, or with the shares that are asked for."""
    field = rematched(grid.region, votes, grid.targets if histogram else None)
    return field if leaning is None else grid.region.bounded(leaning.leaned(field))


def _started(grid: Grid, stage: np.uint64, leaning: Leaning | None) -> State:
    """Random patches."""
    return _cast(grid, random_matches(grid, stage), grid.active.astype(np.int32), leaning)


def _continued(grid: Grid, before: Candidates, state: State, *, finer: bool, distances: bool) -> State:
    """The result so far on the next grid: its field doubled (a distance doubles too), its matches moved along."""
    field, region = state.field, grid.region
    if finer:
        field = refined(field, region.wraps, distances=distances)
    field = region.bounded(fit_to(field, region.shape))
    match = carried(state.match, before, grid.candidates, grid.shape, factor=2 if finer else 1)
    return State(match, field.astype(np.int16) * 256, field)


def _trims(grid: Grid, rounds: int, config: TextureConfig, *, distances: bool) -> list[int]:
    """How much of a neighbourhood's rim does not vote, round by round of the finest level."""
    trims = [config.trim] * rounds
    if not distances and config.field != "indicator" and not config.energetic:
        # A mean of grey values loses their grain: in the end every voxel takes one neighbourhood's.
        trims[-2:] = [(grid.candidates.basis.width - grid.candidates.step) // 2] * len(trims[-2:])
    return trims


def _optimised(
    grid: Grid,
    begin: Callable[[], State],
    stage: np.uint64,
    trims: Sequence[int],
    config: TextureConfig,
    target: Correlations | None,
    steps: int,
    leaning: Leaning | None,
    *,
    finest: bool,
    said: str,
) -> tuple[State, list[dict[str, Any]]]:
    balance = Balance.at_first(config, len(trims))
    state, debt = begin(), None  # here, so that nobody else holds on to it
    for number in track(range(len(trims)), said):
        match, distance = _matched(grid, state, stage, number, config)
        if config.energetic:
            votes, balance = balanced(grid, state.field, match, balance, config, trim=trims[number])
            del state
            votes = joined_votes(grid.region, votes)
            state = State(match, votes, _field_of(grid, votes, leaning, histogram=config.histogram))
            if balance.feedback.done:
                break
        else:
            del state
            weights = robust_weights(grid, distance, config.robustness)
            state = _cast(grid, match, weights, leaning, trim=trims[number], histogram=config.histogram)
            if target is not None and steps:
                last = finest and number == len(trims) - 1  # nothing comes after it that would take something back
                debt = (
                    None if last else owed(debt, state.field, target, periodic=grid.region.wraps, free=grid.region.free)
                )
                state = _corrected(grid, state, target, debt, steps)
    return state, balance.trace()


def _corrected(grid: Grid, state: State, target: Correlations, debt: np.ndarray | None, steps: int) -> State:
    """Steps on the two-point function, of the voxels that are made."""
    votes, field, region = state.votes, state.field, grid.region
    for _ in range(steps):
        votes = corrected(field, target, debt=debt, periodic=region.wraps, free=region.free)
        field = rematched(region, votes, grid.targets)
    return State(state.match, votes, field)


def _matched(
    grid: Grid, state: State, stage: np.uint64, number: int, config: TextureConfig
) -> tuple[np.ndarray, np.ndarray]:
    if config.search == "exact":
        features = features_of(grid, state.field)
        return nearest_matches(grid, state.match, features, index_penalty=config.index_penalty)
    first = number * config.sweeps + 1
    return swept(
        grid,
        state.match,
        state.field,
        stage=stage,
        first=first,
        count=config.sweeps,
        tries=config.tries,
        index_penalty=config.index_penalty,
    )
