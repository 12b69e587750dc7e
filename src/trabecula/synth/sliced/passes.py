"""Search and vote on one level, each round followed by steps on the two-point function."""

from __future__ import annotations

import numpy as np

from trabecula.core.progress import track
from trabecula.synth.shared.matching.grid import random_matches, coherent_search
from trabecula.synth.shared.matching.planes import RegionViews, cast_plane_votes
from trabecula.synth.shared.matching.rounds import join_to_known, match_votes, robust_weights
from trabecula.synth.shared.solid_state import SolidState
from trabecula.synth.shared.statistics.correlate import Correlations
from trabecula.synth.shared.votes import votes_of
from trabecula.synth.sliced.config import SlicedConfig
from trabecula.synth.sliced.steps import distance_step

_FIRST = 4  # times as many sweeps in the first round, which starts from random matches


def begun(frame: RegionViews, field: np.ndarray, stage: np.uint64) -> SolidState:
    """What rounds start from on a field (C, Z, Y, X) int8: random matches."""
    matches = [
        random_matches(plane.grid, stage + np.uint64(place))
        for place, plane in enumerate(frame.planes)
    ]
    return SolidState(matches, votes_of(field), field)


def passed(
    frame: RegionViews,
    state: SolidState,
    target: Correlations,
    config: SlicedConfig,
    *,
    stage: np.uint64,
    done: int,
    rounds: int,
    steps: int,
    said: str,
) -> None:
    """Rounds from round `done` on: after each the state is offered to who keeps such."""
    region = frame.region
    for number in track(range(done, rounds), said):
        weights = _searched(frame, state, config, stage, number)
        state.votes = join_to_known(region, cast_plane_votes(frame, state.matches, weights))
        del weights
        state.field = match_votes(region, state.votes, frame.targets)
        for _ in range(steps):
            state.votes = distance_step(state.field, target, region)
            state.field = match_votes(region, state.votes, frame.targets)
        state.offer(said, number + 1)


def _searched(
    frame: RegionViews, state: SolidState, config: SlicedConfig, stage: np.uint64, number: int
) -> list[np.ndarray]:
    """New matches in place of the old, one a view; returns what they weigh in the vote."""
    weights = []
    for place, plane in enumerate(frame.planes):
        state.matches[place], distance = coherent_search(
            plane.grid,
            state.matches[place],
            plane.turned(state.field),
            stage=stage + np.uint64(place),
            first=1 if number == 0 else 1 + config.sweeps * (_FIRST + number - 1),
            count=config.sweeps * (_FIRST if number == 0 else 1),
            tries=config.tries,
            index_penalty=0.0,
        )
        weights.append(robust_weights(plane.grid, distance, config.robustness))
        del distance
    return weights
