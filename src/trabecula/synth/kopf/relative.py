"""A relative in space: a scan of a similar material, brought to what the picture shows.

Its correlation lengths become the picture's by a change of scale, its fraction by a shift of the
interface. Where it still is another material it is refused, with the statistic that differs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.exemplar.views import View, is_seen_alike
from trabecula.fields.grid import resample_array
from trabecula.measure.correlation import covariance_form, decay_length, two_point
from trabecula.measure.distance import signed_distance
from trabecula.measure.smooth import gaussian

MOST = 128
"""Voxels a side of the relative that are learnt from, at most, at the picture's scale: the centre
of a larger one."""

LEAST = 24
"""Voxels a side that it needs at that scale."""

_ODDS = 3.0  # of the fractions, the larger over the smaller
_SCALES = (0.25, 3.0)
_APART = 0.7  # relative l2 of the covariances along an axis, at one scale and fraction
_INTERFACES = 1.5  # their ratio, either way
_LENGTHS = 3  # correlation lengths over which covariances are compared
_REACH = 40  # voxels
_SLICES = 32  # of a relative along each axis, at most, whose radial function is measured
_MIXED = 1e-3  # of a smooth copy, which orders voxels that are equally far from the interface


@dataclass(frozen=True)
class SliceStatistics:
    """Statistics of a phase that slices show as well as volumes.

    Attributes
    ----------
    fraction : float
    two_point : (3, R + 1) float64
        S2 along z, y, x; of a material that is alike from all sides the radial one, three times.
    interface : float
        Share of neighbours along the axes that lie on different sides.
    """

    fraction: float
    two_point: np.ndarray
    interface: float

    @property
    def lengths(self) -> tuple[float, ...]:
        """Return the correlation length along each axis, voxels."""
        return tuple(decay_length(curve) for curve in self.two_point)


@dataclass(frozen=True)
class AdaptedRelative:
    """A relative at the picture's scale and fraction.

    Attributes
    ----------
    image : Image of labels
    depth : (Z, Y, X) float32
        How deep its voxels lie in the second of two phases.
    picture, own : SliceStatistics
        Of the pictures, and of the image at their fraction.
    report : mapping
        For the recipe: plain JSON.
    """

    image: Image
    depth: np.ndarray
    picture: SliceStatistics
    own: SliceStatistics
    report: dict[str, Any]

    def at_fraction(self, fraction: float, present: Sequence[int]) -> AdaptedRelative:
        """Return the relative with its interface shifted until the second of two phases has
        another fraction than in the pictures.

        Raises
        ------
        RequestError
            A fraction that is far from the pictures'.
        """
        name = self.image.phases[present[1]]
        if are_far_apart(fraction, self.picture.fraction):
            raise RequestError(
                f"a volume fraction of {fraction:.3f} is asked for {name}, and the picture has "
                f"{self.picture.fraction:.3f} (odds {_ODDS:g} times apart at most): ask for one "
                "nearer to it"
            )
        report = {**self.report, "fraction": {**self.report["fraction"], "asked": fraction}}
        image = _image_of(self.depth, fraction, present, self.image.phases)
        return replace(self, image=image, report=report)


def adapt_relative(like: Image, views: Sequence[View], present: Sequence[int]) -> AdaptedRelative:
    """Bring a relative to the scale and the fraction of the pictures.

    Raises
    ------
    RequestError
        More or fewer than two phases, or others than the pictures'; a relative too small; a
        fraction, correlation length, two-point function or interface far from the pictures'.
    """
    phases = views[0].image.phases
    if len(present) != 2:
        raise RequestError(
            f"the exemplar holds {len(present)} phases, a relative is for two: merge or segment "
            "the others"
        )
    if like.phases != phases:
        raise RequestError(
            f"the relative is of {', '.join(like.phases)}, the exemplar of {', '.join(phases)}: "
            "name the phases of both alike, in the same order (--phases)"
        )
    name, inside = phases[present[1]], like.values == present[1]
    alike = is_seen_alike(views)
    picture = _statistics_of_views(views, present[1], alike=alike)
    _check_fraction(name, float(inside.mean()), picture.fraction)
    before = statistics_of_volume(inside, alike=alike)
    scales = _scales(picture, before)
    depth = _depth_at(inside, scales)
    image = _image_of(depth, picture.fraction, present, phases)
    made = image.values == present[1]
    if min(made.shape) < LEAST:
        raise RequestError(
            f"the relative is {like.shape}, at the picture's scale {made.shape}: give one of at "
            f"least {LEAST} voxels a side at that scale"
        )
    own = statistics_of_volume(made, alike=alike)
    along = statistics_of_volume(made, alike=False) if alike else own
    distances = _distances(along, picture)
    apart = max(distances)
    if apart > _APART:
        raise RequestError(
            f"the two-point function of the relative along {'zyx'[distances.index(apart)]} is "
            f"another material's: {apart:.2f} from the picture's (relative l2 of the covariance, "
            f"at one scale and fraction), {_APART} is the most: give a scan of a more similar "
            "material"
        )
    ratio = own.interface / picture.interface
    if not 1 / _INTERFACES <= ratio <= _INTERFACES:
        raise RequestError(
            f"the relative has {ratio:.2f} times the picture's interface at one scale and "
            f"fraction, {_INTERFACES} either way is the most: give a scan that is as sharp as the "
            "picture, or smooth one"
        )
    report = {
        "scale": [round(scale, 4) for scale in scales],
        "shape": list(made.shape),
        "fraction": {"relative": float(inside.mean()), "picture": picture.fraction},
        "correlation_length": {"relative": before.lengths, "picture": picture.lengths},
        "two_point_distance": apart,
        "interface_ratio": ratio,
    }
    return AdaptedRelative(image, depth, picture, own, report)


def statistics_of_volume(inside: np.ndarray, *, alike: bool) -> SliceStatistics:
    """Measure a phase (Z, Y, X) bool."""
    reach = min(_REACH, min(inside.shape) // 2)
    values = inside.view(np.uint8)
    if alike:
        curves = [_radial_of_slices(values, reach)] * 3
    else:
        curves = [two_point(values, r_max=reach, phase=1, axis=axis) for axis in range(3)]
    shares = [float(np.mean(np.diff(values, axis=axis) != 0)) for axis in range(3)]
    return SliceStatistics(float(inside.mean()), np.array(curves), float(np.mean(shares)))


def _radial_of_slices(values: np.ndarray, reach: int) -> np.ndarray:
    """Return the mean radial S2 of slices across every axis.

    Not that of the volume: distances are rounded, and of pairs in a plane and of pairs in space
    other ones fall into one bin, so that the two differ by some per cent at r = 1 .. 3.
    """
    curves = []
    for axis, side in enumerate(values.shape):
        for place in range(0, side, -(-side // _SLICES)):
            plane = np.ascontiguousarray(values.take(place, axis))
            curves.append(two_point(plane, r_max=reach, phase=1))
    return np.asarray(np.mean(curves, axis=0))


def _statistics_of_views(views: Sequence[View], label: int, *, alike: bool) -> SliceStatistics:
    """Measure a phase in pictures: along an axis by those that show it."""
    insides = [np.asarray(view.image.values == label) for view in views]
    reach = min(_REACH, min(min(one.shape) for one in insides) // 2)
    fraction = float(np.mean([one.mean() for one in insides]))
    if alike:
        curve = two_point(insides[0].view(np.uint8), r_max=reach, phase=1)
        curves = [curve] * 3
    else:
        seen: list[list[np.ndarray]] = [[], [], []]
        for view, one in zip(views, insides, strict=True):
            for along, axis in enumerate(view.across):
                seen[axis].append(two_point(one.view(np.uint8), r_max=reach, phase=1, axis=along))
        curves = [np.mean(found, axis=0) for found in seen]
    shares = [
        float(np.mean(one.take(range(1, side), axis) != one.take(range(side - 1), axis)))
        for one in insides
        for axis, side in enumerate(one.shape)
    ]
    return SliceStatistics(fraction, np.array(curves), float(np.mean(shares)))


def _check_fraction(name: str, relative: float, picture: float) -> None:
    """Raise where the fraction of a phase is far from the picture's."""
    if are_far_apart(relative, picture):
        raise RequestError(
            f"the volume fraction of {name} is {relative:.3f} in the relative and {picture:.3f} "
            f"in the picture (odds {_ODDS:g} times apart at most): give a scan of a material as "
            "dense, with phases in the same order"
        )


