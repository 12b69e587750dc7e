"""Perlin noise: slopes at the corners of a lattice, blended between them; octaves of half the
length and less weight.

Perlin (2002), *Improving noise*, doi:10.1145/566654.566636: the blend 6 t^5 - 15 t^4 + 10 t^3. The
slopes are drawn anew at every corner, of all directions, where the paper takes one of twelve.
"""

from __future__ import annotations

import numpy as np

from trabecula.core.seeds import key
from trabecula.synth.noise.config import NoiseConfig
from trabecula.synth.noise.lattice import Axis, Grid
from trabecula.synth.noise.perlin_kernels import add_octave, corner_gradients

_ONE = 1 << 16
"""What stands for 1 in the sum of octaves."""

_WEIGHTS = 1024.0


def perlin(values: np.ndarray, grid: Grid, seed: int, config: NoiseConfig, most: float) -> None:
    """The sum of octaves, (Z, Y, X) int32."""
    values[:] = 0
    for number in range(config.octaves):
        axes = grid.axes(finer=1 << number)
        # A corner more than cells, but along an axis that is not there.
        gradients = np.empty((*(axis.cells + (not axis.flat) for axis in axes), 3))
        first, periods = (
            np.array([getattr(axis, name) for axis in axes], np.int64)
            for name in ("first", "period")
        )
        corner_gradients(gradients, key(seed, f"noise/perlin/{number}"), first, periods)
        cz, cy, cx = (axis.cell for axis in axes)
        tz, ty, tx = (axis.inside for axis in axes)
        wz, wy, wx = (_blend(axis) for axis in axes)
        weight = float(round(_ONE * config.persistence**number))
        add_octave(values, gradients, cz, cy, cx, tz, ty, tx, wz, wy, wx, weight)


def _blend(axis: Axis) -> np.ndarray:
    """The weight of the upper corner at every voxel, 0 .. 1, in whole parts."""
    t = axis.inside
    return np.asarray(np.rint(t * t * t * (t * (t * 6 - 15) + 10) * _WEIGHTS) / _WEIGHTS)
