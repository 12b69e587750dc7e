"""Triangles of a surface that cross each other: a count by brute force within cells."""

from __future__ import annotations

import numpy as np
from numba import njit

from trabecula.mesh.base import Mesh
from trabecula.mesh.triangle_grid import triangle_grid


def crossings(surface: Mesh, cell: float) -> int:
    """Return the triangles that cross another one with which they share no vertex."""
    grid = triangle_grid(surface.vertices.astype(np.float64), surface.faces, cell)
    return int(_count(surface.faces, grid.corners, grid.start, grid.items))


@njit
def _passes(p, q, a, b, c):
    """Return whether a piece of a line passes through the inside of a triangle."""
    u, v, d = b - a, c - a, q - p
    n = np.cross(u, v)
    slope = np.dot(n, d)
    if abs(slope) < 1e-12:
        return False
    t = np.dot(n, a - p) / slope
    if t <= 1e-9 or t >= 1 - 1e-9:
        return False
    x = p + t * d - a
    uu, uv, vv = np.dot(u, u), np.dot(u, v), np.dot(v, v)
    xu, xv = np.dot(x, u), np.dot(x, v)
    size = uv * uv - uu * vv
    if size == 0:
        return False
    s, r = (uv * xv - vv * xu) / size, (uv * xu - uu * xv) / size
    return s > 1e-9 and r > 1e-9 and s + r < 1 - 1e-9


@njit
def _count(faces, corners, start, items):
    hit = np.zeros(len(faces), np.bool_)
    for n in range(len(start) - 1):
        for i in range(start[n], start[n + 1]):
            for j in range(i + 1, start[n + 1]):
                f, g = items[i], items[j]
                if hit[f] and hit[g]:
                    continue
                joined = False
                for k in range(3):
                    for m in range(3):
                        joined = joined or faces[f, k] == faces[g, m]
                if joined:
                    continue
                one, other = corners[f], corners[g]
                for k in range(3):
                    if _passes(one[k], one[(k + 1) % 3], other[0], other[1], other[2]) or _passes(
                        other[k], other[(k + 1) % 3], one[0], one[1], one[2]
                    ):
                        hit[f] = hit[g] = True
    return hit.sum()
