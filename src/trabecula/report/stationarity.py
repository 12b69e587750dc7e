"""Stationarity: trends of the local fraction, direction and size along the axes and from the centre
to the rim.

The image is cut into windows about `WIDE` correlation lengths wide. What is measured in them is
fitted by a constant, a slope along every axis and a term in the squared distance from the centre:

- the fraction of the solid (of several phases: of each; of a grey image the mean value);
- the direction: the tensor of the shares of the surface that face each way, of trace 1;
- the size: the surface per volume at equal fraction. The local fraction and its square are terms of
  its fit, since denser places have another surface without being finer or coarser.

A term counts as a trend where both hold:

- it is larger than `SURE` standard errors (`SURER` where more is tested). Windows next to each
  other are still a little alike, which makes fewer of them independent: the variance is multiplied
  by (1 + rho) / (1 - rho) for every axis, rho being the correlation of the residuals of neighbours
  (the effective number of observations of a first-order process: Bayley and Hammersley 1946,
  doi:10.2307/2983560). The direction's components are tested together (Hotelling 1931,
  doi:10.1214/aoms/1177732979), and the result is reported as the normal deviation that is as
  unlikely.
- it changes the fraction by more than `MATTERS` of the rarer phase's (grey: of the standard
  deviation), the surface by more than `MATTERS` of its mean, the tensor by more than `MATTERS`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.grey import grey_values
from trabecula.report.structure import solid_field
from trabecula.report.window_fields import mean_of_windows, surface_of_windows

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
SURER = 4.5
"""Standard errors of direction and size, and of one phase of several: they come on top. In 1,440
stationary images, Gaussian fields and Boolean spheres of 64^3 to 96^3 voxels, none of them was said
to have a trend, and two to have one of the fraction.
"""
MATTERS = 0.1
ALIKE = 0.25
"""The largest correlation of neighbouring windows that is taken for chance: that of windows `WIDE`
lengths wide of an exponential covariance. What is more comes from a material that differs from
place to place, and would hide just that."""


@dataclass(frozen=True)
class Trend:
    """A trend of a local quantity.

    Attributes
    ----------
    name : str
        "z", "y", "x", or "centre to rim".
    start, end : float
        At the two ends: fitted fractions, or greys; of the size mean chords of the solid in
        voxels; of the direction the share of the surface that faces the way in which this share
        changes most.
    errors : float
        The size of the change in standard errors.
    found : bool
        It counts as a trend.
    what : str
        "fraction of PHASE", "mean value", "direction" or "size".
    """

    name: str
    start: float
    end: float
    errors: float
    found: bool
    what: str = "fraction of solid"


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

    @property
    def surest(self) -> tuple[Trend, ...]:
        """Return the surest trend of every quantity that has one, surest first."""
        found = sorted((each for each in self.trends if each.found), key=lambda t: -t.errors)
        return tuple({trend.what: trend for trend in reversed(found)}.values())[::-1]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON: trends by what has them, then by axis."""
        trends: dict[str, dict[str, Any]] = {}
        for trend in self.trends:
            fields = {k: v for k, v in vars(trend).items() if k not in ("name", "what")}
            trends.setdefault(trend.what, {})[trend.name] = fields
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
    edges = []
    for side, length in zip(image.shape, lengths, strict=True):
        wide = WIDE * length if np.isfinite(length) else side / 4
        edges.append(min(side, max(int(np.ceil(wide)), -(-side // MOST_WINDOWS), 1)))
    counts = [side // edge for side, edge in zip(image.shape, edges, strict=True)]
    terms, names = _terms(counts, image.ndim)
    windows = int(np.prod(counts))
    nothing = Stationarity((), windows, tuple(edges))
    if not terms or windows - len(names) - 1 < FEWEST_LEFT:
        return nothing
    field = solid_field(image)
    solid = mean_of_windows(field, edges)
    if solid.std() == 0:
        return nothing
    if image.kind != "labels":
        least = MATTERS * float(field.std(dtype=np.float64))
        fit = _Fit(solid, terms, names)
        grey = fit.trends("mean value", least, scale=_grey_scale(image, field))
        return Stationarity(tuple(grey), windows, tuple(edges))
    trends = [*_fraction_trends(image, solid, edges, terms, names)]
    surface, tensor = surface_of_windows(field, edges)
    trends += _direction_trends(tensor, terms, names)
    trends += _size_trends(surface, solid, terms, names)
    return Stationarity(tuple(trends), windows, tuple(edges))


def _fraction_trends(
    image: Image, solid: np.ndarray, edges: Sequence[int], terms: list[np.ndarray], names: list[str]
) -> Iterator[Trend]:
    """Yield the trends of the solid's fraction, or of every phase's where there are several."""
    fractions = {next(name for name in image.phases[::-1] if name != "void"): solid}
    if len(image.phases) > 2:
        fractions = {
            name: mean_of_windows(image.values == label, edges)
            for label, name in enumerate(image.phases)
        }
    for name, windows in fractions.items():
        p = float(windows.mean())
        if windows.std() > 0:
            fit, least = _Fit(windows, terms, names), MATTERS * min(p, 1 - p)
            sure = SURE if len(fractions) == 1 else SURER
            yield from fit.trends(f"fraction of {name}", least, most=1.0, sure=sure)


def _size_trends(
    surface: np.ndarray, solid: np.ndarray, terms: list[np.ndarray], names: list[str]
) -> Iterator[Trend]:
    """Yield the trends of the surface at equal fraction, as mean chords: 4 p V / S."""
    if surface.std() == 0:
        return
    mean, p = float(surface.mean()), float(solid.mean())
    away = (solid - p).ravel()
    beside = [away, away**2 - np.mean(away**2)]
    for trend in _Fit(surface, terms, names, beside).trends("size", MATTERS * mean, sure=SURER):
        start, end = (4 * p / max(edge, MATTERS * mean) for edge in (trend.start, trend.end))
        yield replace(trend, start=start, end=end)


def _direction_trends(
    tensor: np.ndarray, terms: list[np.ndarray], names: list[str]
) -> Iterator[Trend]:
    """Yield the trends of the direction, components tested together."""
    ndim = tensor.shape[-1]
    upper = np.triu_indices(ndim)
    components = tensor[..., upper[0], upper[1]][..., :-1]  # the last one follows from the trace
    design, inverse = _design(terms)
    values = components.reshape(-1, components.shape[-1])
    fitted = inverse @ design.T @ values
    rest = values - design @ fitted
    count = values.shape[1]
    left = len(values) - design.shape[1] - count + 1  # degrees of freedom of Hotelling's F
    if left < FEWEST_LEFT / 2:
        return
    parts = np.moveaxis(rest.reshape(components.shape), -1, 0)
    inflation = float(np.mean([_inflation(part) for part in parts]))
    covariance = rest.T @ rest / left * inflation
    precision = np.linalg.pinv(covariance, hermitian=True)
    whole = np.linalg.lstsq(design, tensor.reshape(len(values), -1), rcond=None)[0]
    middle = whole[0].reshape(ndim, ndim)
    for n, (name, term) in enumerate(zip(names, terms, strict=True), start=1):
        slope, span = whole[n].reshape(ndim, ndim), float(term.max() - term.min())
        ratio = float(fitted[n] @ precision @ fitted[n]) / inverse[n, n] / count
        errors = _as_errors(ratio, count, left)
        sizes, ways = np.linalg.eigh(slope)
        way = ways[:, int(np.abs(sizes).argmax())]
        start, end = (
            min(max(float(way @ (middle + slope * edge) @ way), 0.0), 1.0)
            for edge in (term.min(), term.max())
        )
        found = errors > SURER and float(np.linalg.norm(slope)) * span > MATTERS
        yield Trend(name, start, end, min(errors, 999.0), found, "direction")


class _Fit:
    """A least-squares fit of one number a window by terms, and by other numbers beside them."""

    def __init__(
        self,
        windows: np.ndarray,
        terms: list[np.ndarray],
        names: list[str],
        beside: Sequence[np.ndarray] = (),
    ) -> None:
        self.terms, self.names, self.mean = terms, names, float(windows.mean())
        design, self.inverse = _design([*terms, *beside])
        self.slopes = self.inverse @ design.T @ windows.ravel()
        rest = windows - (design @ self.slopes).reshape(windows.shape)
        left = windows.size - design.shape[1]
        self.variance = float((rest**2).sum()) / left * _inflation(rest)

    def trends(
        self,
        what: str,
        least: float,
        *,
        scale: float = 1.0,
        most: float = np.inf,
        sure: float = SURE,
    ) -> Iterator[Trend]:
        """Yield the trend of every term; `least` is the change that matters, `most` the largest
        value there is, `sure` the standard errors that are needed.
        """
        for n, (name, term) in enumerate(zip(self.names, self.terms, strict=True), start=1):
            span = term.max() - term.min()
            change = self.slopes[n] * span
            error = np.sqrt(self.variance * self.inverse[n, n]) * span
            found = bool(abs(change) > max(sure * error, least))
            ends = [self.mean + self.slopes[n] * edge for edge in (term.min(), term.max())]
            if most < np.inf:
                ends = np.clip(ends, 0, most).tolist()
            start, end = (float(edge * scale) for edge in ends)
            errors = float(min(abs(change) / error if error > 0 else np.inf, 999.0))
            yield Trend(name, start, end, errors, found, what)


def _design(terms: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns of a fit, a constant first, and the inverse of their products."""
    design = np.stack([np.ones(terms[0].size), *terms], axis=1)
    return design, np.linalg.pinv(design.T @ design, hermitian=True)


def _as_errors(ratio: float, upper: int, lower: int) -> float:
    """Return the normal deviation that is exceeded as rarely as a ratio of two variances, Fisher's
    F (Paulson 1942, doi:10.1214/aoms/1177731608).
    """
    if ratio <= 0:
        return 0.0
    a, b, root = 2 / (9 * upper), 2 / (9 * lower), ratio ** (1 / 3)
    return max(0.0, float(((1 - b) * root - (1 - a)) / np.sqrt(b * root**2 + a)))


def _grey_scale(image: Image, field: np.ndarray) -> float:
    """Return the factor from the field back to greys: the power of two that brought them near 1."""
    top = float(np.abs(field).max())
    return float(np.abs(grey_values(image)).max()) / top if top else 1.0


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
