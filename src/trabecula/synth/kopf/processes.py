"""Processes: materials of two phases whose third dimension is known, because a rule makes them.

Each is a field in a box: one phase is where it is high, the other where it is low, at any fraction.
All but fibres repeat across the faces of the box.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from trabecula.core.seeds import generator
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs
from trabecula.engine.rows import copy_row

_STEPS = 120  # of points that push each other apart
_NEAR = 1.08  # mean distances between points, below which they do
_PUSH = 0.25  # of the overlap, a step
_RADIUS = 0.38  # of mixed spheres, median, in mean distances
_SPREAD = 0.4  # standard deviation of the logarithm of their radii
_LARGEST = 1.2  # of their radii, in mean distances
_GAP = 0.1  # mean distances between two of them, at least
_TRIES = 400  # of a sphere to find a place
_REACH = 2.2  # mean distances from a centre within which a sphere counts
_PLATES = 0.25  # share of the walls between cells that are plates, of bone's kind
_LINES = 1.8  # fibres through a square of one mean distance
_BLOCK = 8  # voxels a side of a block whose voxels look at points in one order
_HALF_DIAGONAL = 0.87  # of a cube, sides; rounded up


def gaussian_field(side: int, length: float, draw: np.random.Generator) -> np.ndarray:
    """Return white noise smoothed by a Gaussian."""
    return _filtered(side, draw, lambda wave: np.exp(-0.5 * (1.5 * length * wave) ** 2))


def waves(side: int, length: float, draw: np.random.Generator) -> np.ndarray:
    """Return waves of nearly one length in all directions (after Cahn 1965,
    doi:10.1063/1.1695731).
    """
    return _filtered(side, draw, lambda wave: np.exp(-(((1.4 * length * wave - 1) / 0.3) ** 2)))


def sheets(side: int, length: float, draw: np.random.Generator) -> np.ndarray:
    """Return a field that is high near the zero surface of a Gaussian field (Berk 1987,
    doi:10.1103/PhysRevLett.58.2718).
    """
    return -np.abs(gaussian_field(side, length, draw))


def overlapping_spheres(side: int, length: float, draw: np.random.Generator) -> np.ndarray:
    """Return minus the distance to the nearest of points anywhere: spheres of one size."""
    points = draw.random((_count(side, length), 3)) * side
    return _spheres(side, points, np.zeros(len(points)), _REACH * length)


def packed_spheres(side: int, length: float, draw: np.random.Generator) -> np.ndarray:
    """Return minus the distance to the nearest of points that keep apart: spheres of one size."""
    points = _spread_points(side, length, draw)
    return _spheres(side, points, np.zeros(len(points)), _REACH * length)


def mixed_spheres(side: int, length: float, draw: np.random.Generator) -> np.ndarray:
    """Return minus the distance to the nearest surface of spheres of many sizes that keep apart:
    placed by chance, the largest first.
    """
    radii = _RADIUS * length * np.exp(_SPREAD * draw.standard_normal(_count(side, length)))
    radii = np.sort(np.minimum(radii, _LARGEST * length))[::-1].copy()
    points = np.empty((len(radii), 3))
    tries = draw.random((len(radii), _TRIES, 3)) * side
    placed = place_spheres(tries, radii, _GAP * length, float(side), points)
    return _spheres(side, points[placed], radii[placed], _REACH * length)


def struts(side: int, length: float, draw: np.random.Generator) -> np.ndarray:
    """Return minus the distance to the edges between the Voronoi cells of points that keep apart:
    an open foam.
    """
    return _cells(side, length, draw, 0.0)


def struts_and_plates(side: int, length: float, draw: np.random.Generator) -> np.ndarray:
    """Return `struts` with a share of the walls between cells as plates, as bone has them."""
    return _cells(side, length, draw, _PLATES)


def walls(side: int, length: float, draw: np.random.Generator) -> np.ndarray:
    """Return minus the distance to the walls between such cells: a closed foam, or cracks."""
    return _cells(side, length, draw, 1.0)


def fibres(side: int, length: float, draw: np.random.Generator) -> np.ndarray:
    """Return minus the distance to the nearest of straight lines in all directions."""
    count = max(1, round(_LINES * (side / length) ** 2))
    along = draw.standard_normal((count, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    through, square = draw.random((count, 3)) * side, np.empty((side,) * 3, np.float32)
    for_slabs(lambda a, b: line_distances(through, along, square, a, b), side)
    return -np.sqrt(square)


_FIELDS = {
    "gaussian": gaussian_field,
    "waves": waves,
    "sheets": sheets,
    "overlapping_spheres": overlapping_spheres,
    "packed_spheres": packed_spheres,
    "mixed_spheres": mixed_spheres,
    "struts": struts,
    "struts_and_plates": struts_and_plates,
    "walls": walls,
    "fibres": fibres,
}


def process_field(name: str, side: int, length: float) -> np.ndarray:
    """Return the field of a process, always the same one: high where the second phase is.

    Parameters
    ----------
    name : str
        One of `config.PROCESSES`.
    side : int
        Of the box, voxels.
    length : float
        Mean distance between bodies, voxels; of fields and sheets it sets the wave length.

    Returns
    -------
    field : float32 array, (side, side, side)
    """
    body = name.removeprefix("void_")
    field = _FIELDS[body](side, length, generator(0, f"process/{body}"))
    return field if name == body else -field


def _count(side: int, length: float) -> int:
    return max(8, round((side / length) ** 3))


def _filtered(
    side: int, draw: np.random.Generator, gain: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Return white noise filtered by a gain of the wave number (cycles a voxel)."""
    whole, half = np.fft.fftfreq(side), np.fft.rfftfreq(side)
    wave = np.sqrt(whole[:, None, None] ** 2 + whole[None, :, None] ** 2 + half**2)
    spectrum = np.fft.rfftn(draw.standard_normal((side,) * 3)) * gain(wave)
    return np.fft.irfftn(spectrum, (side,) * 3, axes=(0, 1, 2)).astype(np.float32)


