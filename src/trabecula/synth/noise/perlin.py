"""Perlin noise: slopes at the corners of a lattice, blended between them, in octaves.

Each octave has half the length of the one before and less weight. Perlin (2002), *Improving noise*,
doi:10.1145/566654.566636: the blend 6 t^5 - 15 t^4 + 10 t^3. The slopes are drawn anew at every
corner, of all directions, where the paper takes one of twelve.

Gradients have 5 bits, positions 12 and weights 10: float64 rounds no product or sum of them.
Symbols: g a gradient, t the position in a cell (0 .. 1), w the weight of a cell's upper corner.
"""

from __future__ import annotations

import numpy as np

from trabecula.core.seeds import key
from trabecula.engine.compile import inline, kernel
from trabecula.engine.random import below, philox
from trabecula.synth.noise.config import NoiseConfig
from trabecula.synth.noise.lattice import Axis, VoxelGrid, wrap


@kernel
def corner_gradients(gradients, key, first, periods):
    """Fill (Z, Y, X, 3) float64 with gradients between 0.7 and 1 long.

    Their components are whole numbers -16 .. 16 over 16; one layer has no slope in z.
    """
    flat = gradients.shape[0] == 1
    for z in range(gradients.shape[0]):
        for y in range(gradients.shape[1]):
            for x in range(gradients.shape[2]):
                cz = wrap(first[0] + z, periods[0])
                cy, cx = wrap(first[1] + y, periods[1]), wrap(first[2] + x, periods[2])
                _draw(gradients[z, y, x], key, cz, cy, cx, flat)


@inline
def _draw(gradient, key, cz, cy, cx, flat):
    """Draw a gradient until its length fits, as about one draw in three does."""
    for attempt in range(64):
        w = philox(key, cz, cy, cx, attempt)
        gz = 0 if flat else below(w[0], 33) - 16
        gy, gx = below(w[1], 33) - 16, below(w[2], 33) - 16
        gradient[0], gradient[1], gradient[2] = gz / 16.0, gy / 16.0, gx / 16.0
        if 128 <= gz * gz + gy * gy + gx * gx <= 256:
            return


@inline
def _line(line, one, two, sz, ty, wy):
    """Blend the corners along x in y: their value at their own x, and their slope along x."""
    for x in range(len(line)):
        base = one[x, 0] * sz + one[x, 1] * ty
        line[x, 0] = base + wy * (two[x, 0] * sz + two[x, 1] * (ty - 1.0) - base)
        line[x, 1] = one[x, 2] + wy * (two[x, 2] - one[x, 2])


@kernel
def add_octave(values, gradients, cz, cy, cx, tz, ty, tx, wz, wy, wx, weight):
    """Add the blend of the corners' slopes times `weight`, rounded down, to (Z, Y, X) int32."""
    low, high = np.empty((gradients.shape[2], 2)), np.empty((gradients.shape[2], 2))
    for z in range(values.shape[0]):
        upper = min(cz[z] + 1, gradients.shape[0] - 1)
        for y in range(values.shape[1]):
            _line(low, gradients[cz[z], cy[y]], gradients[cz[z], cy[y] + 1], tz[z], ty[y], wy[y])
            _line(
                high,
                gradients[upper, cy[y]],
                gradients[upper, cy[y] + 1],
                tz[z] - 1.0,
                ty[y],
                wy[y],
            )
            for x in range(len(low)):
                low[x, 0] += wz[z] * (high[x, 0] - low[x, 0])
                low[x, 1] += wz[z] * (high[x, 1] - low[x, 1])
            row = values[z, y]
            for i in range(len(row)):
                c, t = cx[i], tx[i]
                left = low[c, 0] + low[c, 1] * t
                right = low[c + 1, 0] + low[c + 1, 1] * (t - 1.0)
                row[i] += np.int32(np.floor((left + wx[i] * (right - left)) * weight))


_ONE = 1 << 16
"""What stands for 1 in the sum of octaves."""

_WEIGHTS = 1024.0


def perlin(
    values: np.ndarray, grid: VoxelGrid, seed: int, config: NoiseConfig, most: float
) -> None:
    """Fill `values` (Z, Y, X) int32 with the sum of octaves."""
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
    """Return the weight of the upper corner at every voxel, 0 .. 1, in whole parts."""
    t = axis.inside
    return np.asarray(np.rint(t * t * t * (t * (t * 6 - 15) + 10) * _WEIGHTS) / _WEIGHTS)
