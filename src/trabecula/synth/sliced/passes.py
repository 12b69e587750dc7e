"""Search and vote on one level, each round followed by steps on the two-point function."""

from __future__ import annotations

import numpy as np

from trabecula.core.progress import track
from trabecula.synth.shared.matching.grid import random_matches, swept
from trabecula.synth.shared.matching.planes import Frame, voted_planes
from trabecula.synth.shared.matching.rounds import joined_votes, rematched, robust_weights
from trabecula.synth.shared.statistics.correlate import Correlations
from trabecula.synth.sliced.config import SlicedConfig
from trabecula.synth.sliced.steps import stepped

_FIRST = 4  # times as many sweeps in the first round, which starts from random matches


def passed(
    frame: Frame,
    field: np.ndarray,
    target: Correlations,
    config: SlicedConfig,
    *,
    stage: np.uint64,
    rounds: int,
    steps: int,
    said: str,
) -> tuple[np.ndarray, np.ndarray]:
    """Rounds on a field (C, Z, Y, X) int8: the field after them, and the votes (int16) that it came from."""
    region = frame.region
    matches = [random_matches(plane.grid, stage + np.uint64(place)) for place, plane in enumerate(frame.planes)]
    votes = field.astype(np.int16) * np.int16(256)
    first = 1
    for number in track(range(rounds), said):
        count = config.sweeps * (_FIRST if number == 0 else 1)
        weights = _searched(frame, matches, field, config, stage=stage, first=first, count=count)
        first += count
        votes = joined_votes(region, voted_planes(frame, matches, weights))
        del weights
        field = rematched(region, votes, frame.targets)
        for _ in range(steps):
            votes = stepped(field, target, region)
            field = rematched(region, votes, frame.targets)
    return field, votes


def _searched(
    frame: Frame,
    matches: list[np.ndarray],
    field: np.ndarray,
    config: SlicedConfig,
    *,
    stage: np.uint64,
    first: int,
    count: int,
) -> list[np.ndarray]:
    """New matches in place of the old, one a view; returns what they weigh in the vote."""
    weights = []
    for place, plane in enumerate(frame.planes):
        matches[place], distance = swept(
            plane.grid,
            matches[place],
            plane.turned(field),
            stage=stage + np.uint64(place),
            first=first,
            count=count,
            tries=config.tries,
            index_penalty=0.0,
        )
        weights.append(robust_weights(plane.grid, distance, config.robustness))
    return weights
