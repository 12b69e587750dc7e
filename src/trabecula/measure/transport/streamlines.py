"""Streamlines of the flow that `permeability` solves.

Velocities are kept on the faces of voxels, as they are solved, and are linear between two opposite
faces of a voxel (Pollock 1988, doi:10.1111/j.1745-6584.1988.tb00425.x, whose field this is; steps
are of second order here). So no line crosses a wall, where the velocity of the face is zero.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.seeds import generator
from trabecula.engine.compile import inline, kernel
from trabecula.measure.centre_crop import check_memory
from trabecula.measure.phases import as_axis, as_inside, indicator
from trabecula.measure.transport.permeability import FLOW_BYTES, solve_flow
from trabecula.measure.transport.section import as_tolerance, forecast_bytes, percolating_voxels

_STEP = 0.25  # voxels
_KEPT = 4  # steps between two points that are kept
_AWAY = 1e-3  # voxels from a wall
_TURNS = 60  # lengths of the image after which a line ends


def streamlines(
    image: Image | ArrayLike,
    *,
    axis: int,
    count: int = 100,
    phase: str | int | None = None,
    seed: int = 0,
    tolerance: float = 1e-3,
) -> list[np.ndarray]:
    """Return streamlines of slow viscous flow through a phase along one axis.

    The flow is that of `permeability`. Lines start on the near end face, as many in a part of it as
    fluid enters there: each carries the same share of the flow.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
    axis : int
        0 is z; negative counts from the back.
    count : int
        1 .. 10000 lines.
    phase : str or int, optional
        Default: "void".
    seed : int
        Of where they start.
    tolerance : float, 1e-10 .. 0.1
        Of the flow, as of `permeability`.

    Returns
    -------
    lines : list of (N, 4) float32
        z, y and x in voxels, the corner of the first one at 0, some one voxel apart; and the speed,
        over the mean speed in the voxels that carry flow. No lines where the phase does not
        percolate.

    Raises
    ------
    InputError
        A picture, no such axis or phase, a number out of range, a phase that fills the image.
    MemoryBudgetError
        More memory would be needed than there is: crop the image.
    """
    image, inside = indicator(image, phase, default="void")
    if image.ndim != 3:
        raise InputError(f"streamlines are of volumes, got an image of shape {image.shape}")
    front = as_axis(axis, 3)
    count = int(as_number(count, name="count", low=1, high=10000, whole=True))
    cut = np.ascontiguousarray(np.moveaxis(as_inside(inside).reshape(image.shape), front, 0))
    edges = np.array([image.spacing[front], *np.delete(image.spacing, front)])
    if cut.all():
        raise InputError("the phase fills the image: nothing holds the flow back")
    check_memory(forecast_bytes(cut, FLOW_BYTES))
    active = percolating_voxels(cut)
    if active is None:
        return []
    faces = _face_velocities(active, edges / edges.min(), as_tolerance(tolerance))
    starts = _starts(faces[0][0], count, seed)
    points = np.empty((_TURNS * max(cut.shape), 4))
    lines = []
    for start in starts:
        many = _trace(*faces, start, _STEP, _KEPT, points)
        lines.append(points[:many].astype(np.float32))
    mean = _mean_speed(*faces, active)
    for line in lines:
        line[:, 3] /= mean
        line[:, : front + 1] = np.roll(line[:, : front + 1], -1, axis=1)
    return [line for line in lines if len(line) > 1]


def _face_velocities(
    active: np.ndarray, edges: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the velocities across the faces of the voxels, along each axis one more of them, in
    voxels of that axis over time.
    """
    grid, x = solve_flow(active, edges, tolerance=tolerance)[:2]
    found = []
    for axis, (face, values) in enumerate(zip(grid.faces, grid.parts(x), strict=False)):
        faces = np.zeros([side + (axis == d) for d, side in enumerate(active.shape)], np.float32)
        _scatter(face.table, face.place, values, faces)
        found.append(faces / np.float32(edges[axis]))
    return found[0], found[1], found[2]


