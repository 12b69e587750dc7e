"""How deep every place lies below the outside of the form, on a coarse grid.

1. Blocks of voxels, solid where more than half of a block is material.
2. The outside: what a ball of radius `closing` reaches from the faces of the volume without
   touching solid (a closing: pores that open outwards stay inside).
3. The Euclidean distance to it.

Where the material meets a face of the volume it was cut there, and there is no outside beyond.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.measure.distance import distance_transform
from trabecula.measure.labelling import label_components

SIDE = 96
"""Blocks along the longest edge, at most."""


def coarse_factor(shape: Sequence[int]) -> int:
    """Return the voxels along an edge of a block: three at least but in small volumes, so that the
    coarse grid takes less memory than the volume.
    """
    longest = max(shape)
    return max(1 if longest < 100 else 3, ceil(longest / SIDE))


def rim_depths(
    field: np.ndarray, stretch: np.ndarray, closing: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return depths below the outside, and the edges of the coarse grid's voxels along x, y, z.

    Parameters
    ----------
    field : (Z, Y, X) int16
        Positive in the material.
    stretch : (3,) float
        Edges of a voxel along x, y, z, in the smallest of them.
    closing : float
        Radius of the widest pore that is closed, in smallest edges.

    Returns
    -------
    (A, B, C) float32
        In smallest edges; large where there is no outside.
    (3,) float
    """
    factor = coarse_factor(field.shape)
    solid = np.empty([-(-side // factor) for side in field.shape], bool)
    _coarsen(field, factor, solid)
    edges = stretch * factor
    spacing = tuple(edges[::-1])
    if solid.all() or not solid.any():
        return np.full((1, 1, 1), 1e6, np.float32), edges
    # beyond a face lies more of what touches it: air, or the piece that it was cut of
    more = [ceil(closing / edge) + 2 for edge in spacing]
    inner = tuple(slice(count, -count) for count in more)
    solid = np.pad(solid, [(count, count) for count in more], mode="edge")
    air = distance_transform(~solid, spacing=spacing)
    free = air > closing
    labels, _ = label_components(free)
    faces = np.unique(
        np.concatenate([np.take(labels, [0, -1], axis=axis).ravel() for axis in range(3)])
    )
    reached = np.isin(labels, faces[faces > 0])
    del air, free, labels
    if not reached.any():
        return np.full((1, 1, 1), 1e6, np.float32), edges
    outside = distance_transform(~reached, spacing=spacing) < closing
    outside &= ~solid
    depth = distance_transform(~outside, spacing=spacing) - np.float32(0.5 * edges.min())
    return _smooth(np.maximum(depth[inner], 0)), edges


def _smooth(values: np.ndarray) -> np.ndarray:
    """Blur by (1, 2, 1) / 4 along every axis: distances between blocks come in steps."""
    for axis in range(3):
        pads = [(1, 1) if each == axis else (0, 0) for each in range(3)]
        padded = np.moveaxis(np.pad(values, pads, mode="edge"), axis, 0)
        values = np.moveaxis((padded[:-2] + 2 * padded[1:-1] + padded[2:]) / 4, 0, axis)
    return np.ascontiguousarray(values, np.float32)


@kernel
def _coarsen(field, factor, solid):
    for k in range(solid.shape[0]):
        for j in range(solid.shape[1]):
            for i in range(solid.shape[2]):
                count, inside = 0, 0
                for z in range(k * factor, min((k + 1) * factor, field.shape[0])):
                    for y in range(j * factor, min((j + 1) * factor, field.shape[1])):
                        for x in range(i * factor, min((i + 1) * factor, field.shape[2])):
                            count += 1
                            inside += field[z, y, x] > 0
                solid[k, j, i] = 2 * inside > count
