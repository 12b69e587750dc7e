"""Logarithms and exponentials as tables of whole numbers, so that every machine decides alike.

A logarithm is in units of 2^-16 to the base 2, read off the bits of a float64; a weight 2^(-s) is a
whole number of at most 2^31.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline

UNIT = 1 << 16
"""A factor of two in a density."""

_FINE = 4096
LOGS = np.rint(UNIT * np.log2(1 + (np.arange(_FINE) + 0.5) / _FINE)).astype(np.int64)
POWERS = np.rint(2.0**31 * 2.0 ** (-np.arange(_FINE) / _FINE)).astype(np.int64)

NEAREST_WEIGHT = 1 << 22
"""The weight of the exemplar's nearest neighbourhood; others weigh less, those below 1 nothing."""


def kernel_table(twice_variance: float, *, shift: int = 0) -> np.ndarray:
    """exp(-i 2^shift / (2 h^2)) times `NEAREST_WEIGHT`, rounded, for i = 0, 1, ... while it is at
    least 1, then a 0 (int32).

    The middle of a step counts where it is wider than 1.
    """
    step = 1 << shift
    count = int(np.log(NEAREST_WEIGHT * 2.0) * twice_variance / step) + 2
    differences = np.arange(count) * float(step) + (step - 1) / 2
    table = np.rint(NEAREST_WEIGHT * np.exp(-differences / twice_variance)).astype(np.int32)
    return np.ascontiguousarray(
        np.append(table[: max(1, int(np.count_nonzero(table)))], np.int32(0))
    )


def shift_for(twice_variance: float) -> int:
    """The width of a step, as a power of two, such that the table has about 8000 entries at most
    and stays in the cache.
    """
    shift = 0
    while np.log(NEAREST_WEIGHT * 2.0) * twice_variance > 8000 << shift:
        shift += 1
    return shift


def log_units(values: np.ndarray) -> np.ndarray:
    """log2 in units of 2^-16, rounded (int64), of positive values."""
    return np.rint(np.log2(values) * UNIT).astype(np.int64)


@inline
def log_of(bits, logs):
    """log2 in units of 2^-16 of a positive normal float64 given by its bits."""
    return ((bits >> 52) - 1023) * UNIT + logs[(bits >> 40) & (_FINE - 1)]


@inline
def power_of(units, powers):
    """2^(units / 2^16) times 2^31 as a whole number, units <= 0."""
    fall = -units
    whole = fall >> 16
    return powers[(fall >> 4) & (_FINE - 1)] >> whole if whole < 32 else 0
