"""Targets of denser and of sparser material, as the exemplar's own dense and sparse places show
them.

A place x weighs 1 + t g(x), where g(x) is how far the fraction of the phase in a window around x
lies above its mean. With a larger t the weighted exemplar is denser, and its histograms and
two-point functions are those of such places: surface, thickness and pore size change with density
as they do in the material. (A covariance that is kept, as in `reweight_target`, makes the surface
grow as phi (1 - phi): of a sandstone half as fast again as it does.) All is linear in t, for as
long as no weight is negative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from trabecula.synth.shared.box_sums import window_sums
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.statistics.euler import euler_slopes
from trabecula.synth.shared.statistics.pairs import Pairs
from trabecula.synth.shared.statistics.two_point import (
    Correlations,
    Soft,
    soft_indicator,
    whole_blocks,
)

_OPEN = (False, False, False)


@dataclass(frozen=True)
class DensitySlopes:
    """Change of one level's targets with t.

    Attributes
    ----------
    fraction : float
        Of the fraction of the first channel's phase.
    lowest, highest : float
        Least and greatest g.
    values, shares : (n,) int8, (C, n) float64
        Of the share of voxels that have a value.
    curves, squares : (C, bins) float64
        Of the two-point functions, with t and with its square.
    euler : (2C,) float64
        Of the Euler densities.
    """

    fraction: float
    lowest: float
    highest: float
    values: np.ndarray
    shares: np.ndarray
    curves: np.ndarray
    squares: np.ndarray
    euler: np.ndarray

    def histogram(self, own: Histogram, channel: int, t: float) -> Histogram:
        """Return the histogram of a channel at t."""
        changes = np.zeros(len(own.values))
        changes[np.searchsorted(own.values, self.values)] = t * self.shares[channel]
        return own.add(changes)

    def correlations(self, own: Correlations, t: float) -> Correlations:
        """Return the two-point functions at t."""
        return replace(own, curves=own.curves + t * self.curves + t * t * self.squares)


def density_slopes(
    fields: Sequence[np.ndarray], correlations: Correlations, *, width: int
) -> DensitySlopes:
    """Measure the slopes in exemplars (C, Z, Y, X) int8 of one level.

    Parameters
    ----------
    fields : sequence of arrays
    correlations : Correlations
        Of these fields.
    width : int
        Voxels a side of a window.
    """
    weights = density_weights(fields, width)
    size = sum(g.size for g in weights)
    values = np.unique(np.concatenate([np.unique(field) for field in fields]))
    channels, bins = len(fields[0]), correlations.curves.shape[1]
    shares, products = np.zeros((channels, len(values))), np.zeros((channels, bins))
    weighted, alike, fits, fraction = np.zeros(bins), np.zeros(bins), np.zeros(bins), 0.0
    for field, g in zip(fields, weights, strict=True):
        blocks = correlations.blocks
        shape = tuple(side // blocks for side in g.shape)
        pairs = Pairs(
            shape,
            correlations.r_max,
            edges=correlations.edges,
            directions=correlations.directions,
        )
        fits += pairs.fits
        spectrum = pairs.forward(whole_blocks(partial(_some_planes, g), shape, blocks))
        everywhere = pairs.forward(np.ones(shape, np.float32))
        weighted += pairs.curve(spectrum, everywhere) * pairs.fits
        alike += pairs.curve(spectrum, spectrum) * pairs.fits
        fraction += float(g.sum(where=field[0] > 0, dtype=np.float64)) / size
        for c, channel in enumerate(field):
            soft = Soft.of(channel, correlations.softness)
            weighted_planes = partial(_weighted_planes, soft, g)
            moved = pairs.forward(whole_blocks(weighted_planes, shape, blocks))
            still = pairs.forward(whole_blocks(soft.planes, shape, blocks))
            products[c] += pairs.curve(moved, still) * pairs.fits
            places = np.searchsorted(values, channel.ravel())
            shares[c] += np.bincount(places, g.ravel(), len(values)) / size
    # The weights of the pairs of a bin do not add up to 0: places at the faces have fewer of them.
    curves = (products - correlations.curves * weighted) / np.maximum(fits, 1)
    # Ends of a pair in one window are denser together, farther apart each by itself: such a pair
    # weighs (1 + t g(x)) (1 + t g(y)), where x + y as one weigh 1 + t (g(x) + g(y)) / 2.
    variance = sum(float(np.square(g, dtype=np.float64).sum()) for g in weights) / size
    apart = 1 - np.clip(alike / np.maximum(fits, 1) / max(variance, 1e-30), 0, 1)
    means = shares @ soft_indicator(values, correlations.softness)
    return DensitySlopes(
        fraction,
        min(float(g.min()) for g in weights),
        max(float(g.max()) for g in weights),
        values,
        shares,
        curves * (1 + apart),
        np.square(means)[:, None] * apart,
        euler_slopes(fields, weights),
    )


def _some_planes(g: np.ndarray, start: int, stop: int) -> np.ndarray:
    return g[start:stop]


def _weighted_planes(soft: Soft, g: np.ndarray, start: int, stop: int) -> np.ndarray:
    return np.asarray(g[start:stop] * soft.planes(start, stop))


def density_weights(fields: Sequence[np.ndarray], width: int) -> list[np.ndarray]:
    """Return g of every exemplar, (Z, Y, X) float32: its mean over all of them is 0."""
    local = []
    for field in fields:
        inside = field[0] > 0
        room = [
            window_sums(np.ones((1, 1, side), bool), width, _OPEN)[0, 0] for side in inside.shape
        ]
        within = room[0][:, None, None] * room[1][:, None] * room[2]
        local.append(window_sums(inside, width, _OPEN) / within)
    mean = sum(float(each.sum()) for each in local) / sum(each.size for each in local)
    return [(each - mean).astype(np.float32) for each in local]


def weight_for(slopes: Sequence[DensitySlopes], change: float) -> float:
    """Return the t that changes the fraction of the first of some levels by `change`, or as much
    of that as leaves every weight of every level above 0.
    """
    if not slopes[0].fraction:
        return 0.0
    least = max(-1 / one.highest for one in slopes if one.highest > 0)
    most = min(-1 / one.lowest for one in slopes if one.lowest < 0)
    return float(np.clip(change / slopes[0].fraction, least, most))
