"""Distances to a surface: its triangles in a grid of cells, so that few are looked at."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs

_MOST_CELLS = 1 << 26


class TriangleGrid(NamedTuple):
    """Triangles by the cells that their boxes touch.

    `corners` (F, 3, 3); `low` (3,) is the lowest corner of the grid, `cell` the side of a cell;
    cell (i, j, k) of `sides` (3,) holds `items[start[n] : start[n + 1]]`, n = (i J + j) K + k.
    """

    corners: np.ndarray
    low: np.ndarray
    cell: float
    sides: np.ndarray
    start: np.ndarray
    items: np.ndarray


def triangle_grid(vertices: np.ndarray, faces: np.ndarray, cell: float) -> TriangleGrid:
    """Sort the triangles of a surface into cells of about a side `cell`."""
    corners = np.ascontiguousarray(vertices[faces], np.float64)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    extent = np.maximum(high - low, 1e-300)
    # of a large surface the cells are larger, rather than more than memory has room for
    side = max(cell, float(np.prod(np.maximum(extent, cell)) / _MOST_CELLS) ** (1 / 3))
    sides = np.floor(extent / side).astype(np.int64) + 1
    start = np.zeros(int(np.prod(sides)) + 1, np.int64)
    _sort(corners, low, side, sides, start, np.empty(0, np.int32), True)
    start[1:] = np.cumsum(start[:-1])
    start[0] = 0
    items = np.empty(start[-1], np.int32)
    _sort(corners, low, side, sides, start.copy(), items, False)
    return TriangleGrid(corners, low, side, sides, start, items)


def distances_to(grid: TriangleGrid, points: np.ndarray) -> np.ndarray:
    """Return the distance of points (N, 3) to the surface, (N,) float64."""
    found = np.empty(len(points))
    places = np.ascontiguousarray(points, np.float64)

    def work(start: int, stop: int) -> None:
        _distances(grid, places, found, start, stop)

    for_slabs(work, len(places), least=1000)
    return found


def sample_triangles(vertices: np.ndarray, faces: np.ndarray, spacing: float) -> np.ndarray:
    """Return points on every triangle, without its corners, at most about `spacing` apart."""
    corners = np.ascontiguousarray(vertices[faces], np.float64)
    counts = np.empty(len(faces), np.int64)
    _count_samples(corners, spacing, counts)
    ends = np.cumsum(counts)
    points = np.empty((int(ends[-1]) if len(ends) else 0, 3))
    _place_samples(corners, spacing, ends, points)
    return points


@inline
def squared_distance(p, a, b, c):
    """Return the squared distance of a point to a triangle.

    Ericson 2005, Real-Time Collision Detection, section 5.1.5: by the part of the triangle that is
    nearest.
    """
    ab0, ab1, ab2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    ac0, ac1, ac2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    ap0, ap1, ap2 = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    d1 = ab0 * ap0 + ab1 * ap1 + ab2 * ap2
    d2 = ac0 * ap0 + ac1 * ap1 + ac2 * ap2
    if d1 <= 0 and d2 <= 0:
        return ap0 * ap0 + ap1 * ap1 + ap2 * ap2
    bp0, bp1, bp2 = p[0] - b[0], p[1] - b[1], p[2] - b[2]
    d3 = ab0 * bp0 + ab1 * bp1 + ab2 * bp2
    d4 = ac0 * bp0 + ac1 * bp1 + ac2 * bp2
    if d3 >= 0 and d4 <= d3:
        return bp0 * bp0 + bp1 * bp1 + bp2 * bp2
    cp0, cp1, cp2 = p[0] - c[0], p[1] - c[1], p[2] - c[2]
    d5 = ab0 * cp0 + ab1 * cp1 + ab2 * cp2
    d6 = ac0 * cp0 + ac1 * cp1 + ac2 * cp2
    if d6 >= 0 and d5 <= d6:
        return cp0 * cp0 + cp1 * cp1 + cp2 * cp2
    vc = d1 * d4 - d3 * d2
    vb = d5 * d2 - d1 * d6
    va = d3 * d6 - d5 * d4
    if vc <= 0 and d1 >= 0 and d3 <= 0:
        v, w = d1 / (d1 - d3), 0.0
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        v, w = 0.0, d2 / (d2 - d6)
    elif va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1 - w
    else:
        total = va + vb + vc
        if total == 0:  # no area
            return ap0 * ap0 + ap1 * ap1 + ap2 * ap2
        v, w = vb / total, vc / total
    x = ap0 - v * ab0 - w * ac0
    y = ap1 - v * ab1 - w * ac1
    z = ap2 - v * ab2 - w * ac2
    return x * x + y * y + z * z


@inline
def is_within(grid, p, most):
    """Return whether the surface is within `most` of a point."""
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):
        low[axis] = max(0, int(np.floor((p[axis] - most - grid.low[axis]) / grid.cell)))
        high[axis] = min(
            grid.sides[axis] - 1, int(np.floor((p[axis] + most - grid.low[axis]) / grid.cell))
        )
    for i in range(low[0], high[0] + 1):
        for j in range(low[1], high[1] + 1):
            row = (i * grid.sides[1] + j) * grid.sides[2]
            for n in range(grid.start[row + low[2]], grid.start[row + high[2] + 1]):
                t = grid.corners[grid.items[n]]
                if squared_distance(p, t[0], t[1], t[2]) <= most * most:
                    return True
    return False


@inline
def longest_side(a, b, c):
    """Return the length of a triangle's longest side."""
    longest = 0.0
    for one, other in ((a, b), (b, c), (c, a)):
        length = 0.0
        for axis in range(3):
            length += (one[axis] - other[axis]) ** 2
        longest = max(longest, length)
    return math.sqrt(longest)


