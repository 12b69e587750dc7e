"""Patterns of points, one in every cell of a lattice: Worley noise and Voronoi cells, walls, edges.

Worley (1996), *A cellular texture basis function*, doi:10.1145/237170.237267: the distance to the
nearest point. Walls and edges take true distances to the planes half way between two points instead
of the difference of two distances, so that they are as thick everywhere.

Symbols: s a point, D the square of its distance from a voxel's middle, in steps, of which a cell's
edge has 4096. With d from the point of a cell to a neighbour and p from it to the voxel,
D_neighbour - D_own = d.d - 2 p.d is a whole number, and its product with 1 / (2 |d|) the distance
to the plane, at least |d| / 2 - |p|: neighbours come in the order of |d|, and the first that is too
far ends the search. Along a row the distance to a plane changes evenly, so that the ends of a row's
part within one cell decide which planes matter.
"""

from __future__ import annotations

import numpy as np

from trabecula.core.seeds import key
from trabecula.engine.compile import inline, kernel
from trabecula.engine.rows import copy_row
from trabecula.synth.noise.config import NoiseConfig
from trabecula.synth.noise.lattice import CELL, Axis, Points, VoxelGrid, points_of, shortest


@inline
def _first_from(at, value):
    """Return the index of the first of rising positions that is at least `value`."""
    low, high = 0, len(at)
    while low < high:
        middle = (low + high) // 2
        if at[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def nearest(keys, az, ay, ax, place, counts, around, reach):
    """Fill `keys` (Z, Y, X) float64 with D * 2**24 + n of every voxel's nearest point n.

    Of equally near ones it is the first. Every point visits the voxels within `reach`, which is
    quick; a voxel without a visit searches the cells up to two away: the point of its own cell is
    nearer than any beyond. Points are fewer than 2**24.
    """
    keys[:] = np.inf
    square = reach * reach
    for n in range(len(place)):
        sz, sy, sx = place[n, 0], place[n, 1], place[n, 2]
        z0, z1 = _first_from(az, sz - reach), _first_from(az, sz + reach)
        y0, y1 = _first_from(ay, sy - reach), _first_from(ay, sy + reach)
        x0, x1 = _first_from(ax, sx - reach), _first_from(ax, sx + reach)
        if x0 == x1 or y0 == y1:
            continue
        at = ax[x0:x1]
        for z in range(z0, z1):
            for y in range(y0, y1):
                across = (az[z] - sz) ** 2 + (ay[y] - sy) ** 2
                if across < square:
                    row = keys[z, y, x0:x1]
                    for i in range(len(row)):
                        key = (across + (at[i] - sx) * (at[i] - sx)) * 16777216.0 + n
                        # min() would look for NaN, one by one
                        row[i] = key if key < row[i] else row[i]
    for z in range(len(az)):
        for y in range(len(ay)):
            for x in range(len(ax)):
                if keys[z, y, x] >= square * 16777216.0:
                    keys[z, y, x] = _search_cells(az[z], ay[y], ax[x], place, counts, around)


@inline
def _search_cells(pz, py, px, place, counts, around):
    """Return the key of the nearest point among those of the cells up to two away."""
    best = np.inf
    z = np.int64(pz // 4096) + around[0]
    y = np.int64(py // 4096) + around[1]
    x = np.int64(px // 4096) + around[2]
    for cz in range(max(z - 2, 0), min(z + 3, counts[0])):
        for cy in range(max(y - 2, 0), min(y + 3, counts[1])):
            for cx in range(max(x - 2, 0), min(x + 3, counts[2])):
                n = (cz * counts[1] + cy) * counts[2] + cx
                square = (pz - place[n, 0]) ** 2 + (py - place[n, 1]) ** 2 + (px - place[n, 2]) ** 2
                best = min(best, square * 16777216.0 + n)
    return best


_FARTHEST = (
    2 * 1.25 * 4096.0
) ** 2  # square: beyond twice what a point and a voxel of its cell are apart there is no wall
_SHELVES = 64


@inline
def _between(n, m, place, d):
    """Set the vector d from one point to another; returns the square of its length."""
    d[0] = place[m, 0] - place[n, 0]
    d[1] = place[m, 1] - place[n, 1]
    d[2] = place[m, 2] - place[n, 2]
    return d[0] * d[0] + d[1] * d[1] + d[2] * d[2]


@kernel
def neighbours(near, n, place, counts, scale):
    """Set the points of the cells up to two away, nearer ones first; returns their number.

    Rows of `near`, (124, 5) float64, are d, |d| / 2 and 1 / (2 |d|). They are sorted into bins by
    |d|^2, and |d| / 2 is that of the bin's lower end. 1 / (2 |d|) is in steps of the shortest edge,
    along which `scale` is 1.
    """
    z, y, x = n // (counts[1] * counts[2]), n // counts[2] % counts[1], n % counts[2]
    other = np.empty(124, np.int32)
    shelf = np.empty(124, np.int32)
    ends = np.zeros(_SHELVES + 1, np.int32)
    found, d = 0, np.empty(3)
    for cz in range(max(z - 2, 0), min(z + 3, counts[0])):
        for cy in range(max(y - 2, 0), min(y + 3, counts[1])):
            for cx in range(max(x - 2, 0), min(x + 3, counts[2])):
                m = (cz * counts[1] + cy) * counts[2] + cx
                square = _between(n, m, place, d)
                if m != n and square < _FARTHEST:
                    other[found], shelf[found] = m, np.int32(square * (_SHELVES / _FARTHEST))
                    ends[shelf[found] + 1] += 1
                    found += 1
    for i in range(_SHELVES):
        ends[i + 1] += ends[i]
    for i in range(found):
        row = near[ends[shelf[i]]]
        ends[shelf[i]] += 1
        _between(n, other[i], place, row)
        row[3] = 0.5 * np.sqrt(shelf[i] * (_FARTHEST / _SHELVES))
        row[4] = 0.5 / np.sqrt(
            scale[0] * row[0] * row[0] + scale[1] * row[1] * row[1] + scale[2] * row[2] * row[2]
        )
    return found


@inline
def _planes(lines, near, count, pz, py, first, last, edges, most):
    """Set the planes that may be nearest (second nearest) from `first` to `last` along x.

    Only those nearer than `most` count; returns their number. Rows of `lines`: the distance at 0
    and its slope, both times 2 |d|; 1 / (2 |d|); the distance at the nearer end.
    """
    best, second, limit, found = most, most, most + 1.0, 0
    far = np.sqrt(pz * pz + py * py + max(first * first, last * last)) + 1.0
    for j in range(count):
        if near[j, 3] - far > limit:
            break
        dz, dy, dx, factor = near[j, 0], near[j, 1], near[j, 2], near[j, 4]
        base = dz * (dz - 2.0 * pz) + dy * (dy - 2.0 * py) + dx * dx
        left, right = (base - 2.0 * dx * first) * factor, (base - 2.0 * dx * last) * factor
        lower, upper = left if left < right else right, right if left < right else left
        lines[found, 0] = base
        lines[found, 1] = 2.0 * dx
        lines[found, 2] = factor
        lines[found, 3] = lower
        found += lower <= limit
        middle = upper if upper > best else best
        best = upper if upper < best else best
        second = middle if middle < second else second
        limit = (second if edges else best) + 1.0
    kept = 0
    for j in range(found):
        copy_row(lines[kept], lines[j])
        kept += lines[j, 3] <= limit
    return kept


@inline
def _run(row, ax, start, stop, sx, lines, count, edges, parts, most):
    """Fill the voxels of a row from start to stop, which lie in one cell."""
    for x in range(start, stop):
        p, best, second = ax[x] - sx, most, most
        for j in range(count):
            distance = (lines[j, 0] - lines[j, 1] * p) * lines[j, 2]
            middle = distance if distance > best else best
            best = distance if distance < best else best
            second = middle if middle < second else second
        row[x] = np.int32(np.floor((second if edges else best) * parts))


@kernel
def plane_distance(values, keys, az, ay, ax, place, counts, scale, edges, parts, most):
    """Fill `values` (Z, Y, X) int32 with the distance to the nearest plane, times `parts`.

    With `edges` it is the second nearest; it is `most` at most, and rounded down. keys: (Z, Y, X)
    float64, the voxels' nearest points as `nearest` finds them; scale: squares of the shortest edge
    over the edges.
    """
    # of which few pages are ever touched
    known, near = np.zeros(len(place), np.int32), np.empty((len(place), 124, 5))
    lines, own = np.empty((125, 4)), np.empty(len(ax), np.int32)
    for z in range(values.shape[0]):
        for y in range(values.shape[1]):
            for x in range(len(ax)):
                key = keys[z, y, x]
                own[x] = np.int32(key - np.floor(key / 16777216.0) * 16777216.0)
            x = 0
            while x < len(ax):
                n, start = own[x], x
                while x < len(ax) and own[x] == n:
                    x += 1
                if known[n] == 0:
                    known[n] = neighbours(near[n], n, place, counts, scale)
                sx = place[n, 2]
                pz, py = az[z] - place[n, 0], ay[y] - place[n, 1]
                count = _planes(
                    lines, near[n], known[n], pz, py, ax[start] - sx, ax[x - 1] - sx, edges, most
                )
                _run(values[z, y], ax, start, x, sx, lines, count, edges, parts, most)


WALL = 1024
"""Parts of a step in which the distance to a wall is counted."""

_WHOLE_CELL = 8.0 * CELL
_NUMBERS = float(1 << 24)
_NEAR = 1.0 * CELL  # where nearly every voxel has its nearest point


def worley(
    values: np.ndarray, grid: VoxelGrid, seed: int, config: NoiseConfig, most: float
) -> None:
    """Fill `values` (Z, Y, X) int32 with the squared distance to the nearest point, in steps."""
    _, _, keys = _nearest(grid, seed, config, margin=2)
    values[:] = np.floor(keys / _NUMBERS)


def voronoi_cells(
    values: np.ndarray, grid: VoxelGrid, seed: int, config: NoiseConfig, most: float
) -> None:
    """Fill `values` with the random number of the nearest point, 0 .. 2**24 - 1."""
    _, points, keys = _nearest(grid, seed, config, margin=2)
    values[:] = points.word[_number(keys)]


def voronoi(
    values: np.ndarray, grid: VoxelGrid, seed: int, config: NoiseConfig, most: float
) -> None:
    """Fill `values` with the distance to the nearest wall, in parts of a step (shortest edge)."""
    _walls(values, grid, seed, config, most, edges=False)


def voronoi_edges(
    values: np.ndarray, grid: VoxelGrid, seed: int, config: NoiseConfig, most: float
) -> None:
    """Fill `values` with the distance to the farther of the nearest two walls.

    They meet in an edge; in a picture in a point.
    """
    _walls(values, grid, seed, config, most, edges=True)


def _walls(
    values: np.ndarray, grid: VoxelGrid, seed: int, config: NoiseConfig, most: float, *, edges: bool
) -> None:
    """Fill `values` with distances to walls, or to edges."""
    axes, points, keys = _nearest(grid, seed, config, margin=4)
    shorter = shortest(grid.edges, flat=grid.flat)
    scale = np.array([(shorter / edge) ** 2 for edge in grid.edges])
    z, y, x = (axis.at for axis in axes)
    farthest = min(most / WALL + 1, _WHOLE_CELL)
    plane_distance(
        values, keys, z, y, x, points.place, points.counts, scale, edges, float(WALL), farthest
    )


def _nearest(
    grid: VoxelGrid, seed: int, config: NoiseConfig, *, margin: int
) -> tuple[list[Axis], Points, np.ndarray]:
    """Return axes, points and the keys of the nearest points."""
    axes = grid.axes()
    points = points_of(axes, key(seed, "noise/points"), jitter=config.jitter, margin=margin)
    keys = np.empty(grid.shape)
    z, y, x = (axis.at for axis in axes)
    nearest(keys, z, y, x, points.place, points.counts, points.around, _NEAR)
    return axes, points, keys


def _number(keys: np.ndarray) -> np.ndarray:
    """Return the number of the nearest point; it overwrites the keys."""
    keys -= np.floor(keys / _NUMBERS) * _NUMBERS  # exact, and many times faster than a remainder
    return keys.astype(np.int32)
