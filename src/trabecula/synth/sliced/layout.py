"""The coarsest level: noise becomes a layout whose planes hold the pictures' neighbourhoods, none
of them copied.
"""

from __future__ import annotations

import numpy as np

from trabecula.core.progress import track
from trabecula.core.seeds import key
from trabecula.engine.checkpoint import offer, resume
from trabecula.synth.shared.histogram import Histogram
from trabecula.synth.shared.matching.grid import targets_of
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import rematched
from trabecula.synth.shared.statistics.correlate import corrected
from trabecula.synth.shared.statistics.sliced import sliced_views
from trabecula.synth.shared.votes import noise, votes_of
from trabecula.synth.sliced.aims import Layout, leaning
from trabecula.synth.sliced.config import SlicedConfig

STEP_EVERY = 3
"""Sliced rounds between steps on the two-point function."""

STAGE = "layout"
"""Of a run that can be interrupted: what is kept is the field."""


def laid_out(
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
    correlations = leaning(
        layout.correlations, layout.histograms, targets, softness=layout.correlations.softness
    )
    state = resume(STAGE)
    if state is None:
        begin = 0
        votes = noise((channels, *region.shape), int(key(seed, "sliced/noise")))
        field = rematched(region, votes, targets)
        del votes
    else:
        begin, field = state.number, state.arrays["field"]
    for number in track(
        range(begin, config.layout_rounds), "laying out", total=config.layout_rounds - begin
    ):
        # Votes are nobody's but the call's: they go as soon as the field is there.
        field = rematched(
            region,
            sliced_views(
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
                votes = corrected(field, correlations, periodic=region.wraps, free=region.free)
                field = rematched(region, votes, targets)
                del votes
        offer(STAGE, number + 1, field=field)
    return field
