"""Euler numbers of fields: loops against bodies and cavities, of what lies above 0 and below."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.measure.configurations import count_cubes, cube_codes, cube_euler

_FACES = 6  # neighbours, of either phase


def euler_densities(
    fields: Sequence[np.ndarray], *, within: np.ndarray | None = None
) -> np.ndarray:
    """Return the Euler number per voxel of what is above 0 in every channel of fields (C, Z, Y, X)
    int8 together, then of what is not, (2C,); neighbours share a face.

    Where `within` (Z, Y, X) bool is given, of cubes of 2 x 2 x 2 voxels that lie in it.
    """
    counts = sum(
        np.array([count_cubes(channel > 0, within) for channel in field]) for field in fields
    )
    assert isinstance(counts, np.ndarray)  # there is a field
    return _numbers(counts) / max(1, counts[0].sum())


def euler_slopes(fields: Sequence[np.ndarray], weights: Sequence[np.ndarray]) -> np.ndarray:
    """Return how `euler_densities` change with t where places weigh 1 + t g, with weights g (Z, Y,
    X) of every field, (2C,).
    """
    weighted, total, size = np.zeros(2 * len(fields[0])), 0.0, 0
    for field, g in zip(fields, weights, strict=True):
        at = g[:-1, :-1, :-1].ravel().astype(np.float64)  # a cube weighs as its first voxel
        counts = [np.bincount(cube_codes(channel > 0).ravel(), at, 256) for channel in field]
        weighted += _numbers(np.array(counts))
        total += float(at.sum())
        size += at.size
    return np.asarray((weighted - total * euler_densities(fields)) / size)


def _numbers(counts: np.ndarray) -> np.ndarray:
    """Return the Euler numbers of both sides from the counts of the 256 cubes, (C, 256)."""
    # a cube whose voxels change sides has the number 255 less its own
    sides = np.concatenate([counts, counts[:, ::-1]])
    return np.asarray(sides @ np.rint(8 * cube_euler(_FACES)).astype(np.int64) / 8)
