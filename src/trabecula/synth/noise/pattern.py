"""Patterns on a lattice, made brick by brick in threads: Perlin noise, cubes, and those of
`points`; and white noise.

The level at which a pattern is cut follows from a trial, or from a thickness.

Perlin noise blends slopes at the corners of a lattice, in octaves; each has half the length of the
one before and less weight. Perlin (2002), *Improving noise*, doi:10.1145/566654.566636: the blend
6 t^5 - 15 t^4 + 10 t^3. The slopes are drawn anew at every corner, of all directions, where the
paper takes one of twelve. Gradients have 5 bits, positions 12 and weights 10: float64 rounds no
product or sum of them. Symbols: g a gradient, t the position in a cell (0 .. 1), w the weight of a
cell's upper corner.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from itertools import product

import numpy as np

from trabecula.core.seeds import key
from trabecula.engine.blocks import Box
from trabecula.engine.compile import inline, kernel
from trabecula.engine.memory import Stage
from trabecula.engine.parallel import for_slabs, thread_count
from trabecula.engine.random import below, philox
from trabecula.synth.noise.config import WALLED, NoiseConfig
from trabecula.synth.noise.lattice import (
    APART,
    CELL,
    Axis,
    VoxelGrid,
    grid_of,
    scatter_grid,
    shortest,
    wrap,
)
from trabecula.synth.noise.points import WALL, voronoi, voronoi_cells, voronoi_edges, worley
from trabecula.synth.shared.gaussian.domain import Domain, Use


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


@kernel
def cube_words(values, key, cz, cy, cx):
    """Fill (Z, Y, X) int32 with random whole numbers 0 .. 2**31 - 1 of the voxels' cubes.

    One draw serves four cubes.
    """
    for z in range(values.shape[0]):
        for y in range(values.shape[1]):
            group = np.int64(-1) << np.int64(40)
            w = philox(key, 0, 0, 0, 0)
            row = values[z, y]
            for x in range(len(row)):
                cell = cx[x]
                if cell >> 2 != group:
                    group = cell >> 2
                    w = philox(key, cz[z], cy[y], group, 0)
                at = cell & 3
                word = w[0] if at == 0 else w[1] if at == 1 else w[2] if at == 2 else w[3]
                row[x] = np.int32(word >> np.uint64(1))


def white(values: np.ndarray, grid: VoxelGrid, seed: int, config: NoiseConfig, most: float) -> None:
    """Fill `values` (Z, Y, X) int32 with a random number of every cube, 0 .. 2**31 - 1."""
    cube_words(values, key(seed, "noise/white"), *(_cube_numbers(axis) for axis in grid.axes()))


def _cube_numbers(axis: Axis) -> np.ndarray:
    """Return the cube of every voxel, wrapped along an axis that repeats."""
    cells = axis.first + axis.cell
    return cells % axis.period if axis.period else cells


Fill = Callable[[np.ndarray, VoxelGrid, int, NoiseConfig, float], None]
"""Function that writes the numbers of a grid's voxels for a seed into (Z, Y, X) int32, high where
void is. Above the last argument any number above it will do.
"""

PATTERNS: dict[str, tuple[Fill, int]] = {
    "perlin": (perlin, 0),
    "voronoi": (voronoi, 0),
    "voronoi_cells": (voronoi_cells, 1 << 24),
    "voronoi_edges": (voronoi_edges, 0),
    "white": (white, 1 << 31),
    "worley": (worley, 0),
}
"""Function of a pattern, and the count of its numbers, all equally frequent; 0 where only a trial
finds the level.
"""

_BRICK = (32, 64, 256)
_CELLS = (4, 8, 32)  # in a brick, at most, where the neighbours of every point are held
_TRIAL = {False: (96, 96, 96), True: (1, 940, 940)}  # voxels, of volumes and of pictures
_TRIAL_SEED = 0
_HELD = {"white": 8, "perlin": 24}  # bytes a voxel of a brick; of points
_VOXEL = 28
_POINT = {
    "voronoi": 5050,
    "voronoi_edges": 5050,
    "voronoi_cells": 40,
    "worley": 40,
}  # bytes a point in a brick and around it


class LatticePattern:
    """One pattern.

    Parameters
    ----------
    config : NoiseConfig
    edges, spacing : three floats
        Of a cell and of a voxel, along z, y, x.
    flat : bool
        Whether pictures are made.
    """

    def __init__(
        self, config: NoiseConfig, edges: Sequence[float], spacing: Sequence[float], *, flat: bool
    ) -> None:
        self.config = config
        self.edges = tuple(edges)
        self.step = tuple(voxel / edge for voxel, edge in zip(spacing, edges, strict=True))
        self.flat = flat
        self._choices = PATTERNS[config.kind][1]

    def each(
        self, number: int, domain: Domain, box: Box, use: Use, *, most: float = np.inf
    ) -> None:
        """Make the pattern in a box: `use(piece, z, plane)` gets its planes brick by brick."""
        whole, sides = grid_of(domain, box, self.step, self.edges), _sides(self.config, self.step)

        def slab(start: int, stop: int) -> None:
            for brick in _bricks((stop - start, *whole.shape[1:]), sides):
                piece = (slice(start + brick[0].start, start + brick[0].stop), *brick[1:])
                values = _fill(self.config, whole.part(piece), domain.seed, most)
                for z, plane in enumerate(values):
                    use(piece, z, plane)

        for_slabs(slab, whole.shape[0])

    def level(self, number: int, share: float) -> float:
        """Return the level for a share above it, or for the thickness of the settings."""
        if self.config.thickness is not None:
            return float(
                np.floor(
                    0.5 * self.config.thickness / shortest(self.edges, flat=self.flat) * CELL * WALL
                )
            )
        if self._choices:
            return round((1 - share) * self._choices) - 0.5
        return trial_level(self.config, self.step, self.edges, share, flat=self.flat)

    def stages(self, shape: Sequence[int]) -> tuple[Stage, ...]:
        """Return the stages of making a box (Z, Y, X): bricks, and the trial that finds a level."""
        sides = [min(pair) for pair in zip(_sides(self.config, self.step), shape, strict=True)]
        bricks = thread_count() * _brick_bytes(self.config, sides, self.step)
        if self._choices or self.config.thickness is not None:
            return (Stage("bricks", {}, bricks),)
        step = [max(width, APART) for width in self.step]
        trial = _brick_bytes(self.config, _sides(self.config, step), step) + 12 * int(
            np.prod(_TRIAL[self.flat])
        )
        return Stage("trial", {}, trial), Stage("bricks", {}, bricks)


@lru_cache(maxsize=64)
def trial_level(
    config: NoiseConfig,
    step: tuple[float, ...],
    edges: tuple[float, ...],
    share: float,
    *,
    flat: bool,
) -> float:
    """Return the level above which a pattern has the share, from the same many cells always."""
    grid, values = scatter_grid(step, edges, _TRIAL[flat], flat=flat), []
    for brick in _bricks(grid.shape, _sides(config, [max(width, APART) for width in step])):
        values.append(_fill(config, grid.part(brick), _TRIAL_SEED, np.inf).ravel())
    found = np.concatenate(values)
    place = min(max(round((1 - share) * len(found)), 1), len(found) - 1)
    return float(np.partition(found, place)[place]) - 0.5


def _fill(config: NoiseConfig, grid: VoxelGrid, seed: int, most: float) -> np.ndarray:
    """Return the numbers of a pattern on a grid."""
    values = np.empty(grid.shape, np.int32)
    PATTERNS[config.kind][0](values, grid, seed, config, most)
    return values


def _sides(config: NoiseConfig, step: Sequence[float]) -> tuple[int, ...]:
    """Return the sides of a brick in voxels."""
    if config.kind not in WALLED:
        return _BRICK
    return tuple(
        max(1, min(side, int(most / width)))
        for side, most, width in zip(_BRICK, _CELLS, step, strict=True)
    )


def _brick_bytes(config: NoiseConfig, sides: Sequence[int], step: Sequence[float]) -> int:
    """Return the memory of making a brick."""
    cells = [int(side * width) + 10 for side, width in zip(sides, step, strict=True)]
    voxel, point = _HELD.get(config.kind, _VOXEL), _POINT.get(config.kind, 0)
    return voxel * int(np.prod(sides)) + point * int(np.prod(cells))


def _bricks(shape: Sequence[int], sides: Sequence[int]) -> Iterator[tuple[slice, ...]]:
    """Return the bricks of a box."""
    cuts = [
        [slice(first, min(first + side, end)) for first in range(0, end, side)]
        for end, side in zip(shape, sides, strict=True)
    ]
    return product(*cuts)