def are_far_apart(one: float, other: float) -> bool:
    """Return whether the odds of two fractions differ by more than a relative may be shifted."""
    low, high = sorted((one, other))
    return high == 1 or high * (1 - low) > _ODDS * low * (1 - high)


def _scales(picture: SliceStatistics, relative: SliceStatistics) -> tuple[float, ...]:
    """Return the factor along each axis that makes the correlation lengths the picture's."""
    found = []
    for axis, ours, theirs in zip("zyx", picture.lengths, relative.lengths, strict=True):
        scale = ours / theirs if theirs and math.isfinite(theirs) else math.inf
        if not _SCALES[0] <= scale <= _SCALES[1]:
            raise RequestError(
                f"the correlation length along {axis} is {theirs:.1f} voxels in the relative and "
                f"{ours:.1f} in the picture: give one that is {1 / _SCALES[1]:.2f} to "
                f"{1 / _SCALES[0]:g} times as long, and shorter than half a side of either"
            )
        found.append(scale)
    return tuple(found)


def _depth_at(inside: np.ndarray, scales: Sequence[float]) -> np.ndarray:
    """Return how deep voxels lie in the centre of a phase (Z, Y, X) bool, at another scale."""
    kept = []
    for side, scale in zip(inside.shape, scales, strict=True):
        width = min(side, math.ceil(MOST / scale))
        start = (side - width) // 2
        kept.append(slice(start, start + width))
    centre = np.ascontiguousarray(inside[tuple(kept)])
    shape = [max(1, round(s * scale)) for s, scale in zip(centre.shape, scales, strict=True)]
    depth = resample_array(signed_distance(centre), shape)
    depth += _MIXED * gaussian(depth, 1.0)
    return np.asarray(depth)


def _image_of(
    depth: np.ndarray, fraction: float, present: Sequence[int], phases: tuple[str, ...]
) -> Image:
    """Return labels with a fraction of the second phase, where it is deepest."""
    inside = depth > np.quantile(depth, 1 - fraction)
    labels = np.where(inside, np.uint8(present[1]), np.uint8(present[0]))
    return Image(labels, "labels", phases=phases)


def _distances(own: SliceStatistics, picture: SliceStatistics) -> list[float]:
    """Return how far the covariances along each axis are apart over a few correlation lengths,
    relative l2.
    """
    lengths = [length for length in picture.lengths if math.isfinite(length)]
    reach = max(2, round(_LENGTHS * max(lengths)))
    stop = 1 + min(reach, own.two_point.shape[1] - 1, picture.two_point.shape[1] - 1)
    found = []
    for mine, theirs in zip(own.two_point, picture.two_point, strict=True):
        ours, other = covariance_form(mine[:stop]), covariance_form(theirs[:stop])
        found.append(float(np.linalg.norm(ours - other) / np.linalg.norm(other)))
    return found
