"""Parts of a scan that overlap or touch, and how many independent ones they stand for.

Let the variance of a mean over a volume V fall as V to the power -a (see `report.band`). Then means
over boxes are increments of a fractional Brownian sheet, and along one axis two boxes of width w
that lie d apart have the correlation

    rho(k) = (|k + 1|^2H - 2 |k|^2H + |k - 1|^2H) / 2,   k = d / w,   2H = 2 - a

(Mandelbrot and Van Ness 1968, doi:10.1137/1010093, section 5); over several axes it is the product.
With a = 1 that is the share of voxels that two boxes have in common, and boxes that touch are
independent; with a < 1 they are not.

With R the correlation of n values, C = 1 - J / n and s^2 their sample variance:

    E[s^2] = sigma^2 tr(C R) / (n - 1)
    degrees of freedom of s^2 = tr(C R)^2 / tr(C R C R)
    variance of their mean = sigma^2 1'R1 / n^2,  so that n^2 / 1'R1 independent values have it

(the degrees of freedom by Satterthwaite 1946, doi:10.2307/3002019).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

Box = tuple[slice, ...]

ENOUGH = 27
"""Boxes side by side beyond which none overlap: more would cost time and say little more."""


def spread_boxes(shape: Sequence[int], sides: Sequence[int]) -> list[Box]:
    """Return boxes of these sides evenly spread over a volume, from face to face.

    They overlap by half where fewer than `ENOUGH` fit side by side: overlapping parts know a spread
    better than parts side by side do. None where a box does not fit.
    """
    if any(side > length for side, length in zip(sides, shape, strict=True)):
        return []
    beside = np.prod([length // side for length, side in zip(shape, sides, strict=True)])
    choices = []
    for length, side in zip(shape, sides, strict=True):
        step = side if beside >= ENOUGH else max(1, side // 2)
        count = 1 + (length - side) // step
        if count == 1 and length > side:
            count = 2
        starts = [n * (length - side) // max(1, count - 1) for n in range(count)]
        choices.append([slice(start, start + side) for start in starts])
    return list(product(*choices))


def correlate_boxes(boxes: Sequence[Box], exponent: float) -> np.ndarray:
    """Return the correlations of means over boxes of one shape, (n, n)."""
    found = np.ones((len(boxes), len(boxes)))
    for axis in range(len(boxes[0]) if boxes else 0):
        starts = np.array([box[axis].start for box in boxes])
        width = boxes[0][axis].stop - boxes[0][axis].start
        apart = np.abs(starts[:, None] - starts) / width
        power = 2 - exponent
        found *= ((apart + 1) ** power + np.abs(apart - 1) ** power) / 2 - apart**power
    return found


def join_blocks(blocks: Sequence[np.ndarray]) -> np.ndarray:
    """Return the correlations of several groups of values that are independent of each other."""
    found = np.zeros((sum(map(len, blocks)),) * 2)
    start = 0
    for block in blocks:
        end = start + len(block)
        found[start:end, start:end] = block
        start = end
    return found


@dataclass(frozen=True)
class CorrelatedSample:
    """Values with known correlations."""

    values: np.ndarray
    correlation: np.ndarray
    """(n, n), of these values."""

    @classmethod
    def independent(cls, values: Sequence[float]) -> CorrelatedSample:
        """Return a sample of independent values."""
        return cls(np.asarray(values, np.float64), np.eye(len(values)))

    def choose(self, which: np.ndarray) -> CorrelatedSample:
        """Return some of the values, by their places or a mask."""
        places = np.flatnonzero(which) if which.dtype == bool else which
        return CorrelatedSample(self.values[places], self.correlation[np.ix_(places, places)])

    @property
    def mean(self) -> float:
        """Return the mean."""
        return float(self.values.mean())

    @property
    def deviation(self) -> float:
        """Return the standard deviation of the population, freed of what correlation takes away."""
        if np.ptp(self.values) == 0:  # a mean of equal values may be a rounding off them
            return 0.0
        rest = float(((self.values - self.values.mean()) ** 2).sum())
        return float(np.sqrt(rest / self._moments[0])) if self._moments[0] > 0 else 0.0

    @property
    def freedom(self) -> float:
        """Return the degrees of freedom of the variance."""
        first, second = self._moments
        return first**2 / second if second > 0 else 0.0

    @property
    def count(self) -> float:
        """Return how many independent values have a mean as uncertain as this one."""
        return len(self.values) ** 2 / float(self.correlation.sum())

    @property
    def error(self) -> float:
        """Return the standard error of the mean."""
        return self.deviation / float(np.sqrt(self.count))

    @cached_property
    def _moments(self) -> tuple[float, float]:
        """Return tr(C R) and tr(C R C R)."""
        rows = self.correlation - self.correlation.mean(axis=0)
        centred = rows - rows.mean(axis=1, keepdims=True)
        return float(np.trace(centred)), float((centred * centred.T).sum())
