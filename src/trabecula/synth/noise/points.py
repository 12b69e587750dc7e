"""Patterns of points, one in every cell of a lattice: Worley noise and Voronoi cells, walls and
edges.

Worley (1996), *A cellular texture basis function*, doi:10.1145/237170.237267: the distance to the
nearest point. Walls and edges take true distances to the planes half way between two points instead
of the difference of two distances, so that they are as thick everywhere.
"""

from __future__ import annotations

import numpy as np

from trabecula.core.seeds import key
from trabecula.synth.noise.config import NoiseConfig
from trabecula.synth.noise.lattice import CELL, Axis, Grid, Points, points_of, shortest
from trabecula.synth.noise.lattice_kernels import nearest
from trabecula.synth.noise.voronoi_kernels import plane_distance

WALL = 1024
"""Parts of a step in which the distance to a wall is counted."""

_WHOLE_CELL = 8.0 * CELL
_NUMBERS = float(1 << 24)
_NEAR = 1.0 * CELL  # where nearly every voxel has its nearest point


def worley(values: np.ndarray, grid: Grid, seed: int, config: NoiseConfig, most: float) -> None:
    """Square of the distance to the nearest point, steps, (Z, Y, X) int32."""
    _, _, keys = _nearest(grid, seed, config, margin=2)
    values[:] = np.floor(keys / _NUMBERS)


def voronoi_cells(
    values: np.ndarray, grid: Grid, seed: int, config: NoiseConfig, most: float
) -> None:
    """The random number of the nearest point, 0 .. 2**24 - 1."""
    _, points, keys = _nearest(grid, seed, config, margin=2)
    values[:] = points.word[_number(keys)]


def voronoi(values: np.ndarray, grid: Grid, seed: int, config: NoiseConfig, most: float) -> None:
    """Distance to the nearest wall between two cells, in parts of a step of the shortest edge."""
    _walls(values, grid, seed, config, most, edges=False)


def voronoi_edges(
    values: np.ndarray, grid: Grid, seed: int, config: NoiseConfig, most: float
) -> None:
    """Distance to the farther of the nearest two walls, which meet in an edge; in a picture in a
    point.
    """
    _walls(values, grid, seed, config, most, edges=True)


def _walls(
    values: np.ndarray, grid: Grid, seed: int, config: NoiseConfig, most: float, *, edges: bool
) -> None:
    axes, points, keys = _nearest(grid, seed, config, margin=4)
    shorter = shortest(grid.edges, flat=grid.flat)
    scale = np.array([(shorter / edge) ** 2 for edge in grid.edges])
    z, y, x = (axis.at for axis in axes)
    farthest = min(most / WALL + 1, _WHOLE_CELL)
    plane_distance(
        values, keys, z, y, x, points.place, points.counts, scale, edges, float(WALL), farthest
    )


def _nearest(
    grid: Grid, seed: int, config: NoiseConfig, *, margin: int
) -> tuple[list[Axis], Points, np.ndarray]:
    axes = grid.axes()
    points = points_of(axes, key(seed, "noise/points"), jitter=config.jitter, margin=margin)
    keys = np.empty(grid.shape)
    z, y, x = (axis.at for axis in axes)
    nearest(keys, z, y, x, points.place, points.counts, points.around, _NEAR)
    return axes, points, keys


def _number(keys: np.ndarray) -> np.ndarray:
    """Of the nearest point; the keys are used up."""
    keys -= np.floor(keys / _NUMBERS) * _NUMBERS  # exact, and many times faster than a remainder
    return keys.astype(np.int32)
