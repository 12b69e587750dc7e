"""Planes of a volume that is judged by pictures: which slices stand for a picture, and how they
are measured.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.core.progress import silence
from trabecula.exemplar.magnification import to_one_magnification
from trabecula.exemplar.views import View, as_axis, take_slices, views_of
from trabecula.measure.correlation import decay_length, two_point
from trabecula.measure.correlation.axis_preference import (
    preference,
    preference_of,
    two_point_diagonal,
)
from trabecula.measure.describe import autocorrelation_lines
from trabecula.measure.grey import autocorrelation
from trabecula.measure.registry import COUNT
from trabecula.report.descriptors import DescriptorSet, Measurements, TextureDescriptors
from trabecula.report.evenness import average_evenness
from trabecula.report.metrics import find_descriptor

DIAGONAL = "diagonal"
"""Curve of the covariance along the diagonals of slices."""


@dataclass(frozen=True)
class SlicePlane:
    """A picture, and the planes of a volume that are to look like it."""

    picture: Image
    planes: tuple[str, ...]
    suffix: str
    """Of the names of its figures; empty where it is the only picture."""


def slice_planes(
    pictures: Sequence[Image], views: Sequence[str] = (), *, gap: int = 0
) -> list[SlicePlane]:
    """Return every picture with its planes, at one magnification; `views` and `gap` as of a method
    that learns from pictures. Of parallel sections the first stands for all planes.

    Raises
    ------
    InputError
        Pictures and planes that do not fit each other (see `views_of`).
    """
    pictures = to_one_magnification(pictures)
    found = find_views(pictures, views, gap=gap)
    pictures = pictures[:1] if gap else pictures
    numbers = [0] * len(views) if len(pictures) == 1 else list(range(len(views)))
    # A view's own picture is turned already; here slices are turned as the picture lies.
    named = [(view.plane, view.picture) for view in found]
    if views:
        named = list(zip(views, numbers, strict=True))
    faces = []
    for number, picture in enumerate(pictures):
        planes = tuple(plane for plane, of in named if of == number)
        faces.append(SlicePlane(picture, planes, "_".join(planes) if len(pictures) > 1 else ""))
    return faces


def find_views(pictures: Sequence[Image], views: Sequence[str], *, gap: int = 0) -> Sequence[View]:
    """Return the views of pictures, without a word on other views that may suit them better."""
    # that other views may suit a picture better is for methods to say
    with silence():
        return views_of(pictures, views, gap=gap)


class SliceDescriptors:
    """Descriptors of a picture, and of a volume's slices as means.

    Parameters
    ----------
    inner : LabelDescriptors or TextureDescriptors
    reach : int
        Largest distance at which lines along the axes are compared with lines along diagonals,
        pixels.
    """

    def __init__(self, inner: DescriptorSet, *, reach: int) -> None:
        self.inner, self.reach = inner, reach

    def measure(self, image: Image, *, part: bool = False) -> Measurements:
        """Measure a picture, a part of one, or one slice."""
        found = self.inner.measure(image, part=part)
        numbers = {
            name: value for name, value in found.numbers.items() if find_descriptor(name).in_slices
        }
        curves = {**found.curves, **self._diagonal(image)}
        return replace(found, numbers={**numbers, **self._preference(curves)}, curves=curves)

    def measure_plane(self, volume: Image, plane: str) -> Measurements:
        """Measure the mean over slices of one plane."""
        found = [self.measure(each) for each in take_slices(volume, plane)]
        # Slices nearer to each other than the covariance reaches are no two samples.
        independent = volume.shape[as_axis(plane)] / self.reach
        return replace(self.mean(found), samples=max(1.0, min(float(len(found)), independent)))

    def mean(self, found: Sequence[Measurements]) -> Measurements:
        """Average several, counts scaled to the size of the first."""
        sizes = [float(np.prod(each.shape)) for each in found]
        numbers = {
            name: _mean([each.numbers.get(name) for each in found]) for name in found[0].numbers
        }
        for name in numbers:
            if find_descriptor(name).rule == COUNT:
                counts = [each.numbers[name] for each in found]
                numbers[name] = float(
                    np.mean([n * sizes[0] / size for n, size in zip(counts, sizes, strict=True)])
                )
        curves = {
            name: np.mean([each.curves[name] for each in found], axis=0) for name in found[0].curves
        }
        shares = np.concatenate([each.sizes for each in found])
        names = found[0].evenness
        local = {name: average_evenness([each.evenness[name] for each in found]) for name in names}
        samples = float(sum(each.samples for each in found))
        numbers |= self._preference(curves)
        return Measurements(
            found[0].shape, numbers, curves, shares, {}, local, found[0].cells, samples
        )

    def distances(self, image: Measurements, exemplar: Measurements) -> dict[str, float]:
        """Return the distances as of pictures."""
        return self.inner.distances(image, exemplar)

    def _diagonal(self, image: Image) -> dict[str, np.ndarray]:
        """Return the curve along the diagonals; nothing where pixels are no squares."""
        if max(image.spacing) > min(image.spacing) * (1 + 1e-4):
            return {}
        if not isinstance(self.inner, TextureDescriptors):
            return {DIAGONAL: two_point_diagonal(image, r_max=self.reach)}
        rho = autocorrelation(image, lags=min(self.reach, self.inner.lags))
        row, column = (side // 2 for side in rho.shape)  # of offset 0
        steps = np.arange(int(min(row, column) / np.sqrt(2)) + 1)
        return {DIAGONAL: (rho[row + steps, column + steps] + rho[row + steps, column - steps]) / 2}

    def _preference(self, curves: Mapping[str, np.ndarray]) -> dict[str, float]:
        if DIAGONAL not in curves:
            return {}
        if isinstance(self.inner, TextureDescriptors):
            lines = [curves[f"autocorrelation_{axis}"] for axis in "yx"]
            far = min(map(len, lines))
            axial = np.mean([line[:far] for line in lines], axis=0)
            return {"texture_preference": preference_of(axial, curves[DIAGONAL])}
        return {
            "axis_preference": preference(
                (curves["two_point_axis_y"] + curves["two_point_axis_x"]) / 2, curves[DIAGONAL]
            )
        }


def reach_of(picture: Image, r_max: int) -> int:
    """Return the distance up to which a picture's covariance is known: three correlation lengths,
    `r_max` at most.

    Beyond it lines along axes and along diagonals differ by chance alone.
    """
    if picture.kind == "labels":
        line = two_point(picture, r_max=r_max)
        length = decay_length(line)
    else:
        lines = autocorrelation_lines(picture, lags=r_max).values()
        length = max(
            float(np.max(np.flatnonzero(np.abs(line) >= np.exp(-1)), initial=0)) for line in lines
        )
    return int(min(max(8, 3 * length), r_max))


def _mean(values: Sequence[Any]) -> float | None:
    """Average the values that exist, such as the thickness of slices that hold the phase."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