@inline
def samples_along(a, b, c, spacing):
    """Return the number of steps along a triangle's sides that keeps samples `spacing` apart."""
    return max(1, math.ceil(longest_side(a, b, c) / spacing))


@kernel
def _sort(corners, low, cell, sides, start, items, counting):
    """Count the triangles of every cell, or write their numbers from `start` on."""
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for f in range(len(corners)):
        for axis in range(3):
            one, two, three = corners[f, 0, axis], corners[f, 1, axis], corners[f, 2, axis]
            least, most = min(one, min(two, three)), max(one, max(two, three))
            first[axis] = min(sides[axis] - 1, int((least - low[axis]) / cell))
            last[axis] = min(sides[axis] - 1, int((most - low[axis]) / cell))
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                for k in range(first[2], last[2] + 1):
                    n = (i * sides[1] + j) * sides[2] + k
                    if not counting:
                        items[start[n]] = f
                    start[n] += 1


@kernel
def _distances(grid, points, found, start, stop):
    """Search in growing boxes around every point until nothing outside can be nearer."""
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for n in range(start, stop):
        p = points[n]
        outside = 0.0  # distance to the grid's box
        for axis in range(3):
            beyond = max(
                grid.low[axis] - p[axis],
                p[axis] - grid.low[axis] - grid.sides[axis] * grid.cell,
            )
            outside = max(outside, beyond)
        reach = outside + grid.cell / 4
        least = np.inf
        while True:
            whole = True
            for axis in range(3):
                place = (p[axis] - grid.low[axis]) / grid.cell
                low[axis] = int(np.floor(place - reach / grid.cell))
                high[axis] = int(np.floor(place + reach / grid.cell))
                whole = whole and low[axis] <= 0 and high[axis] >= grid.sides[axis] - 1
                low[axis] = max(0, low[axis])
                high[axis] = min(grid.sides[axis] - 1, high[axis])
            for i in range(low[0], high[0] + 1):
                for j in range(low[1], high[1] + 1):
                    row = (i * grid.sides[1] + j) * grid.sides[2]
                    for m in range(grid.start[row + low[2]], grid.start[row + high[2] + 1]):
                        t = grid.corners[grid.items[m]]
                        least = min(least, squared_distance(p, t[0], t[1], t[2]))
            if least <= reach * reach or whole:
                break
            reach *= 2
        found[n] = math.sqrt(least)


@kernel
def _count_samples(corners, spacing, counts):
    for f in range(len(corners)):
        steps = samples_along(corners[f, 0], corners[f, 1], corners[f, 2], spacing)
        counts[f] = (steps + 1) * (steps + 2) // 2 - 3


@kernel
def _place_samples(corners, spacing, ends, points):
    for f in range(len(corners)):
        n = ends[f - 1] if f else 0
        steps = samples_along(corners[f, 0], corners[f, 1], corners[f, 2], spacing)
        for i in range(steps + 1):
            for j in range(steps + 1 - i):
                if i == steps or j == steps or i + j == 0:
                    continue
                for axis in range(3):
                    points[n, axis] = (
                        i * corners[f, 0, axis]
                        + j * corners[f, 1, axis]
                        + (steps - i - j) * corners[f, 2, axis]
                    ) / steps
                n += 1
