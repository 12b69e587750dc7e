"""Evenness in the certificate: its figures, and their bands in another sample of the material.

Window means of one size are compared, so no size has to be extrapolated; what differs is how many
windows an image holds. Windows overlap: a row of length S of means over windows of edge w holds as
many independent ones as the squared autocorrelation (1 - u / w)^2 of such means says. The ratio of
two sample variances then follows Fisher's F, with kurtosis taken off the degrees of freedom. A
trend through the whole is that of white noise with the variance of the largest windows.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.engine.lazy_volume import Slabs
from trabecula.measure.evenness import (
    Evenness,
    Spread,
    cell_for,
    depth_of,
    evenness_of,
    labels_of,
    window_counts,
    window_means,
    windows_for,
)
from trabecula.measure.streaming.cells import CellMeans
from trabecula.numerics.quantiles import student, variance_ratio
from trabecula.report.band import CONFIDENCE, LEAST_COUNT

SIZES = ("small", "medium", "large")
"""Of windows, as the names of figures end."""

WHATS = ("fraction", "surface", "direction")
"""Quantities that are local."""

CLASSES = 10
"""Of window means, in which two distributions are compared."""

LEAST_FREEDOM = 4.0
"""Fewer independent windows in the exemplar know no spread."""

PATCHY = 0.02
"""Squared relative error of the variance over windows that no sample is free of, however many
windows it holds: real materials are patchy over distances longer than a scan's corner. Parts of
64^3 of ten scans had standard deviations that scattered by 5 to 16 % where independent windows
would have made it 3 to 8; without it 55 of 86 real parts left a band of evenness, with it 9.
"""

SLOWEST = 0.3
"""Least exponent that is believed: two window sizes of one scan do not know it well."""


@dataclass(frozen=True)
class Windows:
    """Windows of the local figures, the same for all images that are compared."""

    cell: int
    """Voxels a side of a cell."""
    edges: tuple[float, ...]
    """Of the windows, in the images' unit, smallest first."""


def phases_of(image: Image | Slabs) -> dict[str, list[int]]:
    """Return the labels that are judged together, by the suffix of their figures: the solid, or
    every phase of several.
    """
    if image.kind != "labels" or len(image.phases) == 2:
        return {
            "": labels_of(image, None if "void" in image.phases or image.kind != "labels" else 1)
        }
    return {f"_{name}": [label] for label, name in enumerate(image.phases)}


def measure_evenness(
    cells: CellMeans, windows: Windows, phases: Mapping[str, Sequence[int]]
) -> dict[str, Evenness]:
    """Return the evenness of every phase, by the suffix of its figures."""
    counts = window_counts(cells, windows.edges)
    return {suffix: evenness_of(cells, counts, labels=labels) for suffix, labels in phases.items()}


def average_evenness(found: Sequence[Evenness]) -> Evenness:
    """Return the evenness of several images of one size, such as slices: root mean squares, means
    and extremes.
    """
    first = found[0]

    def merge(spreads: Sequence[Spread]) -> Spread:
        return replace(
            spreads[0],
            mean=float(np.mean([each.mean for each in spreads])),
            deviation=float(np.sqrt(np.mean([each.deviation**2 for each in spreads]))),
            lowest=min(each.lowest for each in spreads),
            highest=max(each.highest for each in spreads),
            kurtosis=float(np.mean([each.kurtosis for each in spreads])),
            quantiles=tuple(np.mean([each.quantiles for each in spreads], axis=0).tolist()),
        )

    def merge_all(name: str) -> tuple[Spread, ...]:
        return tuple(
            merge(spreads) for spreads in zip(*(getattr(each, name) for each in found), strict=True)
        )

    def mean(name: str) -> dict[str, float]:
        return {
            axis: float(np.mean([getattr(each, name)[axis] for each in found]))
            for axis in getattr(first, name)
        }

    return Evenness(
        merge_all("fraction"),
        merge_all("surface"),
        merge_all("direction"),
        mean("trend"),
        mean("surface_trend"),
        first.extents,
        len(found),
    )


def evenness_numbers(
    found: Evenness, suffix: str = "", *, whats: Sequence[str] = WHATS
) -> dict[str, float]:
    """Return every figure of evenness by the name that the certificate gives it.

    Parameters
    ----------
    found : Evenness
    suffix : str
        Of the names: the phase.
    whats : sequence of {"fraction", "surface", "direction"}
        Surface and direction are those of all phases, so that they are asked once.
    """
    numbers: dict[str, float] = {}
    names = SIZES[-len(found.fraction) :]
    for what in whats:
        for size, spread in zip(names, getattr(found, what), strict=True):
            numbers[f"{what}_spread_{size}{suffix}"] = spread.deviation
            if what != "direction":
                numbers[f"{what}_lowest_{size}{suffix}"] = spread.lowest
                numbers[f"{what}_highest_{size}{suffix}"] = spread.highest
        if what != "direction":
            trend = found.trend if what == "fraction" else found.surface_trend
            numbers |= {f"{what}_trend_{axis}{suffix}": value for axis, value in trend.items()}
    return numbers


