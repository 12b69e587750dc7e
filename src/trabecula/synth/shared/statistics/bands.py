"""Gauss and Newton in few directions: which ones, how much of each, and how far in all."""

from __future__ import annotations

import math

import numpy as np

BANDS = (1, 2, 3, 5, 8, 12)
"""Where the bands of distances begin, voxels; the last one reaches to r_max."""

_RIDGE = 1e-3
_LENGTHS = np.arange(1, 33) / 16  # of a step, in steps of Gauss and Newton


def split_into_bands(push: np.ndarray) -> list[np.ndarray]:
    """What to push at every distance, one array a band, scaled to its largest; bands without any
    are left out.
    """
    r = np.arange(len(push)) % (len(push) // 3)
    bands = []
    for low, high in zip(BANDS, (*BANDS[1:], len(push)), strict=True):
        part = np.where((r >= low) & (r < high), push, 0.0)
        if part.any():
            bands.append(part / np.abs(part).max())
    return bands


def least_squares(changes: np.ndarray, excess: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """How much of each change takes the excess away best; exact sums and no LAPACK, so the same
    everywhere.
    """
    count = len(changes)

    def dot(a: np.ndarray, b: np.ndarray) -> float:
        return math.fsum((a * b * weights).tolist())

    matrix = [
        [dot(changes[i], changes[j]) for j in range(count)] + [-dot(changes[i], excess)]
        for i in range(count)
    ]
    for i in range(count):
        matrix[i][i] = matrix[i][i] * (1 + _RIDGE) + 1e-300
    for i in range(count):  # symmetric and positive definite: the diagonal serves as it comes
        for j in range(i + 1, count):
            factor = matrix[j][i] / matrix[i][i]
            matrix[j] = [a - factor * b for a, b in zip(matrix[j], matrix[i], strict=True)]
    shares = [0.0] * count
    for i in reversed(range(count)):
        known = math.fsum(matrix[i][j] * shares[j] for j in range(i + 1, count))
        shares[i] = (matrix[i][-1] - known) / matrix[i][i]
    return np.array(shares)


def best_length(
    excess: np.ndarray, change: np.ndarray, square: np.ndarray, weights: np.ndarray
) -> float:
    """The step, of a few lengths, that leaves least: a move by a changes the curve by a change +
    a^2 square.
    """
    left = excess + _LENGTHS[:, None] * change + _LENGTHS[:, None] ** 2 * square
    return float(_LENGTHS[np.argmin((left**2 * weights).sum(axis=1))])
