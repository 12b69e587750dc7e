"""From a phase's two-point function to the filter that makes a Gaussian field of it.

Cut at t = Phi^-1(1 - phi), a Gaussian field of covariance rho(r) gives a phase of fraction phi with
the two-point function

    S2(r) = phi^2 + 1 / (2 pi) * integral from 0 to arcsin rho(r) of exp(-t^2 / (1 + sin a)) da

(Berk 1987, doi:10.1103/PhysRevLett.58.2718; for t = 0 it is 1/4 + arcsin(rho) / (2 pi)). It rises
with rho, so S2 at every offset gives rho at every offset (Quiblier 1984,
doi:10.1016/0021-9797(84)90481-8).
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from trabecula.numerics.transforms import sums_by_offset

_ANGLES = 1 << 13
_NEAR = 2.0  # voxels: offsets below it are fitted in full, those beyond less and less


@dataclass(frozen=True)
class Filter:
    """White noise convolved with `values` has the fitted covariance.

    Attributes
    ----------
    values : float32 array, odd sides
        Offset 0 in the middle.
    clipped : float
        Share of the spectrum's size that was negative, which no field can have, before it was
        fitted.
    """

    values: np.ndarray
    clipped: float


def joint_probability(fraction: float) -> tuple[np.ndarray, np.ndarray]:
    """S2 of a cut Gaussian field as a table: arcsin of the covariance, -pi/2 .. pi/2, and S2
    (equation above).
    """
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
    """Pairs of True voxels for every offset, -reach .. reach along every axis, by Fourier
    transform.
    """
    return np.rint(sums_by_offset(inside, reach))


def averaged(hits: np.ndarray, pairs: np.ndarray, reach: tuple[int, ...]) -> np.ndarray:
    """S2 as a mean over directions, at every offset -reach .. reach; beyond the longest that is
    known, its last value.

    Offsets are gathered by their length, rounded, and S2 runs straight between the mean lengths of
    neighbours.
    """
    length = np.sqrt(sum(part.astype(np.float64) ** 2 for part in _axes(hits.shape)))
    bins, weight = np.rint(length).astype(np.int64).ravel(), pairs.ravel()
    count = np.bincount(bins, weight)
    known = count > 0
    mean = np.bincount(bins, hits.ravel())[known] / count[known]
    place = np.bincount(bins, weight * length.ravel())[known] / count[known]
    wide = tuple(2 * far + 1 for far in reach)
    return np.interp(
        np.sqrt(sum(part.astype(np.float64) ** 2 for part in _axes(wide))), place, mean
    )


def fitted_filter(
    two_point: np.ndarray, fraction: float, *, corrections: int, isotropic: bool = False
) -> Filter:
    """The filter for S2 at every offset (odd sides, offset 0 in the middle).

    The covariance fades out over the outer half of every axis (of every direction, where
    `isotropic`), where few pairs fit.
    """
    angle, table = joint_probability(fraction)
    covariance = np.sin(np.interp(two_point, table, angle))
    fading = _fading_around(two_point.shape) if isotropic else _fading(two_point.shape)
    return filter_of(covariance * fading, corrections=corrections)


def filter_of(covariance: np.ndarray, *, corrections: int) -> Filter:
    """The filter for a covariance at every offset (odd sides, offset 0 in the middle).

    The spectrum of a measured covariance has a negative part, since a finite image's S2 is
    uncertain and not every S2 belongs to a Gaussian field. Cutting that off adds white noise, felt
    most at the shortest offsets; so the nearest spectrum without negative part is sought, in least
    squares over offsets with weights that fall with distance, by projected gradients with momentum
    (Beck and Teboulle 2009, FISTA, doi:10.1137/080716542).
    """
    wanted = np.fft.ifftshift(covariance).astype(np.float32)
    weight = np.fft.ifftshift(_weight(covariance.shape)).astype(np.float32)
    axes = (0, 1, 2)
    raw = np.fft.rfftn(wanted, axes=axes).real
    clipped = float(-raw[raw < 0].sum() / np.abs(raw).sum())
    power = np.maximum(raw, 0)
    latest = guess = np.fft.irfftn(power, wanted.shape, axes)
    speed = 1.0
    for _ in range(corrections):
        power = np.maximum(np.fft.rfftn(guess + weight * (wanted - guess), axes=axes).real, 0)
        better = np.fft.irfftn(power, wanted.shape, axes)
        faster = (1 + np.sqrt(1 + 4 * speed**2)) / 2
        guess = better + np.float32((speed - 1) / faster) * (better - latest)
        latest, speed = better, faster
    values = np.fft.fftshift(np.fft.irfftn(np.sqrt(power / latest[0, 0, 0]), wanted.shape, axes))
    return Filter(values.astype(np.float32), clipped)


def _axes(shape: tuple[int, ...]) -> list[np.ndarray]:
    return [
        np.abs(part)
        for part in np.ogrid[tuple(slice(-(side // 2), side // 2 + 1) for side in shape)]
    ]


def _fading(shape: tuple[int, ...]) -> np.ndarray:
    """1 in the inner half of every axis, falling to 0 at the end as a cosine does."""
    window = np.ones(shape)
    for part, side in zip(_axes(shape), shape, strict=True):
        along = np.clip(2 * part / (side // 2 + 1) - 1, 0, 1)
        window *= 0.5 + 0.5 * np.cos(np.pi * along)
    return window


def _fading_around(shape: tuple[int, ...]) -> np.ndarray:
    """The same along every direction."""
    z, y, x = _axes(shape)
    along = np.clip(
        2 * np.sqrt(z**2 + y**2 + x**2) / (min(side for side in shape if side > 1) // 2 + 1) - 1,
        0,
        1,
    )
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * along))


def _weight(shape: tuple[int, ...]) -> np.ndarray:
    z, y, x = _axes(shape)
    return (1 + (z**2 + y**2 + x**2) / _NEAR**2) ** -1.5
