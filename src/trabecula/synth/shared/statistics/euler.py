"""Euler numbers of fields: loops against bodies and cavities, of what lies above 0 and below."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.measure.configurations import count_cubes, cube_euler

_FACES = 6  # neighbours, of either phase


def euler_densities(fields: Sequence[np.ndarray]) -> np.ndarray:
    """Return the Euler number per voxel of what is above 0 in every channel of fields (C, Z, Y, X)
    int8 together, then of what is not, (2C,); neighbours share a face.
    """
    counts = sum(
        np.array([count_cubes(channel > 0, None) for channel in field]) for field in fields
    )
    assert isinstance(counts, np.ndarray)  # there is a field
    # a cube whose voxels change sides has the number 255 less its own
    sides = np.concatenate([counts, counts[:, ::-1]])
    eighths = np.rint(8 * cube_euler(_FACES)).astype(np.int64)
    return np.asarray(sides @ eighths / (8 * sides.sum(axis=1)))
