"""The coarsest level: noise becomes a layout whose planes hold the pictures' neighbourhoods, none of them copied."""

from __future__ import annotations

import numpy as np

from trabecula.core.progress import track
from trabecula.core.seeds import key
from trabecula.synth.shared.histogram import Histogram
from trabecula.synth.shared.matching.grid import targets_of
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import rematched
from trabecula.synth.shared.statistics.correlate import corrected
from trabecula.synth.shared.statistics.sliced import UNIT, sliced_views
from trabecula.synth.sliced.aims import Layout, leaning
from trabecula.synth.sliced.config import SlicedConfig

STEP_EVERY = 3
"""Sliced rounds between steps on the two-point function."""


def laid_out(
    layout: Layout, region: Region, histograms: tuple[Histogram, ...], seed: int, config: SlicedConfig
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
    correlations = leaning(layout.correlations, layout.histograms, targets, softness=layout.correlations.softness)
    raw = np.random.Philox(key=int(key(seed, "sliced/noise"))).random_raw(channels * int(np.prod(region.shape)))
    votes = ((raw >> np.uint64(50)).astype(np.int16) - np.int16(8192)).reshape(channels, *region.shape)
    field = rematched(region, votes, targets)
    for number in track(range(config.layout_rounds), "laying out"):
        votes = sliced_views(
            field.astype(np.int16) * np.int16(UNIT),
            layout.views,
            key=stage,
            number=number,
            step=1,
            strength=config.strength,
            periodic=region.wraps,
            free=region.free,
        )
        field = rematched(region, votes, targets)
        if (number + 1) % STEP_EVERY == 0:
            for _ in range(config.layout_steps):
                votes = corrected(field, correlations, periodic=region.wraps, free=region.free)
                field = rematched(region, votes, targets)
    return field
