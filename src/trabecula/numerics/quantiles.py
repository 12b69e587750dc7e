"""Student's t and Fisher's F: quantiles and p values, without a statistics library.

Both follow from the regularised incomplete beta function I_x(a, b) (Abramowitz and Stegun 1964,
26.5, 26.6.2 and 26.7.1), which is computed by its continued fraction (26.5.8).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

_TINY = 1e-300
_STEPS = 500
"""Most terms of the fraction: far beyond what degrees of freedom below a thousand need."""


@lru_cache
def student(freedom: float, level: float) -> float:
    """Return the quantile of Student's t distribution, of a level above one half."""
    return _solve(lambda t: 1 - student_tail(freedom, t) / 2, level)


def student_tail(freedom: float, distance: float) -> float:
    """Return the p value of Student's t, two-sided: at least that far from 0."""
    if math.isinf(distance):
        return 0.0
    return _incomplete_beta(freedom / 2, 0.5, freedom / (freedom + distance**2))


@lru_cache
def variance_ratio(upper: float, lower: float, level: float) -> float:
    """Return the quantile of Fisher's F distribution, the ratio of two variances of one
    population.
    """
    return _solve(lambda ratio: _below(upper, lower, ratio), level)


def variance_ratio_tail(upper: float, lower: float, ratio: float) -> float:
    """Return the p value of a ratio of two variances, two-sided: at least that far from 1."""
    below = _below(upper, lower, ratio)
    return 2 * min(below, 1 - below)


def variance_ratio_share(upper: float, lower: float, factor: float) -> float:
    """Return the probability that two sample variances of one population differ by no more than a
    factor.
    """
    return _below(upper, lower, factor) - _below(upper, lower, 1 / factor)


def _below(upper: float, lower: float, ratio: float) -> float:
    """Return the probability of a ratio of two variances below this one."""
    if math.isinf(ratio):
        return 1.0
    share = upper * ratio / (upper * ratio + lower)
    return _incomplete_beta(upper / 2, lower / 2, share)


def _solve(rising: Callable[[float], float], level: float) -> float:
    """Return where a rising function of a positive number reaches a level, by halving."""
    low, high = 0.0, 1.0
    while rising(high) < level and high < 1e12:
        low, high = high, 2 * high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if rising(middle) < level else (low, middle)
    return (low + high) / 2


def _incomplete_beta(a: float, b: float, x: float) -> float:
    """Return I_x(a, b)."""
    if x <= 0 or x >= 1:
        return float(x >= 1)
    if x > (a + 1) / (a + b + 2):  # the fraction converges fast on the other side
        return 1 - _incomplete_beta(b, a, 1 - x)
    scale = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)
    front = math.exp(scale + a * math.log(x) + b * math.log1p(-x)) / a
    # Lentz's algorithm: the fraction from its front, as a product of ratios.
    c, d = 1.0, 1 / _off_zero(1 - (a + b) * x / (a + 1))
    found = d
    for m in range(1, _STEPS):
        for term in (
            m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)),
            -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1)),
        ):
            d = 1 / _off_zero(1 + term * d)
            c = _off_zero(1 + term / c)
            found *= c * d
        if abs(c * d - 1) < 1e-15:
            break
    return front * found


def _off_zero(value: float) -> float:
    return value if abs(value) > _TINY else _TINY
