"""Filters for the covariance of an exemplar, and for a named one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from trabecula.numerics.transforms import fast_side
from trabecula.synth.noise.config import NoiseConfig
from trabecula.synth.noise.covariance import Filter, averaged, counts_by_offset, fitted_filter

_NAMED: dict[str, tuple[Callable[[np.ndarray], np.ndarray], float]] = {
    "exponential": (lambda r: np.exp(-r), 4.0),
    "matern32": (lambda r: (1 + 3**0.5 * r) * np.exp(-(3**0.5) * r), 3.0),
    "matern52": (lambda r: (1 + 5**0.5 * r + 5 / 3 * r**2) * np.exp(-(5**0.5) * r), 2.6),
    "gaussian": (lambda r: np.exp(-(r**2)), 2.0),
    "wave": (lambda r: np.sinc(2 * r) * np.exp(-(r**2) / 2), 3.0),
}
"""Covariances of the distance over the length, each with the distance that its filter reaches."""

_PARTS = 1 << 18

MOST_REACH = 100
"""Voxels that a filter reaches at most."""


def reach_of(shape: Sequence[int], config: NoiseConfig, *, flat: bool) -> tuple[int, ...]:
    """Offsets of an exemplar's two-point function that are followed along every axis."""
    reach = tuple(min(config.reach, (side - 1) // 2) for side in shape)
    # In a flat exemplar, what it does not show along its normal is what it shows across.
    return (
        (min(far for far in reach if far),) * 3
        if config.isotropic and any(reach) and not flat
        else reach
    )


def matched_filters(
    values: np.ndarray, present: Sequence[int], config: NoiseConfig, *, flat: bool
) -> list[Filter]:
    """A filter per phase but the last, each for the phase within what the ones before left."""
    reach, left, filters = (
        reach_of(values.shape, config, flat=flat),
        np.ones(values.shape, bool),
        [],
    )
    for label in present[:-1]:
        inside = values == label
        filters.append(_matched(inside, left, reach, config))
        left &= ~inside
    return filters


def _matched(
    inside: np.ndarray, left: np.ndarray, reach: tuple[int, ...], config: NoiseConfig
) -> Filter:
    fraction = float(np.count_nonzero(inside) / np.count_nonzero(left))
    if fraction > 0.5:
        # Either side of the threshold tells the covariance. The rarer does so far better: the
        # chance surplus of a phase
        # at some offset is in proportion to its fraction.
        inside, fraction = left & ~inside, 1 - fraction
    seen = tuple(min(far, side - 1) for far, side in zip(reach, left.shape, strict=True))
    pairs = counts_by_offset(left, seen)
    hits = counts_by_offset(inside, seen)
    if config.isotropic:
        hits = averaged(hits, pairs, reach)
    else:
        hits /= np.maximum(pairs, 1)
        hits[pairs < 1] = fraction**2
    return fitted_filter(hits, fraction, corrections=config.corrections, isotropic=config.isotropic)


def named_reach(name: str, lengths: Sequence[float], *, flat: bool) -> tuple[int, ...]:
    """Offsets that the filter of a named covariance has, for lengths in voxels."""
    far = _NAMED[name][1]
    return tuple(
        0 if flat and axis == 0 else max(1, int(np.ceil(far * length)))
        for axis, length in enumerate(lengths)
    )


def named_filter(name: str, lengths: Sequence[float], *, flat: bool) -> Filter:
    """The filter of a named covariance, for lengths in voxels.

    It is found on a torus half as wide again as the filter, so that the covariance has faded where
    it meets itself: an edge there would roughen the field along the axes.
    """
    reach = named_reach(name, lengths, flat=flat)
    sides = [fast_side(3 * far + 1) for far in reach]
    offsets = np.ix_(*(np.minimum(np.arange(side), side - np.arange(side)) for side in sides))
    distance = np.sqrt(
        sum((part / length) ** 2 for part, length in zip(offsets, lengths, strict=True))
    )
    power = np.maximum(np.fft.rfftn(_NAMED[name][0](distance)).real, 0)
    whole = np.fft.irfftn(np.sqrt(power), sides, (0, 1, 2))
    for axis, far in enumerate(reach):
        whole = np.take(whole, np.arange(-far, far + 1), axis)
    # In whole parts, so that the last bit of an exponential, which machines disagree about, is
    # gone.
    return Filter(
        (np.rint(whole / np.sqrt((whole**2).sum()) * _PARTS) / _PARTS).astype(np.float32), 0.0
    )
