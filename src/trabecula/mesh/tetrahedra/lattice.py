"""The lattice that tetrahedra are cut from: corners and centres of cells (body-centred cubic).

Around every edge that joins the centres of two cells lie four tetrahedra, with dihedral angles of
60 and 90 degrees where cells are cubes. At the faces of the box a node in the middle of the face of
a cell stands for the centre beyond, so that the box is filled and opposite faces fit each other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class CellLattice(NamedTuple):
    """Nodes and tetrahedra of a box.

    `points` (N, 3) z, y, x; `cells` (M, 4) int32, of positive volume in that order of axes;
    `planes` (N,) uint8: the axes along which a node lies on a face of the box, a bit each.
    """

    points: np.ndarray
    cells: np.ndarray
    planes: np.ndarray


def lattice(extent: np.ndarray, edge: float) -> CellLattice:
    """Fill a box from 0 to `extent` (3,) with cells of about a side `edge`."""
    sides = np.maximum(np.round(extent / edge), 1).astype(np.int64)
    step = extent / sides
    corner = _places(sides + 1, step, 0.0)
    centre = _places(sides, step, 0.5)
    points, planes = [corner, centre], [_planes(sides + 1), np.zeros(len(centre), np.uint8)]
    corners = np.arange(len(corner)).reshape(sides + 1)
    centres = len(corner) + np.arange(len(centre)).reshape(sides)
    count = len(corner) + len(centre)
    cells = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        # nodes across every face of a cell along the axis: centres, or the middle of the face
        shape = sides.copy()
        shape[axis] += 1
        below, above = np.empty(shape, np.int64), np.empty(shape, np.int64)
        ends = []
        for end in range(2):
            shape[axis] = 1
            number = count + np.arange(int(np.prod(shape))).reshape(shape)
            count += number.size
            offset = np.full(3, 0.5)
            offset[axis] = 0
            place = _places(shape, step, offset)
            place[:, axis] = end * extent[axis]
            points.append(place)
            planes.append(np.full(number.size, 1 << axis, np.uint8))
            ends.append(number)
        below[...] = np.concatenate([ends[0], centres], axis=axis)
        above[...] = np.concatenate([centres, ends[1]], axis=axis)
        ring = [_part(corners, {u: du, v: dv}) for du, dv in ((0, 0), (1, 0), (1, 1), (0, 1))]
        for n in range(4):
            tets = [below, above, ring[n], ring[(n + 1) % 4]]
            cells.append(np.stack([part.ravel() for part in tets], axis=1))
    return CellLattice(
        np.concatenate(points),
        np.concatenate(cells).astype(np.int32),
        np.concatenate(planes),
    )


def _places(sides: np.ndarray, step: np.ndarray, offset: float | np.ndarray) -> np.ndarray:
    return (np.indices(tuple(sides)).reshape(3, -1).T + offset) * step


def _planes(sides: np.ndarray) -> np.ndarray:
    """Return the bits of the axes along which the nodes of a grid are first or last."""
    found = np.zeros(sides, np.uint8)
    for axis, side in enumerate(sides):
        for end in (0, side - 1):
            np.moveaxis(found, axis, 0)[end] |= 1 << axis
    return found.ravel()


def _part(corners: np.ndarray, shifts: dict[int, int]) -> np.ndarray:
    """Return the corners of faces across one axis: all along it, one less along the others."""
    where = [slice(None)] * 3
    for axis, shift in shifts.items():
        where[axis] = slice(shift, corners.shape[axis] - 1 + shift)
    return corners[tuple(where)]