def _starts(inflow: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Return points (N, 3) on the near end face, evenly over what flows in."""
    chance = generator(seed, "streamlines")
    share = np.maximum(inflow, 0).astype(np.float64).ravel().cumsum()
    at = (np.arange(count) + chance.random(count)) / count * share[-1]
    cells = np.minimum(np.searchsorted(share, at, side="right"), share.size - 1)
    within = chance.random((count, 2))
    y, x = np.unravel_index(cells, inflow.shape)
    return np.stack([np.full(count, 1e-3), y + within[:, 0], x + within[:, 1]], axis=1)


@kernel
def _scatter(table, place, values, faces):
    """Write the velocities of segments to the faces of the grid."""
    for s in range(len(table)):
        z, y, x = place[s, 0], place[s, 1], place[s, 2]
        for k in range(table[s, 1]):
            faces[z, y, x + k] = values[table[s, 0] + k]


@inline
def _voxel(place, side):
    """Return the voxel of a place along an axis."""
    return min(max(int(np.floor(place)), 0), side - 1)


@inline
def _within(place, voxel, below, above):
    """Return a place along an axis, kept in its voxel at a face that nothing flows through."""
    if place < voxel and below == 0:
        return voxel + _AWAY
    if place >= voxel + 1 and above == 0:
        return voxel + 1 - _AWAY
    return place


@inline
def _rate(along_z, along_y, along_x, z, y, x):
    """Return the velocity at a point, in voxels along z, y and x over time."""
    k, j, i = _voxel(z, along_y.shape[0]), _voxel(y, along_z.shape[1]), _voxel(x, along_z.shape[2])
    tz, ty, tx = z - k, y - j, x - i
    return (
        along_z[k, j, i] * (1 - tz) + along_z[k + 1, j, i] * tz,
        along_y[k, j, i] * (1 - ty) + along_y[k, j + 1, i] * ty,
        along_x[k, j, i] * (1 - tx) + along_x[k, j, i + 1] * tx,
    )


@kernel
def _trace(along_z, along_y, along_x, start, step, kept, points):
    """Fill points (N, 4) of a line from a point on, by the midpoint rule; return their number.

    A line ends where it leaves the first axis, where nothing moves, or when there is no more room.
    """
    z, y, x = start[0], start[1], start[2]
    depth = along_y.shape[0]
    count, at = 0, 0
    while count < len(points):
        vz, vy, vx = _rate(along_z, along_y, along_x, z, y, x)
        speed = np.sqrt(vz * vz + vy * vy + vx * vx)
        out = z < 0 or z >= depth or speed <= 0
        if at % kept == 0 or out:
            points[count, 0], points[count, 1], points[count, 2] = z, y, x
            points[count, 3] = speed
            count += 1
        if out:
            break
        half = 0.5 * step / speed
        mz, my, mx = _rate(along_z, along_y, along_x, z + half * vz, y + half * vy, x + half * vx)
        size = np.sqrt(mz * mz + my * my + mx * mx)
        if size <= 0:
            break
        # A step near a stagnation point may pass a wall: a face without flow stops it.
        k, j, i = _voxel(z, depth), _voxel(y, along_z.shape[1]), _voxel(x, along_z.shape[2])
        z = _within(z + step * mz / size, k, along_z[k, j, i], along_z[k + 1, j, i])
        k = _voxel(z, depth)
        y = _within(y + step * my / size, j, along_y[k, j, i], along_y[k, j + 1, i])
        j = _voxel(y, along_z.shape[1])
        x = _within(x + step * mx / size, i, along_x[k, j, i], along_x[k, j, i + 1])
        at += 1
    return count


@kernel
def _mean_speed(along_z, along_y, along_x, active):
    """Return the mean speed at the middles of the voxels that carry flow."""
    total, count = 0.0, 0
    for z in range(active.shape[0]):
        for y in range(active.shape[1]):
            for x in range(active.shape[2]):
                if active[z, y, x]:
                    vz, vy, vx = _rate(along_z, along_y, along_x, z + 0.5, y + 0.5, x + 0.5)
                    total += np.sqrt(vz * vz + vy * vy + vx * vx)
                    count += 1
    return total / count
