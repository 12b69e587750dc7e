"""How slices of a volume are measured: as a picture is, and their means taken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.exemplar.views import as_axis
from trabecula.measure.correlation import decay_length, two_point
from trabecula.measure.correlation.axis_preference import (
    preference,
    preference_of,
    two_point_diagonal,
)
from trabecula.measure.describe import autocorrelation_lines
from trabecula.measure.grey import autocorrelation
from trabecula.report.descriptors import Measured, Stick, TextureDescriptors
from trabecula.report.evenness import merge_evenness
from trabecula.report.metrics import COUNT, figure_of, stem_of
from trabecula.report.planes import take_slices

_NOT_OF_SLICES = ("percolates", "euler")
"""Of one slice they are chance, and a mean of them says nothing."""

_DIAGONAL = "diagonal"


class SliceStick:
    """Measures of a picture, and of a volume's slices as the means of such measures.

    Parameters
    ----------
    inner : LabelStick or TextureStick
    reach : int
        Largest distance at which lines along the axes are compared with lines along diagonals,
        pixels.
    """

    def __init__(self, inner: Stick, *, reach: int) -> None:
        self.inner, self.reach = inner, reach

    def measure(self, image: Image, *, part: bool = False) -> Measured:
        """A picture, a part of one, or one slice."""
        found = self.inner.measure(image, part=part)
        numbers = {
            name: value
            for name, value in found.numbers.items()
            if stem_of(name) not in _NOT_OF_SLICES
        }
        curves = {**found.curves, **self._diagonal(image)}
        return replace(found, numbers={**numbers, **self._preference(curves)}, curves=curves)

    def measure_plane(self, volume: Image, plane: str) -> Measured:
        """Measure the mean over slices of one plane."""
        found = [self.measure(each) for each in take_slices(volume, plane)]
        # Slices nearer to each other than the covariance reaches are no two samples.
        independent = volume.shape[as_axis(plane)] / self.reach
        return replace(self.mean(found), samples=max(1.0, min(float(len(found)), independent)))

    def mean(self, found: Sequence[Measured]) -> Measured:
        """The mean of several, counts scaled to the size of the first."""
        sizes = [float(np.prod(each.shape)) for each in found]
        numbers = {
            name: _mean([each.numbers.get(name) for each in found]) for name in found[0].numbers
        }
        for name in numbers:
            if figure_of(name).rule == COUNT:
                counts = [each.numbers[name] for each in found]
                numbers[name] = float(
                    np.mean([n * sizes[0] / size for n, size in zip(counts, sizes, strict=True)])
                )
        curves = {
            name: np.mean([each.curves[name] for each in found], axis=0) for name in found[0].curves
        }
        shares = np.concatenate([each.sizes for each in found])
        names = found[0].evenness
        local = {name: merge_evenness([each.evenness[name] for each in found]) for name in names}
        samples = float(sum(each.samples for each in found))
        numbers |= self._preference(curves)
        return Measured(found[0].shape, numbers, curves, shares, {}, local, found[0].cells, samples)

    def distances(self, image: Measured, exemplar: Measured) -> dict[str, float]:
        """As of pictures."""
        return self.inner.distances(image, exemplar)

    def _diagonal(self, image: Image) -> dict[str, np.ndarray]:
        """What is compared with lines along the axes; nothing where pixels are no squares."""
        if max(image.spacing) > min(image.spacing) * (1 + 1e-4):
            return {}
        if not isinstance(self.inner, TextureDescriptors):
            return {_DIAGONAL: two_point_diagonal(image, r_max=self.reach)}
        rho = autocorrelation(image, lags=min(self.reach, self.inner.lags))
        row, column = (side // 2 for side in rho.shape)  # of offset 0
        steps = np.arange(int(min(row, column) / np.sqrt(2)) + 1)
        return {
            _DIAGONAL: (rho[row + steps, column + steps] + rho[row + steps, column - steps]) / 2
        }

    def _preference(self, curves: Mapping[str, np.ndarray]) -> dict[str, float]:
        if _DIAGONAL not in curves:
            return {}
        if isinstance(self.inner, TextureDescriptors):
            lines = [curves[f"autocorrelation_{axis}"] for axis in "yx"]
            far = min(map(len, lines))
            axial = np.mean([line[:far] for line in lines], axis=0)
            return {"texture_preference": preference_of(axial, curves[_DIAGONAL])}
        return {
            "axis_preference": preference(
                (curves["two_point_axis_y"] + curves["two_point_axis_x"]) / 2, curves[_DIAGONAL]
            )
        }


def reach_of(picture: Image, r_max: int) -> int:
    """How far a picture's covariance says something: three correlation lengths, `r_max` at most.
    Beyond, lines along axes and along diagonals differ by chance alone."""
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
    """Of those that exist, such as the thickness of slices that hold some of the phase."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