def _spread_points(side: int, length: float, draw: np.random.Generator) -> np.ndarray:
    """Return points (n, 3) that have pushed each other apart."""
    points = draw.random((_count(side, length), 3)) * side
    for _ in range(_STEPS):
        steps = np.zeros_like(points)
        push_apart(points, _NEAR * length, float(side), steps)
        points = (points + _PUSH * steps) % side
    return points


def _spheres(side: int, points: np.ndarray, radii: np.ndarray, reach: float) -> np.ndarray:
    field = np.full((side,) * 3, np.float32(reach))
    for_slabs(lambda a, b: sphere_distances(points, radii, np.float32(reach), field, a, b), side)
    return -field


def _cells(side: int, length: float, draw: np.random.Generator, plates: float) -> np.ndarray:
    points = _spread_points(side, length, draw)
    chosen = draw.random((len(points),) * 2) < plates
    chosen |= chosen.T
    return -cell_field(points, chosen, side)


def cell_field(points: np.ndarray, plates: np.ndarray, side: int) -> np.ndarray:
    """Return the distance of every voxel to the nearest edge of its Voronoi cell, or to the nearest
    of its walls that is a plate: (side, side, side) float32, of points (n, 3) and plates (n, n).
    """

    def squares(offset: np.ndarray) -> np.ndarray:
        return np.asarray((offset - side * np.rint(offset / side)) ** 2)

    apart = np.sqrt(squares(points[:, None] - points).sum(axis=-1))
    along = np.ascontiguousarray(
        np.moveaxis(squares(np.arange(side)[:, None, None] + 0.5 - points), -1, 0)
    )
    field = np.empty((side,) * 3, np.float32)
    count = -(-side // _BLOCK)

    def work(start: int, stop: int) -> None:
        for z, y, x in np.ndindex(stop - start, count, count):
            corner = _BLOCK * np.array([start + z, y, x])
            from_middle = np.sqrt(squares(corner + _BLOCK / 2 - points).sum(axis=-1))
            order = np.argsort(from_middle)
            cell_distances(along, apart, plates, order, from_middle[order], corner, field)

    for_slabs(work, count)
    return field


@inline
def _square_between(one, other, side):
    """Return the squared distance of two points (3,) in a box that repeats."""
    square = 0.0
    for axis in range(3):
        d = one[axis] - other[axis]
        d -= side * np.rint(d / side)
        square += d * d
    return square


@kernel
def push_apart(points, near, side, steps):
    """Add to the steps (n, 3) of points nearer than `near` half of what they lack, away from each
    other.
    """
    for i in range(len(points)):
        for j in range(i):
            square = _square_between(points[i], points[j], side)
            if square >= near * near or square == 0:
                continue
            share = near / np.sqrt(square) - 1
            for axis in range(3):
                d = points[i, axis] - points[j, axis]
                d -= side * np.rint(d / side)
                steps[i, axis] += share * d
                steps[j, axis] -= share * d


@kernel
def place_spheres(tries, radii, gap, side, points):
    """Write the place of every sphere: the first of its tries (n, t, 3) that no earlier one
    overlaps; return which have one.
    """
    placed = np.zeros(len(radii), np.bool_)
    for i in range(len(radii)):
        for t in range(tries.shape[1]):
            free = True
            for j in range(i):
                if not placed[j]:
                    continue
                square = _square_between(tries[i, t], points[j], side)
                if square < (radii[i] + radii[j] + gap) ** 2:
                    free = False
                    break
            if free:
                copy_row(points[i], tries[i, t])
                placed[i] = True
                break
    return placed


@kernel
def sphere_distances(points, radii, reach, field, start, stop):
    """Lower planes start..stop of a field to the distance to the surface of the nearest sphere, as
    far as `reach` from it.
    """
    side = field.shape[0]
    for i in range(len(points)):
        far = np.int64(np.ceil(radii[i] + reach))
        first = [np.int64(np.floor(points[i, axis])) - far for axis in range(3)]
        for az in range(first[0], first[0] + 2 * far + 2):
            z = az % side
            if z < start or z >= stop:
                continue
            dz = az + 0.5 - points[i, 0]
            for ay in range(first[1], first[1] + 2 * far + 2):
                y, dy = ay % side, ay + 0.5 - points[i, 1]
                for ax in range(first[2], first[2] + 2 * far + 2):
                    dx = ax + 0.5 - points[i, 2]
                    d = np.float32(np.sqrt(dz * dz + dy * dy + dx * dx) - radii[i])
                    x = ax % side
                    if d < field[z, y, x]:
                        field[z, y, x] = d


@kernel
def cell_distances(along, apart, plates, order, from_middle, corner, field):
    """Write a block of `cell_field` from its `corner`, of the squared offsets (3, side, n) from
    points along every axis and the distances (n, n) between them; the points in `order` of their
    distance from the middle of the block.

    On an edge the second nearest wall is at 0 as well as the nearest. The wall to a point is at
    least half as far as the point is farther than the nearest.
    """
    side, reach = field.shape[0], _BLOCK * _HALF_DIAGONAL
    for z in range(corner[0], min(corner[0] + _BLOCK, side)):
        for y in range(corner[1], min(corner[1] + _BLOCK, side)):
            for x in range(corner[2], min(corner[2] + _BLOCK, side)):
                own, nearest, near = -1, np.inf, np.inf
                for n in range(len(order)):
                    if from_middle[n] - reach > near:
                        break
                    i = order[n]
                    square = along[0, z, i] + along[1, y, i] + along[2, x, i]
                    if square < nearest:
                        own, nearest, near = i, square, np.sqrt(square)
                wall, edge, plate = np.inf, np.inf, np.inf
                for n in range(len(order)):
                    if from_middle[n] - reach - near > 2 * min(edge, plate):
                        break
                    i = order[n]
                    if i == own:
                        continue
                    square = along[0, z, i] + along[1, y, i] + along[2, x, i]
                    d = 0.5 * (square - nearest) / apart[own, i]
                    if d < wall:
                        wall, edge = d, wall
                    elif d < edge:
                        edge = d
                    if plates[own, i] and d < plate:
                        plate = d
                field[z, y, x] = min(edge, plate)


@kernel
def line_distances(through, along, square, start, stop):
    """Write the squared distance of the voxels of planes start..stop to the nearest line."""
    side = square.shape[0]
    for z in range(start, stop):
        for y in range(side):
            for x in range(side):
                best = np.inf
                for i in range(len(through)):
                    dz, dy = z + 0.5 - through[i, 0], y + 0.5 - through[i, 1]
                    dx = x + 0.5 - through[i, 2]
                    t = dz * along[i, 0] + dy * along[i, 1] + dx * along[i, 2]
                    d = dz * dz + dy * dy + dx * dx - t * t
                    if d < best:
                        best = d
                square[z, y, x] = max(best, 0.0)
