"""Real parts of the members' size, and what members of their material are expected to be like.

Where exemplars are larger than the members, their parts are the real distribution. Where they are
not, the spread of smaller parts is extrapolated to the members' size (`report.band.Sizes`), and
their mean is the exemplar's own value, which the exemplar's own size makes uncertain.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image, with_values
from trabecula.measure.streaming.cells import cells_of
from trabecula.report.band import LEAST_COUNT, LEAST_PART, Sizes, expected_value
from trabecula.report.dependence import (
    Box,
    CorrelatedSample,
    correlate_boxes,
    join_blocks,
    spread_boxes,
)
from trabecula.report.ensemble_figures import EnsembleFigures, is_one_sided
from trabecula.report.evenness import (
    choose_windows,
    measure_evenness,
    phases_of,
    scaling_exponent,
)


@dataclass(frozen=True)
class Expected:
    """One figure of real material of the members' size."""

    mean: float
    error: float
    """Standard error of the mean."""
    deviation: float
    least_deviation: float
    """Extrapolated as if parts were independent; the same where nothing is extrapolated."""
    freedom: float
    """Degrees of freedom of the deviation."""
    sample: CorrelatedSample | None = None
    """Real parts; None where none is as large as the members."""


class RealParts:
    """Parts of exemplars, measured.

    Parameters
    ----------
    exemplars : sequence of Image
    figures : EnsembleFigures
    shape : sequence of int
        Of the members.

    Raises
    ------
    InputError
        Parts too few to know a spread.
    """

    def __init__(
        self, exemplars: Sequence[Image], figures: EnsembleFigures, shape: Sequence[int]
    ) -> None:
        self.exemplars, self.members = exemplars, tuple(shape)
        self.exponent = float(np.mean([_exponent(exemplar) for exemplar in exemplars]))
        self.shape = self.members
        self.boxes = [spread_boxes(exemplar.shape, shape) for exemplar in exemplars]
        self.extrapolated = _independent(self.boxes) < LEAST_COUNT
        if self.extrapolated:
            self.shape = _smaller(exemplars, shape)
            self.boxes = [spread_boxes(exemplar.shape, self.shape) for exemplar in exemplars]
        held = sum(float(np.prod(exemplar.shape)) for exemplar in exemplars)
        if self.extrapolated and held < LEAST_COUNT * np.prod(self.shape):
            raise InputError(_too_few(exemplars, shape))
        cut = [
            _cut(exemplar, box)
            for exemplar, boxes in zip(exemplars, self.boxes, strict=True)
            for box in boxes
        ]
        self.found = figures.measure_all(cut, "measuring real parts")
        self.own = [figures.measure(each) for each in exemplars] if self.extrapolated else []
        groups = [np.full(len(boxes), n) for n, boxes in enumerate(self.boxes)]
        self.exemplar_of = np.concatenate(groups)
        self.overlap = join_blocks([correlate_boxes(boxes, 1.0) > 0 for boxes in self.boxes]) > 0

    def _outline(self) -> CorrelatedSample:
        """Return a sample without values, for its correlations."""
        blocks = [correlate_boxes(boxes, self.exponent) for boxes in self.boxes if boxes]
        correlation = join_blocks(blocks)
        return CorrelatedSample(np.zeros(len(correlation)), correlation)

    @property
    def count(self) -> int:
        """Return the number of parts."""
        return len(self.found)

    @property
    def independent(self) -> float:
        """Return how many independent parts know the mean as well."""
        return self._outline().count

    @property
    def freedom(self) -> float:
        """Return the degrees of freedom of the parts' variance."""
        return self._outline().freedom

    def names(self) -> list[str]:
        """Return the figures that enough of the parts have; where sizes are extrapolated, those
        alone that are means over the volume. The share of the largest component is none.
        """
        return [
            name
            for name in self.found[0]
            if self.known(name).sum() >= LEAST_COUNT
            and not (self.extrapolated and is_one_sided(name))
        ]

    def known(self, name: str) -> np.ndarray:
        """Return which parts have a figure."""
        return np.array([found[name] is not None for found in self.found])

    def sample(self, name: str) -> CorrelatedSample:
        """Return a figure of the parts that have it."""
        known = self.known(name)
        values = np.array([found[name] for found in self.found], np.float64)
        return replace(self._outline(), values=values).choose(known)

    def expected(self, name: str) -> Expected:
        """Return what is expected of a figure at the members' size."""
        sample = self.sample(name)
        return self._extrapolate(name, sample) if self.extrapolated else expect(sample)

    def _extrapolate(self, name: str, sample: CorrelatedSample) -> Expected:
        part, image = (float(np.prod(shape)) for shape in (self.shape, self.members))
        wholes = np.array([float(np.prod(exemplar.shape)) for exemplar in self.exemplars])
        owner = self.exemplar_of[self.known(name)]
        means, owns, errors, weights = [], [], [], []
        for n, (whole, own) in enumerate(zip(wholes, self.own, strict=True)):
            value, inside = own[name], sample.values[owner == n]
            if value is None or not len(inside):
                continue
            sizes = Sizes(part, whole, image, len(self.members), self.exponent)
            means.append(expected_value(inside.tolist(), value, sizes))
            owns.append(value)
            errors.append(sizes.variance(whole))
            weights.append(whole)
        mean, own_mean = (float(np.average(each, weights=weights)) for each in (means, owns))
        share = np.array(weights) / np.sum(weights)
        # The faces' bias is extrapolated as well, and believed to within one half.
        error = math.hypot(
            sample.deviation * math.sqrt(float(share**2 @ np.array(errors))), (mean - own_mean) / 2
        )
        deviations = [
            sample.deviation * (part / image) ** (exponent / 2) for exponent in (self.exponent, 1.0)
        ]
        return Expected(mean, error, deviations[0], min(deviations), sample.freedom)

    def halves(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield pairs of masks of parts that share no voxel: both ends of every exemplar along each
        axis, and every exemplar and the others.
        """
        for n, exemplar in enumerate(self.exemplars):
            for axis, side in enumerate(exemplar.shape):
                low, high = (np.zeros(self.count, bool) for _ in range(2))
                for place, box in zip(
                    np.flatnonzero(self.exemplar_of == n), self.boxes[n], strict=True
                ):
                    low[place] = 2 * box[axis].stop <= side
                    high[place] = 2 * box[axis].start >= side
                yield low, high
            if len(self.exemplars) > 1:
                yield self.exemplar_of == n, self.exemplar_of != n


def expect(sample: CorrelatedSample) -> Expected:
    """Return what is expected of members that are like the parts of a sample."""
    return Expected(
        sample.mean, sample.error, sample.deviation, sample.deviation, sample.freedom, sample
    )


def _exponent(exemplar: Image) -> float:
    """Return how fast the variance of means falls with the volume, at the slowest of the phases."""
    windows = choose_windows(exemplar, [exemplar])
    if windows is None:
        return 1.0
    found = measure_evenness(cells_of(exemplar, cell=windows.cell), windows, phases_of(exemplar))
    return min(map(scaling_exponent, found.values()), default=1.0)


def _smaller(exemplars: Sequence[Image], shape: Sequence[int]) -> tuple[int, ...]:
    """Return the shape of parts from which is extrapolated: halves, no larger than members."""
    sides = zip(*(exemplar.shape for exemplar in exemplars), strict=True)
    return tuple(
        max(LEAST_PART, min(side, *(length // 2 for length in lengths)))
        for side, lengths in zip(shape, sides, strict=True)
    )


def _independent(boxes: Sequence[Sequence[Box]]) -> float:
    """Count how many boxes side by side know a mean as well as these do."""
    correlation = join_blocks([correlate_boxes(each, 1.0) for each in boxes])
    return len(correlation) ** 2 / float(correlation.sum()) if len(correlation) else 0.0


def _cut(exemplar: Image, box: Box) -> Image:
    return with_values(exemplar, np.ascontiguousarray(exemplar.values[box]))


def _too_few(exemplars: Sequence[Image], shape: Sequence[int]) -> str:
    sizes = " and ".join(" x ".join(map(str, exemplar.shape)) for exemplar in exemplars)
    least = " x ".join([str(2 * LEAST_PART)] * len(shape))
    wanted = " x ".join(str(2 * side) for side in shape)
    return (
        f"too few real parts: {sizes} voxels hold fewer than {LEAST_COUNT} of {LEAST_PART} voxels "
        f"a side beside each other, so that no spread is known; give a scan of at least {least} "
        f"({wanted} for parts as large as the members), or further scans of the material (--parts)"
    )
