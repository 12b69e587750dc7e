"""White noise: a function of seed and coordinate alone."""

from __future__ import annotations

import math

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.random import philox

_UNIT = 1.0 / 4294967296.0


@kernel
def white_plane(plane, z, key):
    """Independent standard normal numbers (Box and Muller 1958) in plane z, (Y, X) float32: four voxels along x a draw."""
    width = plane.shape[1]
    for y in range(plane.shape[0]):
        for x in range(0, width, 4):
            w = philox(key, z, y, x >> 2, 0)
            for half in range(2):
                first, second = (w[0], w[1]) if half == 0 else (w[2], w[3])
                radius = math.sqrt(-2.0 * math.log((np.float64(first) + 0.5) * _UNIT))
                angle = 2.0 * math.pi * _UNIT * np.float64(second)
                at = x + 2 * half
                if at < width:
                    plane[y, at] = radius * math.cos(angle)
                if at + 1 < width:
                    plane[y, at + 1] = radius * math.sin(angle)
