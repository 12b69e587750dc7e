"""White noise: every cube of the lattice alone, solid or void by chance."""

from __future__ import annotations

import numpy as np

from trabecula.core.seeds import key
from trabecula.synth.noise.config import NoiseConfig
from trabecula.synth.noise.kernels import cube_words
from trabecula.synth.noise.lattice import Axis, Grid


def white(values: np.ndarray, grid: Grid, seed: int, config: NoiseConfig, most: float) -> None:
    """A random number of every cube, 0 .. 2**31 - 1, (Z, Y, X) int32."""
    cube_words(values, key(seed, "noise/white"), *(_numbers(axis) for axis in grid.axes()))


def _numbers(axis: Axis) -> np.ndarray:
    """The cube that every voxel is in, round an axis that repeats."""
    cells = axis.first + axis.cell
    return cells % axis.period if axis.period else cells
