"""Law of growth: settings as lengths in voxels, and as whole numbers.

Whole numbers, or whole parts, are rounded alike by every processor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, lru_cache
from statistics import NormalDist

import numpy as np

from trabecula.core.errors import InputError
from trabecula.synth.bubbles.config import BubblesConfig
from trabecula.synth.bubbles.nucleation import FINE

LATEST = {3: 1.6, 2: 2.2}
"""Latest end of growth, in units of L, by dimensions: bubbles have then reached all but one
point in 3 (in 4) million."""

REPULSIONS = 2
PUSH = 0.25
"""Rounds of repulsion, and the farthest move of a round in units of L."""

ABSORBED = 0.35
"""Radius, in units of L, below which a faster bubble absorbs the rest of a slower one."""

_FARTHEST = 6.0  # L that a bubble reaches from where it starts, at most
_CUT = 2.5  # standard deviations at which the law of sizes ends
_SIZES = 4096
_EXACT = 1 << 20


@dataclass(frozen=True)
class Law:
    """Speeds, walls and lengths of growth. Lengths are voxels.

    Attributes
    ----------
    apart : float
        L, a multiple of 1 / FINE.
    wall, grain, shift : float
        Thickness of walls; length over which shifts change, and how far they go along an axis.
    latest : float
        When growth ends: the radius of a bubble of ordinary size.
    reach : float
        How far a bubble gets, at most.
    across, along : float
        1 / v^2 across a flow and along it, in units of 1 / v^2 without one.
    brakes : (4096,) float64 array
        1 / v of equal shares of the bubbles.
    merging : int
        Pairs of bubbles without a wall, of 2**32.
    regularity : float
    ndim : int
    """

    apart: float
    wall: float
    grain: float
    shift: float
    latest: float
    reach: float
    across: float
    along: float
    brakes: np.ndarray
    merging: int
    regularity: float
    ndim: int

    def numbers(self) -> np.ndarray:
        """Return the numbers that kernels read (see `sweep`)."""
        return np.array([self.latest, self.wall, self.reach, self.across, self.along])


def law_of(config: BubblesConfig, spacing: float, ndim: int) -> Law:
    """Return the law of a volume (3) or picture (2) of this spacing.

    Raises
    ------
    InputError
        More bubbles than voxels.
    """
    apart = distance_of(config, spacing, ndim)
    if apart < 1:
        each = f"{'cubic' if ndim == 3 else 'square'} unit"
        raise InputError(
            f"density={config.density:g} per {each} is {apart**-ndim:.3g} bubbles a voxel of edge "
            f"{spacing:g}: give a lower density, or a finer spacing"
        )
    apart = round(apart * FINE) / FINE
    wall = config.thickness * apart if config.separation is None else config.separation / spacing
    grain = round(config.grain * apart * FINE) / FINE
    shift = 0.35 * config.roughness * grain
    across = _round_binary(config.randomness ** (-2 / ndim))
    along = _round_binary(config.randomness ** (2 - 2 / ndim))
    brakes = _brakes(config.spread, ndim)
    latest = LATEST[ndim] if config.time is None else min(config.time, LATEST[ndim])
    fastest = 1 / (brakes.min() * math.sqrt(along))
    reach = (
        apart * min(latest * fastest, _FARTHEST)
        + math.sqrt(ndim) * shift
        + REPULSIONS * PUSH * config.regularity * apart
        + 1
    )
    merging = round(config.coalescence * 2**32)
    return Law(
        apart,
        wall,
        grain,
        shift,
        latest * apart,
        reach,
        across,
        along,
        brakes,
        merging,
        config.regularity,
        ndim,
    )


def distance_of(config: BubblesConfig, spacing: float, ndim: int) -> float:
    """Return L in voxels."""
    if config.density is None:
        return config.distance
    return float(config.density ** (-1 / ndim) / spacing)


def counts_of(mean: float, regularity: float) -> np.ndarray:
    """Return thresholds (uint64) that split 32 random bits into counts 0, 1, ...

    They mix the Poisson distribution with that of least variance.
    """
    whole = math.floor(mean)
    chance, below, even, thresholds = math.exp(-mean), 0.0, 0.0, [0]
    while thresholds[-1] < 2**32 - 1 and len(thresholds) < 64:
        count = len(thresholds) - 1
        below += chance
        even += {whole: 1 - (mean - whole), whole + 1: mean - whole}.get(count, 0.0)
        chance *= mean / (count + 1)
        thresholds.append(round(((1 - regularity) * below + regularity * even) * 2**32))
    return np.array(thresholds[1:], np.uint64)


@cache
def _deviations() -> tuple[float, ...]:
    """Return the middles of equal parts of the standard normal distribution, truncated."""
    ends = [NormalDist().cdf(end) for end in (-_CUT, _CUT)]
    return tuple(
        NormalDist().inv_cdf(ends[0] + (ends[1] - ends[0]) * (i + 0.5) / _SIZES)
        for i in range(_SIZES)
    )


@lru_cache(maxsize=64)
def _brakes(spread: float, ndim: int) -> np.ndarray:
    """Return 1 / v of a truncated lognormal v with mean v^ndim = 1.

    So bubbles fill as much as those of v = 1.
    """
    speeds = [math.exp(spread * deviation) for deviation in _deviations()]
    mean = (math.fsum(speed**ndim for speed in speeds) / _SIZES) ** (1 / ndim)
    whole = np.array([round(speed / mean * 65536) for speed in speeds], np.float64)
    return 65536.0 / whole


def _round_binary(value: float) -> float:
    """Round to 20 binary places."""
    return round(value * _EXACT) / _EXACT
