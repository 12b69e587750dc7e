"""Filters of Gaussian fields: from a phase's two-point function, or from a named covariance.

Cut at t = Phi^-1(1 - phi), a Gaussian field of covariance rho(r) gives a phase of fraction phi with
the two-point function

    S2(r) = phi^2 + 1 / (2 pi) * integral from 0 to arcsin rho(r) of exp(-t^2 / (1 + sin a)) da

(Berk 1987, doi:10.1103/PhysRevLett.58.2718; for t = 0 it is 1/4 + arcsin(rho) / (2 pi)). It rises
with rho, so S2 at every offset gives rho at every offset (Quiblier 1984,
doi:10.1016/0021-9797(84)90481-8).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import NormalDist

import numpy as np

from trabecula.numerics.transforms import fast_side, sums_by_offset
from trabecula.synth.noise.config import NoiseConfig
from trabecula.synth.shared.gaussian.filters import (
    Filter,
    absolute_offsets,
    fading_window,
    filter_of,
    radial_mean,
)

_ANGLES = 1 << 13


def joint_probability(fraction: float) -> tuple[np.ndarray, np.ndarray]:
    """Return arcsin of the covariance, -pi/2 .. pi/2, and S2 of the cut field (equation above)."""
    threshold = NormalDist().inv_cdf(1 - fraction)
    angle = np.linspace(-np.pi / 2, np.pi / 2, _ANGLES + 1)
    # 1 + sin(-pi/2) is 0: the limit is 0, or 1 where the threshold is 0.
    height = np.exp(-(threshold**2) / np.maximum(1 + np.sin(angle), 1e-300))
    total = (
        np.concatenate([[0.0], np.cumsum(height[1:] + height[:-1])])
        * (angle[1] - angle[0])
        / (4 * np.pi)
    )
    return angle, total - total[_ANGLES // 2] + fraction**2


def counts_by_offset(inside: np.ndarray, reach: tuple[int, ...]) -> np.ndarray:
    """Count pairs of True voxels at every offset, -reach .. reach along every axis.

    The counts come from a Fourier transform.
    """
    return np.rint(sums_by_offset(inside, reach))


def fit_filter(
    two_point: np.ndarray, fraction: float, *, corrections: int, isotropic: bool = False
) -> Filter:
    """Return the filter for S2 at every offset (odd sides, offset 0 in the middle).

    The covariance fades out over the outer half of every axis (of every direction, where
    `isotropic`), where few pairs fit.
    """
    angle, table = joint_probability(fraction)
    covariance = np.sin(np.interp(two_point, table, angle))
    fading = _fading_around(two_point.shape) if isotropic else fading_window(two_point.shape)
    return filter_of(covariance * fading, corrections=corrections)


def _fading_around(shape: tuple[int, ...]) -> np.ndarray:
    """Return the same window along every direction."""
    z, y, x = absolute_offsets(shape)
    along = np.clip(
        2 * np.sqrt(z**2 + y**2 + x**2) / (min(side for side in shape if side > 1) // 2 + 1) - 1,
        0,
        1,
    )
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * along))


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
    """Return the largest offsets of an exemplar's two-point function along every axis."""
    reach = tuple(min(config.reach, (side - 1) // 2) for side in shape)
    # A flat exemplar shows nothing along its normal, which then takes the reach across it.
    return (
        (min(far for far in reach if far),) * 3
        if config.isotropic and any(reach) and not flat
        else reach
    )


def fit_filters(
    values: np.ndarray, present: Sequence[int], config: NoiseConfig, *, flat: bool
) -> list[Filter]:
    """Return a filter per phase but the last, each within the rest of the phases before."""
    reach = reach_of(values.shape, config, flat=flat)
    left = np.ones(values.shape, bool)
    filters: list[Filter] = []
    for label in present[:-1]:
        inside = values == label
        filters.append(_fit_phase(inside, left, reach, config))
        left &= ~inside
    return filters


def _fit_phase(
    inside: np.ndarray, left: np.ndarray, reach: tuple[int, ...], config: NoiseConfig
) -> Filter:
    """Return the filter of one phase within the voxels that are left."""
    fraction = float(np.count_nonzero(inside) / np.count_nonzero(left))
    if fraction > 0.5:
        # The covariance follows from either side of the threshold, and from the rarer one far
        # better: the chance surplus of a phase at an offset is in proportion to its fraction.
        inside, fraction = left & ~inside, 1 - fraction
    seen = tuple(min(far, side - 1) for far, side in zip(reach, left.shape, strict=True))
    pairs = counts_by_offset(left, seen)
    hits = counts_by_offset(inside, seen)
    if config.isotropic:
        hits = radial_mean(hits, pairs, reach)
    else:
        hits /= np.maximum(pairs, 1)
        hits[pairs < 1] = fraction**2
    return fit_filter(hits, fraction, corrections=config.corrections, isotropic=config.isotropic)


def covariance_reach(name: str, lengths: Sequence[float], *, flat: bool) -> tuple[int, ...]:
    """Return the reach of the filter of a named covariance, for lengths in voxels."""
    far = _NAMED[name][1]
    return tuple(
        0 if flat and axis == 0 else max(1, int(np.ceil(far * length)))
        for axis, length in enumerate(lengths)
    )


def covariance_filter(
    name: str,
    lengths: Sequence[float],
    *,
    flat: bool,
    cones: Sequence[float] | None = None,
) -> Filter:
    """Return the filter of a named covariance, for lengths in voxels, of the waves in `cones`.

    It is found on a torus half as wide again as the filter, so that the covariance has faded where
    it meets itself: an edge there would roughen the field along the axes.
    """
    reach = covariance_reach(name, lengths, flat=flat)
    sides = [fast_side(3 * far + 1) for far in reach]
    offsets = np.ix_(*(np.minimum(np.arange(side), side - np.arange(side)) for side in sides))
    distance = np.sqrt(
        sum((part / length) ** 2 for part, length in zip(offsets, lengths, strict=True))
    )
    power = np.maximum(np.fft.rfftn(_NAMED[name][0](distance)).real, 0)
    if cones is not None:
        power = power * _in_cones(sides, cones)
    whole = np.fft.irfftn(np.sqrt(power), sides, (0, 1, 2))
    for axis, far in enumerate(reach):
        whole = np.take(whole, np.arange(-far, far + 1), axis)
    # In whole parts, so that the last bit of an exponential, which machines disagree about, is
    # gone.
    return Filter(
        (np.rint(whole / np.sqrt((whole**2).sum()) * _PARTS) / _PARTS).astype(np.float32), 0.0
    )


_EDGE = 8.0  # degrees over which a cone fades: a sharp one would ring


def _in_cones(sides: Sequence[int], cones: Sequence[float]) -> np.ndarray:
    """Return which waves lie in cones about the axes, 0 .. 1, as `rfftn` orders them (Kumar et al.
    2020, doi:10.1038/s41524-020-0341-6, equation 3).
    """
    waves = np.ix_(*(np.fft.fftfreq(side) for side in sides[:2]), np.fft.rfftfreq(sides[2]))
    length = np.sqrt(sum(wave**2 for wave in waves))
    length[0, 0, 0] = 1.0
    found = np.zeros(length.shape)
    for wave, angle in zip(waves, cones, strict=True):
        if angle > 0:
            away = np.degrees(np.arccos(np.clip(np.abs(wave) / length, 0, 1)))
            found = np.maximum(found, np.clip((angle + _EDGE - away) / _EDGE, 0, 1))
    return found
