"""Shapes of regions: volume, centroid, moments of inertia, and surface.

The surface is Crofton's formula over 13 directions (Legland, Kieu, Devaux 2007,
doi:10.5566/ias.v26.p83-92), counted for all regions in one pass: a region's crossings along a
direction are the pairs of neighbours of which one voxel is in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import sum_slabs
from trabecula.measure.configurations import direction_shares
from trabecula.measure.partition.partition import Partition

_HALF = np.array([s for s in product((-1, 0, 1), repeat=3) if s > (0, 0, 0)])
"""The 13 directions to neighbours, one of each pair."""


@dataclass(frozen=True, eq=False)
class Shapes:
    """Shapes of N regions. Lengths are in units of the smallest voxel edge."""

    volume: np.ndarray
    """(N,)"""
    surface: np.ndarray
    """(N,) area of the whole boundary: to other regions, the rest, and beyond the image."""
    centroid: np.ndarray
    """(N, 3) with voxel centres at whole numbers of edges, not wrapped."""
    covariance: np.ndarray
    """(N, 3, 3) second moments of the volume about its centroid, over the volume."""


def measure_shapes(regions: Partition) -> Shapes:
    """Measure the shapes of regions; those that lie across a periodic face are put together."""
    labels, count, edges = regions.labels, regions.count, regions.steps
    sums = _moments(labels, regions.crossed, count)
    volume = np.maximum(sums[:, 0], 1.0)
    mean = sums[:, 1:4] / volume[:, None]
    square = np.empty((count, 3, 3))
    for k, (a, b) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
        moment = sums[:, 4 + k] / volume - mean[:, a] * mean[:, b]
        square[:, a, b] = square[:, b, a] = (moment + (a == b) / 12) * edges[a] * edges[b]
    voxel = float(np.prod(edges))
    around = np.pad(labels, 1)
    for axis, wrap in enumerate(regions.wraps):
        if wrap:
            layers = np.moveaxis(around, axis, 0)
            layers[0], layers[-1] = layers[-2], layers[1]
    strides = _HALF @ np.array([around.shape[1] * around.shape[2], around.shape[2], 1])
    crossings = sum_slabs(
        lambda a, b: _crossings(around, strides, count, a, b), len(labels)
    ).astype(np.float64)
    steps = _HALF * edges
    lengths = np.linalg.norm(steps, axis=1)
    weights = 2 * direction_shares(steps / lengths[:, None], False) / lengths * voxel
    return Shapes(sums[:, 0] * voxel, crossings @ weights, mean * edges, square)


@kernel
def _moments(labels, crossed, count):
    """Sum 1, z, y, x, and the six products of places over every region."""
    depth, height, width = labels.shape
    periodic = crossed.size > 1
    sums = np.zeros((count, 10))
    for z0 in range(depth):
        for y0 in range(height):
            for x0 in range(width):
                k = labels[z0, y0, x0] - 1
                if k < 0:
                    continue
                z, y, x = float(z0), float(y0), float(x0)
                if periodic:
                    code = crossed[z0, y0, x0]
                    z += (code // 9 - 1) * depth
                    y += (code // 3 % 3 - 1) * height
                    x += (code % 3 - 1) * width
                own = sums[k]
                own[0] += 1.0
                own[1] += z
                own[2] += y
                own[3] += x
                own[4] += z * z
                own[5] += y * y
                own[6] += x * x
                own[7] += z * y
                own[8] += z * x
                own[9] += y * x
    return sums


@kernel
def _crossings(around, steps, count, start, stop):
    """Count, for every region and direction, the steps to a neighbour that leave it, there and
    back. `around` has a margin of 1.
    """
    _, height, width = around.shape
    flat = around.ravel()
    found = np.zeros((count, len(steps)), np.int64)
    for z in range(start + 1, stop + 1):
        for y in range(1, height - 1):
            row = (z * height + y) * width
            for x in range(1, width - 1):
                own = flat[row + x]
                if own == 0:
                    continue
                for k in range(len(steps)):
                    found[own - 1, k] += (flat[row + x + steps[k]] != own) + (
                        flat[row + x - steps[k]] != own
                    )
    return found
