"""Tests of two small samples: ranks, spread and mean, and the correction for many tests.

Ranks do not know the distribution that values come from, but they know dependence: real parts of
one scan that overlap or touch are alike. So the p values of rank tests are shares of fixed draws of
normal values with the correlations that the samples have. Without correlations that is the
permutation distribution, and the p values are those of the exact tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from trabecula.numerics.quantiles import student_tail, variance_ratio, variance_ratio_tail
from trabecula.report.dependence import CorrelatedSample

DRAWS = 1 << 15
"""Draws of a rank test: the least p value is one over this."""
_BLOCK = 1 << 12

HEAVIEST = 12.0
"""Largest kurtosis that is believed of a small sample."""


def kolmogorov_smirnov(first: np.ndarray, second: np.ndarray) -> float:
    """Return the largest distance between the empirical distributions of two samples.

    Conover 1999, Practical Nonparametric Statistics, section 6.3.
    """
    everything = np.concatenate([first, second])
    shares = [
        np.searchsorted(np.sort(values), everything, side="right") / len(values)
        for values in (first, second)
    ]
    return float(np.abs(shares[0] - shares[1]).max())


def mann_whitney(first: np.ndarray, second: np.ndarray) -> float:
    """Return U over the number of pairs, less one half: 0 where no sample is larger.

    Mann and Whitney 1947, doi:10.1214/aoms/1177730491; pairs of equal values count one half.
    """
    larger = np.sign(first[:, None] - second)
    return float(larger.mean()) / 2


class RankTests:
    """Rank tests of two samples of fixed correlations.

    Parameters
    ----------
    first, second : (n, n) and (m, m) array
        Correlations among the values of each sample; those of both are independent of each other.
    """

    def __init__(self, first: np.ndarray, second: np.ndarray) -> None:
        self.roots = [_root(first), _root(second)]

    def kolmogorov_smirnov(self, first: np.ndarray, second: np.ndarray) -> float:
        """Return the p value of the Kolmogorov-Smirnov test, two-sided."""
        return _share_above(self._draws[0], kolmogorov_smirnov(first, second))

    def mann_whitney(self, first: np.ndarray, second: np.ndarray) -> float:
        """Return the p value of the Mann-Whitney test, two-sided."""
        return _share_above(self._draws[1], abs(mann_whitney(first, second)))

    @cached_property
    def _draws(self) -> tuple[np.ndarray, np.ndarray]:
        """Draw both statistics for samples of one population, sorted."""
        rng = np.random.default_rng(0)
        n, m = (len(root) for root in self.roots)
        steps = np.r_[np.full(n, 1 / n), np.full(m, -1 / m)]
        found: list[tuple[np.ndarray, np.ndarray]] = []
        for _ in range(DRAWS // _BLOCK):
            values = np.concatenate(
                [rng.standard_normal((_BLOCK, len(root))) @ root.T for root in self.roots], axis=1
            )
            order = np.argsort(values, axis=1)
            distance = np.abs(np.cumsum(steps[order], axis=1)).max(axis=1)
            ranks = np.where(order < n, np.arange(n + m), 0).sum(axis=1)
            pairs = ranks - n * (n - 1) / 2
            found.append((distance, np.abs(pairs / (n * m) - 0.5)))
        one, other = (np.sort(np.concatenate(each)) for each in zip(*found, strict=True))
        return one, other


def _root(correlation: np.ndarray) -> np.ndarray:
    """Return a matrix whose square is the correlation; rounding may leave eigenvalues below 0."""
    values, vectors = np.linalg.eigh(correlation)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _share_above(draws: np.ndarray, found: float) -> float:
    """Return the share of draws as large as what was found, which counts as one of them."""
    above = len(draws) - int(np.searchsorted(draws, found - 1e-9))
    return (above + 1) / (len(draws) + 1)


def tail_share(*samples: CorrelatedSample) -> float:
    """Return the factor on the degrees of freedom of variances: below 1 where tails are heavy.

    Shoemaker 2003, "Fixing the F test for equal variances", doi:10.1198/0003130031441, with one
    kurtosis for all samples.
    """
    known = [each.values for each in samples if each.deviation > 0]
    if not known:
        return 1.0
    kurtosis = float(np.average([_kurtosis(each) for each in known], weights=list(map(len, known))))
    return 2 / (min(max(kurtosis, 3.0), HEAVIEST) - 1)


def _kurtosis(values: np.ndarray) -> float:
    rest = values - values.mean()
    return float((rest**4).mean() / (rest**2).mean() ** 2)


def spread_p(ratio: float, freedoms: tuple[float, float]) -> float:
    """Return the p value of a ratio of two standard deviations, two-sided."""
    return variance_ratio_tail(*freedoms, ratio**2)


def spread_interval(
    ratio: float, freedoms: tuple[float, float], confidence: float
) -> tuple[float, float]:
    """Return the interval of a ratio of two standard deviations."""
    low, high = (variance_ratio(*freedoms, (1 + sign * confidence) / 2) ** 0.5 for sign in (-1, 1))
    return ratio / high, ratio / low


def mean_p(difference: float, error: float, freedom: float) -> float:
    """Return the p value of a difference of means, two-sided."""
    if error <= 0:
        return student_tail(1.0, 0.0 if difference == 0 else np.inf)
    return student_tail(freedom, abs(difference) / error)


def welch_freedom(errors: Sequence[float], freedoms: Sequence[float]) -> float:
    """Return the degrees of freedom of a sum of squared errors (Welch 1947, doi:10.2307/2332510)"""
    squares = np.square(errors)
    parts = float(sum(squares**2 / np.maximum(freedoms, 1e-9)))
    return float(squares.sum() ** 2 / parts) if parts > 0 else float(max(freedoms))


def adjust(p_values: Sequence[float]) -> list[float]:
    """Return p values corrected for the number of tests, in their order.

    Benjamini and Hochberg 1995, doi:10.1111/j.2517-6161.1995.tb02031.x: where nothing is wrong at
    all, any of them is below 0.05 once in 20 times; where much is, one in 20 of those below is
    chance.
    """
    values = np.asarray(p_values, np.float64)
    order = np.argsort(values)[::-1]
    ranks = np.arange(len(values), 0, -1)
    found = np.empty(len(values))
    found[order] = np.minimum.accumulate(np.minimum(values[order] * len(values) / ranks, 1.0))
    return [float(value) for value in found]
