"""The struts that are thinner than a length, for `thicken` and the print check.

A voxel is thin if its local thickness (the largest sphere of the phase that contains it) is below
the length. So is every sharp corner of a thick region, hence not all thin voxels count, but only
the *cores*: those about as deep as the centre of that largest sphere. At a corner the radius of the
sphere exceeds the voxel's depth: by 1.4 times or more along the edge of a right angle. Along a
strut, and at its waist, both are nearly the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.finish.labels import lift
from trabecula.measure.distance import distance_transform
from trabecula.measure.phases import as_periodic
from trabecula.measure.spheres import paint_largest

DEEP = 0.75
"""Least depth of a core's voxel over the radius of the largest sphere that contains it."""


@dataclass(frozen=True)
class Cores:
    """The cores of thin struts and walls.

    Parameters
    ----------
    places : (n, 3) int array
        z, y, x.
    depth : (n,) float32 array
        Distance to the nearest voxel that is not of the phase.
    aside : (n,) float32 array
        Radius of the largest sphere minus depth: how far the middle of the strut is away.
    thinnest : float
        The smallest local thickness among them, infinite where there are none.
    share : float
        Share of the phase that is thin and belongs to their struts, 0..1.
    """

    places: np.ndarray
    depth: np.ndarray
    aside: np.ndarray
    thinnest: float
    share: float


def thin_cores(
    inside: np.ndarray,
    spacing: tuple[float, ...],
    thickness: float,
    wraps: Sequence[bool] | bool = False,
) -> Cores:
    """Find the cores of struts and walls whose local thickness is below `thickness`.

    By more than half a voxel, the error of a local thickness.

    Parameters
    ----------
    inside : (Z, Y, X) or (Y, X) bool array
        The phase; at least one voxel is not of it.
    spacing : tuple of float
        Edge of a voxel along every axis.
    thickness : float
        In the unit of `spacing`.
    wraps : bool or one per axis
        Struts continue at the opposite face.
    """
    wraps = as_periodic(wraps, inside.ndim)
    # In units of the smallest edge, as `measure.spheres` expects.
    scale = min(spacing)
    steps = tuple(edge / scale for edge in spacing)
    depth = distance_transform(inside, spacing=steps, periodic=wraps)
    radius = _radius_where_thin(inside, depth, steps, thickness / scale, wraps)
    found = (radius > 0) & (depth >= DEEP * radius)
    places = np.argwhere(lift(found))
    thinnest = float(2 * radius[found].min() - 0.5) if len(places) else float("inf")
    # The voxels between a sphere and the surface around it belong to the strut as well.
    around = balls(places, depth[found] + 1, inside.shape, steps, wraps)
    share = np.count_nonzero((radius > 0) & around) / max(1, np.count_nonzero(inside))
    return Cores(
        places, depth[found] * scale, (radius - depth)[found] * scale, thinnest * scale, share
    )


def _radius_where_thin(
    inside: np.ndarray,
    depth: np.ndarray,
    steps: tuple[float, ...],
    thickness: float,
    wraps: tuple[bool, ...],
) -> np.ndarray:
    """Return the radius of the largest sphere that contains each voxel where it is thin, else 0.

    A local thickness is the sphere's diameter minus half a voxel (`measure.local_thickness`), and
    half a voxel below `thickness` is allowed; the two cancel, so a voxel is thin where the diameter
    itself is below `thickness`. Where most voxels are not thin, only those spheres are painted that
    contain a voxel outside of all spheres of diameter `thickness`.
    """
    deep = depth >= thickness / 2
    if inside.all():
        return np.zeros_like(depth)
    doubtful, needed = inside, depth
    # Two more distances are worth their time only where they spare most of the spheres; the result
    # is the same.
    if 2 * np.count_nonzero(deep) > np.count_nonzero(inside):
        doubtful = inside & (
            distance_transform(~deep, spacing=steps, periodic=wraps) >= thickness / 2
        )
        if not doubtful.any():
            return np.zeros_like(depth)
        near = distance_transform(~doubtful, spacing=steps, periodic=wraps) < depth
        needed = np.where(near, depth, np.float32(0))
    edges = np.array((max(steps),) * (3 - inside.ndim) + steps)
    lifted_wraps = (False,) * (3 - inside.ndim) + wraps
    diameter = paint_largest(lift(needed), edges, lifted_wraps).reshape(inside.shape)
    return np.where(doubtful & (diameter < thickness - 0.001), diameter / 2, np.float32(0))


def balls(
    places: np.ndarray,
    radius: np.ndarray,
    shape: tuple[int, ...],
    spacing: tuple[float, ...],
    wraps: Sequence[bool] | bool = False,
) -> np.ndarray:
    """Return a bool array of `shape`: True within `radius` (n,) of the voxels `places` (n, 3).

    Distances are between the centres of voxels, and wrap around the faces where `wraps` says
    so; `shape` has 2 or 3 axes.
    """
    lifted = (1,) * (3 - len(shape)) + shape
    edges = np.array((max(spacing),) * (3 - len(shape)) + tuple(spacing))
    painted = np.zeros(lifted, bool)
    reach = np.ascontiguousarray(radius, np.float64)
    for axis in np.flatnonzero(as_periodic(wraps, len(shape))) + 3 - len(shape):
        places, reach = _repeat_centres(places, reach, int(axis), lifted[axis], edges[axis])
    for_slabs(lambda start, stop: _paint(places, reach, edges, painted, start, stop), lifted[0])
    return painted.reshape(shape)


def _repeat_centres(
    places: np.ndarray, radius: np.ndarray, axis: int, side: int, edge: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return centres and radii of balls with those of the periodic images that reach into the
    volume from beyond a face.
    """
    far = radius * (1 + 1e-6) / edge
    count = int(np.ceil(far.max(initial=0) / side))
    centres, radii = [], []
    for step in range(-count, count + 1):
        moved = places + step * side * np.eye(3, dtype=places.dtype)[axis]
        near = (moved[:, axis] + far >= 0) & (moved[:, axis] - far < side)
        centres.append(moved[near])
        radii.append(radius[near])
    return np.concatenate(centres), np.concatenate(radii)


@kernel
def _paint(places, radius, spacing, painted, start, stop):
    _, height, width = painted.shape
    for n in range(len(places)):
        z, y, x = places[n, 0], places[n, 1], places[n, 2]
        # A hair more, so that a distance of exactly the radius counts in every unit.
        limit = radius[n] * radius[n] * (1.0 + 1e-6)
        deep = int(np.sqrt(limit) / spacing[0])
        for k in range(max(z - deep, start), min(z + deep + 1, stop)):
            rest = limit - ((k - z) * spacing[0]) ** 2
            if rest < 0.0:
                continue
            wide = int(np.sqrt(rest) / spacing[1])
            for j in range(max(y - wide, 0), min(y + wide + 1, height)):
                left = rest - ((j - y) * spacing[1]) ** 2
                if left >= 0.0:
                    half = int(np.sqrt(left) / spacing[2])
                    # A centre may be beyond a face; a slice must not end below 0.
                    painted[k, j, max(x - half, 0) : max(min(x + half + 1, width), 0)] = True
