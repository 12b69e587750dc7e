"""The case table of marching cubes, generated (Lorensen and Cline 1987, doi:10.1145/37401.37422,
is the source of the idea).

A cube has the centres of 2x2x2 voxels as corners. Corner `c` is at x = c & 1, y = c >> 1 & 1, z =
c >> 2 & 1; bit `c` of a configuration is 1 if this corner is solid. An edge with one solid and one
void end carries one vertex.

**One rule for every face.** Where the two solid corners of a face are on a diagonal, the solid is
*separated* (each solid corner gets its own segment). So the surface encloses components of 6
neighbours, the connectivity that components are counted by. The void is joined there. Both cubes at
a face apply the same rule to the same four corners and so draw the same segments, in opposite
directions: no gap can open, in any volume.

**Why the surface is a manifold.** Every cut edge is in two faces of its cube and ends one segment
in each, so the segments close into loops that share no vertex, and around a grid edge the four
cubes' loops form one ring. A loop's inner diagonals are its own unless both ends are in one face of
the cube, where the neighbour could draw the same; `_triangulate` therefore never uses such a
diagonal (the test of the table shows that it never has to).
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np

EDGES = tuple((c, c | 1 << axis, axis) for axis in range(3) for c in range(8) if not c >> axis & 1)
"""The twelve edges: lower corner, upper corner, axis (0 x, 1 y, 2 z)."""

_EDGE_OF = {frozenset((a, b)): index for index, (a, b, _) in enumerate(EDGES)}
_NOT_POSSIBLE = 1e9


@cache
def case_table() -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles of every configuration.

    Returns
    -------
    counts : (256,) int64
        Number of triangles.
    triangles : (256, N) int64
        Edge numbers, three to a triangle, outward (counter-clockwise seen from the void); padded
        with -1.
    """
    cases = [_triangles(config) for config in range(256)]
    counts = np.array([len(case) // 3 for case in cases], np.int64)
    triangles = np.full((256, max(map(len, cases))), -1, np.int64)
    for config, case in enumerate(cases):
        triangles[config, : len(case)] = case
    return counts, triangles


def loops(config: int) -> list[list[int]]:
    """Return the closed loops of cut edges of one configuration, outward."""
    follower: dict[int, int] = {}
    for face in _FACES:
        follower.update(_segments(config, face))
    found = []
    while follower:
        start, nearest = next(iter(follower.items()))
        loop = [start]
        while nearest != start:
            loop.append(nearest)
            nearest = follower.pop(nearest)
        del follower[start]
        found.append(loop)
    return found


def share_face(first: int, second: int) -> bool:
    """Return whether two edges of the cube are in one of its faces."""
    return any({first, second} <= set(_edges_around(face)) for face in _FACES)


def _corners_around(axis: int, side: int) -> tuple[int, int, int, int]:
    """Return the corners of a face, counter-clockwise seen from outside the cube."""
    u, v = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
    base = side << axis
    ring = (base, base | u, base | u | v, base | v)
    return ring if side else (ring[0], ring[3], ring[2], ring[1])


_FACES = tuple(_corners_around(axis, side) for axis in range(3) for side in (0, 1))


def _edges_around(face: tuple[int, int, int, int]) -> list[int]:
    return [_EDGE_OF[frozenset(pair)] for pair in pairwise((*face, face[0]))]


def _segments(config: int, face: tuple[int, int, int, int]) -> dict[int, int]:
    """Map start to end of the segments on a face: one around each run of solid corners.

    It runs from the edge before the run to the one after it. A segment for each run is the rule
    that separates solid corners on a diagonal.
    """
    solid = [config >> corner & 1 for corner in face]
    edges = _edges_around(face)
    segments = {}
    for k in range(4):
        if solid[k] and not solid[(k + 1) % 4]:
            first = k
            while solid[(first - 1) % 4]:
                first -= 1
            segments[edges[(first - 1) % 4]] = edges[k]
    return segments


def _triangles(config: int) -> list[int]:
    return [edge for loop in loops(config) for edge in _triangulate(loop)]


def _triangulate(loop: list[int]) -> list[int]:
    """Divide a loop into triangles by dynamic programming.

    With the shortest diagonals of those that are in no face of the cube.
    """
    middle = [
        np.array([sum(c >> axis & 1 for c in EDGES[edge][:2]) / 2 for axis in range(3)])
        for edge in loop
    ]

    def diagonal(i: int, j: int) -> float:
        if j - i in (1, len(loop) - 1):
            return 0.0
        return (
            _NOT_POSSIBLE
            if share_face(loop[i], loop[j])
            else float(np.linalg.norm(middle[i] - middle[j]))
        )

    @cache
    def best(i: int, j: int) -> tuple[float, tuple[int, ...]]:
        if j - i < 2:
            return 0.0, ()
        splits = []
        for k in range(i + 1, j):
            (low, left), (high, right) = best(i, k), best(k, j)
            cost = low + high + diagonal(i, k) + diagonal(k, j)
            splits.append((cost, (*left, loop[i], loop[k], loop[j], *right)))
        return min(splits)

    cost, triangles = best(0, len(loop) - 1)
    assert cost < _NOT_POSSIBLE, "a loop without a triangulation off the faces"
    return list(triangles)
