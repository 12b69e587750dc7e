"""Stationarity: trends of the local fraction along the axes and from the centre to the rim.

The image is cut into windows about `WIDE` correlation lengths wide. Their fractions are fitted by a
constant, a slope along every axis and a term in the squared distance from the centre. A term counts
as a trend where both hold:

- it is larger than `SURE` standard errors. Windows next to each other are still a little alike,
  which makes fewer of them independent: the variance is multiplied by (1 + rho) / (1 - rho) for
  every axis, rho being the correlation of the residuals of neighbours (the effective number of
  observations of a first-order process: Bayley and Hammersley 1946, doi:10.2307/2983560).
- it changes the fraction by more than `MATTERS` of the rarer phase's (grey: of the standard
  deviation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.grey import grey_values
from trabecula.report.structure import solid_field

WIDE = 3.0
"""Correlation lengths: an exponential covariance is .05 there."""
MOST_WINDOWS = 12
"""Along an axis: more of them would be fitted no better."""
FEWEST_LEFT = 8
"""Windows more than there are terms, below which nothing is decided."""
SURE = 4.0
"""Standard errors: 1 of 1,380 stationary Gaussian fields (volumes from 64^3, pictures from 160^2)
was said to have a trend.
"""
MATTERS = 0.1
ALIKE = 0.25
"""The largest correlation of neighbouring windows that is taken for chance: that of windows `WIDE`
lengths wide of an exponential covariance. What is more comes from a material that differs from
place to place, and would hide just that."""


@dataclass(frozen=True)
class Trend:
    """A trend of the local fraction (the grey).

    Attributes
    ----------
    name : str
        "z", "y", "x", or "centre to rim".
    start, end : float
        At the two ends: fitted fractions of the solid, or greys.
    errors : float
        The size of the change in standard errors.
    found : bool
        It counts as a trend.
    """

    name: str
    start: float
    end: float
    errors: float
    found: bool


@dataclass(frozen=True)
class Stationarity:
    """Trends of all axes, and the number of windows; `stationary` is None where there are too few
    of them.
    """

    trends: tuple[Trend, ...]
    windows: int
    edge: tuple[int, ...]

    @property
    def stationary(self) -> bool | None:
        """Return whether no trend was found."""
        return not any(trend.found for trend in self.trends) if self.trends else None

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON."""
        trends = {
            trend.name: {k: v for k, v in vars(trend).items() if k != "name"}
            for trend in self.trends
        }
        return {
            "stationary": self.stationary,
            "windows": self.windows,
            "window_edge": list(self.edge),
            "trends": trends,
        }


def find_trends(image: Image, lengths: Sequence[float]) -> Stationarity:
    """Fit the trends of an image.

    Parameters
    ----------
    image : Image
    lengths : sequence of float
        Correlation length along every axis, voxels; infinite ones count as a quarter of the side.
    """
    field = solid_field(image)
    edges = []
    for side, length in zip(field.shape, lengths, strict=True):
        wide = WIDE * length if np.isfinite(length) else side / 4
        edges.append(min(side, max(int(np.ceil(wide)), -(-side // MOST_WINDOWS), 1)))
    windows = _window_means(field, edges)
    terms, names = _terms(windows.shape, image.ndim)
    left = windows.size - len(names) - 1
    if left < FEWEST_LEFT or windows.std() == 0:
        return Stationarity((), windows.size, tuple(edges))
    design = np.stack([np.ones(windows.size), *terms], axis=1)
    inverse = np.linalg.inv(design.T @ design)
    fitted = inverse @ design.T @ windows.ravel()
    rest = windows - (design @ fitted).reshape(windows.shape)
    variance = float((rest**2).sum()) / left * _inflation(rest)
    mean, p = float(windows.mean()), float(field.mean(dtype=np.float64))
    least = MATTERS * (
        min(p, 1 - p) if image.kind == "labels" else float(field.std(dtype=np.float64))
    )
    scale = 1.0 if image.kind == "labels" else _grey_scale(image, field)
    trends = []
    for n, (name, term) in enumerate(zip(names, terms, strict=True), start=1):
        span = term.max() - term.min()
        change, error = fitted[n] * span, np.sqrt(variance * inverse[n, n]) * span
        found = bool(abs(change) > max(SURE * error, least))
        start, end = (mean + (fitted[n] * edge) for edge in (term.min(), term.max()))
        if image.kind == "labels":
            start, end = np.clip([start, end], 0, 1)
        errors = abs(change) / error if error > 0 else np.inf
        trends.append(
            Trend(name, float(start * scale), float(end * scale), float(min(errors, 999.0)), found)
        )
    return Stationarity(tuple(trends), windows.size, tuple(edges))


def _grey_scale(image: Image, field: np.ndarray) -> float:
    """Return the factor from the field back to greys: the power of two that brought them near 1."""
    top = float(np.abs(field).max())
    return float(np.abs(grey_values(image)).max()) / top if top else 1.0


def _window_means(field: np.ndarray, edges: Sequence[int]) -> np.ndarray:
    """Return the means of the windows that fit, centred in the image."""
    counts = [side // edge for side, edge in zip(field.shape, edges, strict=True)]
    starts = [
        (side - n * edge) // 2 for side, n, edge in zip(field.shape, counts, edges, strict=True)
    ]
    box = tuple(slice(a, a + n * edge) for a, n, edge in zip(starts, counts, edges, strict=True))
    split = field[box].reshape([part for pair in zip(counts, edges, strict=True) for part in pair])
    return np.asarray(split.mean(axis=tuple(range(1, 2 * field.ndim, 2)), dtype=np.float64))


def _terms(counts: Sequence[int], ndim: int) -> tuple[list[np.ndarray], list[str]]:
    """Return the terms that the windows' fractions are fitted by, each of mean 0, for axes of three
    windows or more.
    """
    places = np.meshgrid(*((2 * np.arange(n) + 1 - n) / n for n in counts), indexing="ij")
    long = [n for n, count in enumerate(counts) if count >= 3]
    terms = [places[n].ravel() for n in long]
    names = ["zyx"[n + 3 - ndim] for n in long]
    if len(long) >= 2:
        square = np.sum([places[n].ravel() ** 2 for n in long], axis=0)
        terms.append(square - square.mean())
        names.append("centre to rim")
    return terms, names


def _inflation(rest: np.ndarray) -> float:
    """Return the factor by which neighbours that are alike raise the variance of the fit."""
    factor, variance = 1.0, float((rest**2).mean())
    for axis, count in enumerate(rest.shape):
        if count < 3 or variance == 0:
            continue
        lines = np.moveaxis(rest, axis, 0)
        rho = float(np.clip((lines[1:] * lines[:-1]).mean() / variance, 0.0, ALIKE))
        factor *= (1 + rho) / (1 - rho)
    return factor
