"""The 256 black-and-white cubes of 2x2x2 voxels: their counts in an image, and their shares in
functionals.

The tables are made here, not typed in. Corner i of a cube is bit i of its number. A 2-D image is
two equal slices, so that its 2x2 squares are the lower four bits.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import product

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs

_CORNERS = np.array(list(product((0, 1), repeat=3)))  # (dz, dy, dx)


def count_cubes(inside: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    """Count how often each cube occurs in a boolean array, (Z, Y, X) or (Y, X); (256,).

    With a mask only cubes wholly inside it.
    """
    solid = _lift(inside)
    region = np.ones((1, 1, 1), bool) if mask is None else _lift(mask)
    parts: list[np.ndarray] = []
    for_slabs(lambda a, b: parts.append(_count_cubes(solid, region, a, b)), len(solid) - 1)
    return np.sum(parts, axis=0)


def cube_codes(inside: np.ndarray) -> np.ndarray:
    """Return the number of the cube at every place, uint8, one voxel shorter along every axis."""
    solid = inside.astype(np.uint8)
    codes = np.zeros([side - 1 for side in solid.shape], np.uint8)
    for bit, corner in enumerate(_CORNERS):
        at = corner[3 - solid.ndim :]  # a 2-D image is two equal slices: dz counts for nothing
        part = solid[tuple(slice(i, i + side) for i, side in zip(at, codes.shape, strict=True))]
        codes |= part << np.uint8(bit)
    return codes


def _lift(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values if values.ndim == 3 else np.stack([values, values]))


@inline
def _all_set(mask, z, y, x):
    upper = mask[z, y, x] & mask[z, y, x + 1] & mask[z, y + 1, x] & mask[z, y + 1, x + 1]
    return (
        upper
        & mask[z + 1, y, x]
        & mask[z + 1, y, x + 1]
        & mask[z + 1, y + 1, x]
        & mask[z + 1, y + 1, x + 1]
    )


@kernel
def _count_cubes(inside, mask, start, stop):
    """Count cubes; a mask of one voxel stands for none."""
    _, height, width = inside.shape
    masked = mask.size > 1
    counts = np.zeros(256, np.int64)
    for z in range(start, stop):
        for y in range(height - 1):
            near = (
                inside[z, y, 0]
                | inside[z, y + 1, 0] << 2
                | inside[z + 1, y, 0] << 4
                | inside[z + 1, y + 1, 0] << 6
            )
            for x in range(1, width):
                far = (
                    inside[z, y, x]
                    | inside[z, y + 1, x] << 2
                    | inside[z + 1, y, x] << 4
                    | inside[z + 1, y + 1, x] << 6
                )
                if not masked or _all_set(mask, z, y, x - 1):
                    counts[near | far << 1] += 1
                near = far
    return counts


@lru_cache
def bits() -> np.ndarray:
    """Return, for every cube, whether corner i is inside, (256, 8)."""
    return (np.arange(256)[:, None] >> np.arange(8)) & 1


def _pairs() -> list[tuple[int, int]]:
    return [(i, j) for i in range(8) for j in range(i + 1, 8)]


@lru_cache
def surface_table(spacing: tuple[float, ...], *, flat: bool) -> np.ndarray:
    """Return the surface per volume (or boundary per area of the lower square) of every cube,
    (256,).

    Of a direction's pairs of corners, the share with one end inside, over their distance, is the
    number of crossings per length; the surface is twice (the length pi / 2 times) its mean over all
    directions.
    """
    groups: dict[tuple[int, ...], list[tuple[int, int]]] = {}
    for i, j in _pairs():
        step = _CORNERS[j] - _CORNERS[i]
        if not (flat and (step[0] or i > 3)):
            groups.setdefault(tuple(step), []).append((i, j))
    steps = np.array(list(groups)) * np.array(spacing)
    lengths = np.linalg.norm(steps, axis=1)
    share = direction_shares(steps / lengths[:, None], flat)
    corner = bits()
    crossings = [
        np.mean([corner[:, i] != corner[:, j] for i, j in pairs], axis=0)
        for pairs in groups.values()
    ]
    return (share / lengths) @ np.array(crossings) * (np.pi / 2 if flat else 2.0)


def direction_shares(directions: np.ndarray, flat: bool) -> np.ndarray:
    """Return the share of the sphere (circle) that is nearer to each +-direction than to the
    others, by a regular sample of it.
    """
    turn = np.arange(100_000) + 0.5
    # directions have no sign: half a sphere is enough
    height = np.zeros_like(turn) if flat else turn / len(turn)
    angle = np.pi * turn / len(turn) if flat else np.pi * (1 + 5**0.5) * turn
    around = np.sqrt(1 - height**2)
    sample = np.stack([height, around * np.sin(angle), around * np.cos(angle)], axis=1)
    nearest = np.argmax(np.abs(sample @ directions.T), axis=1)
    return np.bincount(nearest, minlength=len(directions)) / len(turn)


@lru_cache
def square_euler(connectivity: int) -> np.ndarray:
    """Return the share of every 2x2 square in the Euler number of a plane image with 4 or 8
    neighbours, (16,); corners (0,0), (0,1), (1,0), (1,1).
    """
    corner = (np.arange(16)[:, None] >> np.arange(4)) & 1
    edges = [(0, 1), (2, 3), (0, 2), (1, 3)]
    if connectivity == 8:
        # Around the common vertex: the vertex, four half edges, four quarter faces.
        return (
            corner.any(axis=1)
            - sum(corner[:, [i, j]].any(axis=1) for i, j in edges) / 2
            + corner.sum(axis=1) / 4
        )
    return (
        corner.sum(axis=1) / 4
        - sum(corner[:, [i, j]].all(axis=1) for i, j in edges) / 2
        + corner.all(axis=1)
    )


@lru_cache
def cube_euler(connectivity: int) -> np.ndarray:
    """Return the share of every cube in the Euler number with 6, 18 or 26 neighbours, (256,)."""
    corner = bits()
    sides = [np.flatnonzero(_CORNERS[:, axis] == at) for axis in range(3) for at in (0, 1)]
    pairs = [pair for pair in _pairs() if np.abs(_CORNERS[pair[1]] - _CORNERS[pair[0]]).sum() == 1]
    if connectivity == 6:
        edges = sum(corner[:, pair].all(axis=1) for pair in pairs) / 4
        faces = sum(corner[:, side].all(axis=1) for side in sides) / 2
        return corner.sum(axis=1) / 8 - edges + faces - corner.all(axis=1)
    # Around the common vertex: itself, six half edges (four voxels each), twelve quarter faces
    # (two), eight eighths of a voxel.
    half_edges = sum(corner[:, side].any(axis=1) for side in sides) / 2
    quarter_faces = sum(corner[:, pair].any(axis=1) for pair in pairs) / 4
    table = corner.any(axis=1) - half_edges + quarter_faces - corner.sum(axis=1) / 8
    if connectivity == 18:
        # Two voxels that share this vertex and nothing else: cut apart, each keeps a vertex of its
        # own. A third voxel would share an edge or a face with both.
        for i in range(4):
            table[1 << i | 1 << (7 - i)] += 1
    return table


def curvature_table(spacing: tuple[float, ...], connectivity: int) -> np.ndarray:
    """Return the mean curvature per volume of every cube, (256,): 2 pi times the sections' Euler
    number per area, averaged over the axes.
    """
    # In a plane of voxels, 18 and 26 neighbours are the same 8.
    corner, quad = bits(), square_euler(4 if connectivity == 6 else 8)
    table = np.zeros(256)
    for axis in range(3):
        area = float(np.prod(spacing)) / spacing[axis]
        for at in (0, 1):
            side = np.flatnonzero(_CORNERS[:, axis] == at)
            table += quad[corner[:, side] @ (1 << np.arange(4))] / (2 * area)
    return 2 * np.pi * table / 3
