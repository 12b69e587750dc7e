"""The coarsest level: noise becomes a layout whose planes hold the pictures' neighbourhoods, none
of them copied.
"""

from __future__ import annotations

import numpy as np

from trabecula.core.progress import track
from trabecula.core.seeds import key
from trabecula.engine.checkpoint import offer, resumed
from trabecula.synth.shared.content.fields import (
    noise,
    votes_of,
)
from trabecula.synth.shared.content.histogram import (
    Histogram,
)
from trabecula.synth.shared.matching.grid import coherent_search, random_matches, targets_of
from trabecula.synth.shared.matching.planes import (
    RegionViews,
    cast_plane_votes,
)
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import join_to_known, match_votes, robust_weights
from trabecula.synth.shared.solid.run import (
    SolidState,
)
from trabecula.synth.shared.statistics.sliced import (
    transport_planes,
)
from trabecula.synth.shared.statistics.two_point import (
    Correlations,
)
from trabecula.synth.shared.statistics.two_point_steps import (
    two_point_step,
)
from trabecula.synth.sliced.aims import Layout, reweight_target
from trabecula.synth.sliced.config import SlicedConfig
from trabecula.synth.sliced.steps import distance_step

STEP_EVERY = 3
"""Sliced rounds between steps on the two-point function."""


STAGE = "layout"
"""Of a run that can be interrupted: what is kept is the field."""


def lay_out(
    layout: Layout,
    region: Region,
    histograms: tuple[Histogram, ...],
    seed: int,
    config: SlicedConfig,
) -> np.ndarray:
    """Sliced rounds from noise, with steps on the two-point function.

    Parameters
    ----------
    layout : Layout
    region : Region
        Of the level; no side below the neighbourhoods' width.
    histograms : tuple of Histogram
        What the channels are to hold: the layout's own, or such as meet a target porosity.
    seed : int
    config : SlicedConfig

    Returns
    -------
    (C, Z, Y, X) int8
    """
    channels, stage = len(layout.histograms), key(seed, "sliced/layout")
    targets = targets_of(region, histograms, width=config.layout_width)
    correlations = reweight_target(
        layout.correlations, layout.histograms, targets, softness=layout.correlations.softness
    )
    state = resumed(STAGE)
    if state is None:
        begin = 0
        votes = noise((channels, *region.shape), int(key(seed, "sliced/noise")))
        field = match_votes(region, votes, targets)
        del votes
    else:
        begin, field = state.number, state.arrays["field"]
    for number in track(
        range(begin, config.layout_rounds), "laying out", total=config.layout_rounds - begin
    ):
        # Votes are nobody's but the call's: they go as soon as the field is there.
        field = match_votes(
            region,
            transport_planes(
                votes_of(field),
                layout.views,
                key=stage,
                number=number,
                step=1,
                strength=config.strength,
                periodic=region.wraps,
                free=region.free,
            ),
            targets,
        )
        if (number + 1) % STEP_EVERY == 0:
            for _ in range(config.layout_steps):
                votes = two_point_step(field, correlations, periodic=region.wraps, free=region.free)
                field = match_votes(region, votes, targets)
                del votes
        offer(STAGE, number + 1, field=field)
    return field


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
            plane.put_axis_first(state.field),
            stage=stage + np.uint64(place),
            first=1 if number == 0 else 1 + config.sweeps * (_FIRST + number - 1),
            count=config.sweeps * (_FIRST if number == 0 else 1),
            tries=config.tries,
            index_penalty=0.0,
        )
        weights.append(robust_weights(plane.grid, distance, config.robustness))
        del distance
    return weights
