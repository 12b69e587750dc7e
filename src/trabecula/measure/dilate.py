"""Dilation across the faces of voxels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def dilate(inside: np.ndarray, steps: int = 1, *, wraps: Sequence[bool] = ()) -> np.ndarray:
    """Mark what is at most so many steps across faces from a bool array, too; along axes that wrap
    also across the faces of the array.
    """
    found = inside.copy()
    for _ in range(steps):
        before = found.copy()
        for axis in range(inside.ndim):
            near, far = np.moveaxis(before, axis, 0), np.moveaxis(found, axis, 0)
            far[1:] |= near[:-1]
            far[:-1] |= near[1:]
            if wraps and wraps[axis]:
                far[0] |= near[-1]
                far[-1] |= near[0]
    return found
