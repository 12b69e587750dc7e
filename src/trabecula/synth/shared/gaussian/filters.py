"""Filters that give white noise a covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_NEAR = 2.0  # voxels: offsets below it are fitted in full, those beyond less and less


@dataclass(frozen=True)
class Filter:
    """A filter: white noise convolved with `values` has the fitted covariance.

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


def filter_of(covariance: np.ndarray, *, corrections: int) -> Filter:
    """Return the filter for a covariance at every offset (odd sides, offset 0 in the middle).

    The spectrum of a measured covariance has a negative part, since a finite image's S2 is
    uncertain and not every S2 belongs to a Gaussian field. Clipping it adds white noise, felt most
    at the shortest offsets; so the nearest spectrum without negative part is sought, in least
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


def absolute_offsets(shape: tuple[int, ...]) -> list[np.ndarray]:
    """Return the absolute offsets along every axis."""
    return [
        np.abs(part)
        for part in np.ogrid[tuple(slice(-(side // 2), side // 2 + 1) for side in shape)]
    ]


def radial_mean(hits: np.ndarray, pairs: np.ndarray, reach: tuple[int, ...]) -> np.ndarray:
    """Return a mean over pairs averaged over directions, at every offset -reach .. reach.

    Offsets are gathered by their rounded length, and the mean is linear between the mean lengths
    of neighbours. Beyond the longest known offset it keeps its last value.
    """
    length = np.sqrt(sum(part.astype(np.float64) ** 2 for part in absolute_offsets(hits.shape)))
    bins, weight = np.rint(length).astype(np.int64).ravel(), pairs.ravel()
    count = np.bincount(bins, weight)
    known = count > 0
    mean = np.bincount(bins, hits.ravel())[known] / count[known]
    place = np.bincount(bins, weight * length.ravel())[known] / count[known]
    wide = tuple(2 * far + 1 for far in reach)
    return np.interp(
        np.sqrt(sum(part.astype(np.float64) ** 2 for part in absolute_offsets(wide))), place, mean
    )


def fading_window(shape: tuple[int, ...]) -> np.ndarray:
    """Return a window of 1 in the inner half of every axis, falling to 0 at the end as a cosine."""
    window = np.ones(shape)
    for part, side in zip(absolute_offsets(shape), shape, strict=True):
        along = np.clip(2 * part / (side // 2 + 1) - 1, 0, 1)
        window *= 0.5 + 0.5 * np.cos(np.pi * along)
    return window


def _weight(shape: tuple[int, ...]) -> np.ndarray:
    """Return weights that fall with the offset."""
    z, y, x = absolute_offsets(shape)
    return (1 + (z**2 + y**2 + x**2) / _NEAR**2) ** -1.5
