"""Patterns on a lattice, made brick by brick in threads, and white noise.

The level at which a pattern is cut follows from a trial, or from a thickness.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from itertools import product

import numpy as np

from trabecula.core.seeds import key
from trabecula.engine.blocks import Box
from trabecula.engine.compile import kernel
from trabecula.engine.memory import Stage
from trabecula.engine.parallel import for_slabs, thread_count
from trabecula.engine.random import philox
from trabecula.synth.noise.config import WALLED, NoiseConfig
from trabecula.synth.noise.lattice import (
    APART,
    CELL,
    Axis,
    VoxelGrid,
    grid_of,
    scatter_grid,
    shortest,
)
from trabecula.synth.noise.periodic_domain import Domain, Use
from trabecula.synth.noise.perlin import perlin
from trabecula.synth.noise.points import WALL, voronoi, voronoi_cells, voronoi_edges, worley


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