def hellinger_distances(exemplar: Evenness, image: Evenness, suffix: str = "") -> dict[str, float]:
    """Return the Hellinger distance of the local fraction's distribution to the exemplar's, of each
    size of windows, 0 to 1.

    Classes are the tenths of the exemplar's windows: sqrt(1 - sum sqrt(p q)), p = 1 / 10.
    """
    found = {}
    names = SIZES[-len(exemplar.fraction) :]
    for size, own, other in zip(names, exemplar.fraction, image.fraction, strict=True):
        levels = np.linspace(0, 1, len(own.quantiles))
        edges = np.interp(np.arange(1, CLASSES) / CLASSES, levels, own.quantiles)
        below = np.interp(edges, other.quantiles, levels, left=0, right=1)
        shares = np.diff(below, prepend=0, append=1)
        overlap = float(np.sqrt(np.maximum(shares, 0) / CLASSES).sum())
        found[f"fraction_hellinger_{size}{suffix}"] = math.sqrt(max(0.0, 1 - overlap))
    return found


def evenness_bands(
    exemplar: Evenness, image: Evenness, suffix: str = "", *, whats: Sequence[str] = WHATS
) -> dict[str, tuple[float, float]]:
    """Return the band of every figure of evenness of an image that the exemplar has windows enough
    for.

    Parameters
    ----------
    exemplar, image : Evenness
        Of windows of the same edges.
    suffix, whats
        As of `evenness_numbers`.
    """
    bands: dict[str, tuple[float, float]] = {}
    names = SIZES[-len(exemplar.fraction) :]
    for what in whats:
        patchy = 0.0
        for size, own in zip(names, getattr(exemplar, what), strict=True):
            patchy = _patchiness(exemplar, own, patchy)
            if _freedom(exemplar, own, own.kurtosis) < LEAST_FREEDOM:
                continue
            low, high = _deviation_band(exemplar, image, own, patchy)
            bands[f"{what}_spread_{size}{suffix}"] = low, high
            if what != "direction":
                far = high * _farthest(image, own)
                floor = 0.0 if own.lowest >= 0 else -math.inf
                bands[f"{what}_lowest_{size}{suffix}"] = (
                    max(floor, min(own.lowest, own.mean - far)),
                    own.mean,
                )
                bands[f"{what}_highest_{size}{suffix}"] = (
                    own.mean,
                    max(own.highest, own.mean + far),
                )
        if what != "direction":
            trend = exemplar.trend if what == "fraction" else exemplar.surface_trend
            largest, exponent = getattr(exemplar, what)[-1], scaling_exponent(exemplar)
            limits = _trend_limits(exemplar, image.extents, largest, (1 + CONFIDENCE) / 2, exponent)
            for axis, value in trend.items():
                if axis in limits:
                    far = max(abs(value), limits[axis])
                    bands[f"{what}_trend_{axis}{suffix}"] = (-far, far)
    return bands


def scaling_exponent(exemplar: Evenness) -> float:
    """Return the exponent a by which the variance of window means falls with the window's volume,
    `SLOWEST` to 1.

    It is 1 where windows are many correlation lengths wide and the material has no longer waves.
    Less says that density varies over distances as long as the windows.
    """
    if len(exemplar.fraction) < 2:
        return 1.0
    one, other = exemplar.fraction[-2:]
    # Windows as wide as whole periods do not vary.
    if not min(one.deviation, other.deviation) > 0 or other.edge <= one.edge:
        return 1.0
    variances = [each.deviation**2 / _variance_share(exemplar, each.edge) for each in (one, other)]
    volumes = len(exemplar.extents) * math.log(other.edge / one.edge)
    return min(1.0, max(SLOWEST, math.log(variances[0] / variances[1]) / volumes))


def _deviation_band(
    exemplar: Evenness, image: Evenness, own: Spread, patchy: float
) -> tuple[float, float]:
    """Return the band of the standard deviation over windows; both samples are too even by what
    their own means take away.

    patchy: squared relative error of the variance over an eighth of the exemplar (a quarter of a
    picture) beyond that of independent windows. It falls with the volume as the variance of the
    fraction does.
    """
    expected = own.deviation * math.sqrt(
        _variance_share(image, own.edge) / _variance_share(exemplar, own.edge)
    )
    block = math.prod(exemplar.extents) / 2 ** len(exemplar.extents)
    exponent = scaling_exponent(exemplar)

    def freedom_of(sample: Evenness) -> float:
        own_error = 2 / max(0.1, _freedom(sample, own, own.kurtosis))
        share = (block / (math.prod(sample.extents) * sample.images)) ** exponent
        return 2 / (own_error + patchy * share + PATCHY)

    upper, freedom = max(1.0, freedom_of(image)), freedom_of(exemplar)
    ratios = [
        variance_ratio(round(upper, 1), round(freedom, 1), (1 + sign * CONFIDENCE) / 2)
        for sign in (-1, 1)
    ]
    low, high = (expected * math.sqrt(ratio) for ratio in ratios)
    return min(low, own.deviation), max(high, own.deviation)


