"""Dihedral angles and volumes of tetrahedra."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs


def dihedral_angles(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return the least and the largest dihedral angle of every tetrahedron, (M, 2) degrees; of one
    that is turned inside out or without volume 0 and 180.
    """
    found = np.empty((len(cells), 2))

    def work(start: int, stop: int) -> None:
        _angles(points, cells, found, start, stop)

    for_slabs(work, len(cells), least=10_000)
    return np.degrees(np.arccos(found))


def volumes(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return the volume of every tetrahedron, (M,); below 0 of one that is turned inside out."""
    found = np.empty(len(cells))

    def work(start: int, stop: int) -> None:
        _volumes(points, cells, found, start, stop)

    for_slabs(work, len(cells), least=10_000)
    return found


@inline
def cosines(points, cell, normals):
    """Return the cosines of the least and of the largest dihedral angle of a tetrahedron; 1 and -1
    of one without volume. `normals` (4, 3) is overwritten.
    """
    for corner in range(4):
        a, b = cell[(corner + 1) % 4], cell[(corner + 2) % 4]
        c = cell[(corner + 3) % 4]
        length = 0.0
        for axis in range(3):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            normals[corner, axis] = (points[b, u] - points[a, u]) * (
                points[c, v] - points[a, v]
            ) - (points[b, v] - points[a, v]) * (points[c, u] - points[a, u])
            length += normals[corner, axis] ** 2
        sign = 1.0 if corner % 2 == 0 else -1.0
        for axis in range(3):
            normals[corner, axis] *= sign / max(np.sqrt(length), 1e-300)
    inwards = 0.0
    for axis in range(3):
        inwards += normals[0, axis] * (points[cell[1], axis] - points[cell[0], axis])
    if inwards <= 0:
        return 1.0, -1.0
    least, most = -1.0, 1.0
    for p in range(4):
        for q in range(p + 1, 4):
            dot = 0.0
            for axis in range(3):
                dot += normals[p, axis] * normals[q, axis]
            # normals of both faces point outwards: the angle is 180 degrees less theirs
            least, most = max(least, -dot), min(most, -dot)
    return min(least, 1.0), max(most, -1.0)


@kernel
def _angles(points, cells, found, start, stop):
    normals = np.empty((4, 3))
    for n in range(start, stop):
        found[n, 0], found[n, 1] = cosines(points, cells[n], normals)


@kernel
def _volumes(points, cells, found, start, stop):
    for n in range(start, stop):
        a, b, c, d = cells[n, 0], cells[n, 1], cells[n, 2], cells[n, 3]
        total = 0.0
        for axis in range(3):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            total += (points[d, axis] - points[a, axis]) * (
                (points[b, u] - points[a, u]) * (points[c, v] - points[a, v])
                - (points[b, v] - points[a, v]) * (points[c, u] - points[a, u])
            )
        found[n] = total / 6