def _patchiness(exemplar: Evenness, own: Spread, smaller: float) -> float:
    """Return by how much the variances over windows of the exemplar's octants differ beyond what
    independent windows make: their squared relative deviation less that of the F distribution.

    smaller: that of smaller windows, where octants hold too few of these.
    """
    variances = np.asarray(own.blocks)
    if len(variances) < LEAST_COUNT or not variances.any():
        return smaller
    half = replace(exemplar, extents=tuple(length / 2 for length in exemplar.extents))
    expected = 2 / max(1.0, _freedom(half, own, own.kurtosis))
    return max(0.0, float(variances.var(ddof=1) / variances.mean() ** 2) - expected)


def _trend_limits(
    exemplar: Evenness, extents: Sequence[float], largest: Spread, level: float, exponent: float
) -> dict[str, float]:
    """Return the trends that chance makes in a sample of these extents, by axis."""
    freedom = _freedom(exemplar, largest, 3.0)
    if freedom < LEAST_FREEDOM:
        return {}
    variance = largest.deviation**2 / _variance_share(exemplar, largest.edge)
    # of the window's volume to the sample's
    ratio = math.prod(min(1.0, largest.edge / length) for length in extents)
    noise = student(round(freedom, 1), level) * math.sqrt(variance * ratio**exponent)
    names = ("z", "y", "x")[3 - len(extents) :]
    # A line through white noise of variance v a unit volume changes by sqrt(12 v / V) from end to
    # end; what runs to the centre has the variance of the depth instead of 1 / 12.
    grid = [max(3, round(24 * length / max(extents))) for length in extents]
    depth = float(depth_of((1,) * (3 - len(extents)) + tuple(grid)).std())
    return {**dict.fromkeys(names, math.sqrt(12) * noise), "centre": noise / depth}


def _freedom(image: Evenness, spread: Spread, kurtosis: float) -> float:
    """Return the degrees of freedom of the variance over windows.

    Means over windows that touch are kin as well, over about the material's own correlation: the
    smallest windows are about three correlation lengths wide, so two thirds of their edge stand for
    it. Without that a quarter of independent Gaussian fields left the band of the smallest windows,
    with it one in a hundred.
    """
    reach = spread.edge + image.fraction[0].edge * 2 / 3
    count = math.prod(_independent(length - spread.edge, reach, 2) for length in image.extents)
    return image.images * (count - 1) * 2 / (min(max(kurtosis, 1.5), 12.0) - 1)


def _variance_share(image: Evenness, edge: float) -> float:
    """Return the share of the variance that windows of one sample show around their own mean."""
    return 1 - 1 / max(
        1.01, math.prod(_independent(length - edge, edge, 1) for length in image.extents)
    )


def _independent(span: float, edge: float, power: int) -> float:
    """Count the independent means along a line over which a window of `edge` slides; of their
    squares with power 2.
    """
    if span <= 0:
        return 1.0
    u = (np.arange(256) + 0.5) / 256 * min(span, edge)
    weight = (1 - u / span) * (1 - u / edge) ** power
    return 1 / (2 / span * float(weight.mean()) * min(span, edge))


def _farthest(image: Evenness, own: Spread) -> float:
    """Return the standard deviations that the farthest of all windows reaches, 99 times in 100;
    more where the exemplar's own does.
    """
    count = image.images * math.prod(max(1.0, 2 * length / own.edge) for length in image.extents)
    normal = NormalDist().inv_cdf(CONFIDENCE ** (1 / count))
    skew = max(own.mean - own.lowest, own.highest - own.mean) / max(own.deviation, 1e-12)
    return max(normal, skew)


def choose_windows(exemplar: Image, images: Sequence[Image]) -> Windows | None:
    """Return windows that suit the exemplar and fit into every image; None where one is too small
    for any.
    """
    if min(min(image.shape) for image in (exemplar, *images)) < 4 * cell_for((8, *exemplar.shape)):
        return None
    sides = [
        side * step
        for image in (exemplar, *images)
        for side, step in zip(image.shape, image.spacing, strict=True)
    ]
    return Windows(cell_for(exemplar.shape), tuple(windows_for(exemplar, shortest=min(sides))))


def local_fractions(measured: Any) -> dict[str, np.ndarray]:
    """Return maps of the local fraction over windows of medium size, in the middle plane across
    every axis, by axis.
    """
    cells, found = measured.cells, next(iter(measured.evenness.values()))
    counts = window_counts(cells, [found.fraction[len(found.fraction) // 2].edge])[0]
    means = window_means(cells.shares[-1], counts)
    names = [
        (axis, name)
        for axis, name in enumerate("zyx")
        if cells.shape[axis] > 1 or means.shape[axis] == 1
    ]
    return {name: means.take(means.shape[axis] // 2, axis) for axis, name in names}


def windows_note(found: Mapping[str, Evenness], unit: str) -> str:
    """Return a note on the windows of the local figures."""
    edges = ", ".join(f"{spread.edge:.4g}" for spread in next(iter(found.values())).fraction)
    return f"Local figures are of windows of {edges} {unit} a side (small to large)."
