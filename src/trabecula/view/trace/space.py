"""Rays in the volume: plain functions on arrays.

Positions (x, y, z) are true lengths in smallest voxel edges, the corner of voxel 0 at 0. The
material is where both the smooth field and the depth inside what is kept of the cut are positive.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.view.trace.surface import STEPS

FAR = 1e30
BLOCK = 4
"""Edge of the blocks that are skipped, voxels."""

FURTHEST = 15
"""Blocks that are skipped at once, at most."""

LEAST_STEP = 0.12
"""Edges of a voxel that a ray advances at least."""


class Space(NamedTuple):
    """A prepared volume.

    field (Z, Y, X) int16: `surface.smooth_surface`. labels (Z, Y, X) uint8. colours (Z, Y, X, 3)
    uint8, or of length 0. skip: blocks to the nearest that holds material. form (22,): `pack_form`.
    rim: depth below the outside, coarse, and `coarse` (3,) its voxels' edges.

    Kernels take the arrays one by one: a tuple of many would be copied at every call.
    """

    field: np.ndarray
    labels: np.ndarray
    colours: np.ndarray
    skip: np.ndarray
    form: np.ndarray
    rim: np.ndarray
    coarse: np.ndarray


PER, STRETCH, BOX, PLANE = 0, 3, 6, 18


def pack_form(stretch: np.ndarray, box: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """Pack (22,): one over the edges of a voxel, these edges, corners (4, 3) of what is kept and of
    what is taken out of it, and a plane (4,) beyond which all is cut away.
    """
    return np.concatenate([1.0 / stretch, stretch, box.ravel(), plane])


@kernel
def find_blocks(field, out):
    """Write 0 for blocks that hold material or touch it, else FURTHEST."""
    for k in range(out.shape[0]):
        for j in range(out.shape[1]):
            for i in range(out.shape[2]):
                found = False
                for z in range(max(k * BLOCK - 1, 0), min(k * BLOCK + BLOCK + 1, field.shape[0])):
                    for y in range(
                        max(j * BLOCK - 1, 0), min(j * BLOCK + BLOCK + 1, field.shape[1])
                    ):
                        for x in range(
                            max(i * BLOCK - 1, 0), min(i * BLOCK + BLOCK + 1, field.shape[2])
                        ):
                            found = found or field[z, y, x] >= 0
                out[k, j, i] = 0 if found else FURTHEST


@kernel
def spread_blocks(out):
    """Turn 0 and FURTHEST into the distance to the nearest 0, the largest of the three axes'."""
    depth, height, width = out.shape
    for direction in range(2):
        sign = 1 if direction == 0 else -1
        for kk in range(depth):
            k = kk if direction == 0 else depth - 1 - kk
            for jj in range(height):
                j = jj if direction == 0 else height - 1 - jj
                for ii in range(width):
                    i = ii if direction == 0 else width - 1 - ii
                    best = np.int64(out[k, j, i])
                    for n in range(13):  # the neighbours that were visited before
                        dz, dy, dx = n // 9 - 1, (n // 3) % 3 - 1, n % 3 - 1
                        a, b, c = k + sign * dz, j + sign * dy, i + sign * dx
                        if 0 <= a < depth and 0 <= b < height and 0 <= c < width:
                            best = min(best, out[a, b, c] + 1)
                    out[k, j, i] = best


@inline
def sample(field, u, v, w):
    """Interpolate trilinearly at (x, y, z) in voxels, edge values repeated."""
    depth, height, width = field.shape
    u = min(max(u - 0.5, 0.0), width - 1.0)
    v = min(max(v - 0.5, 0.0), height - 1.0)
    w = min(max(w - 0.5, 0.0), depth - 1.0)
    # whole numbers without a sign: no index counts from the end, which spares a branch a load
    i, j, k = np.uint64(u), np.uint64(v), np.uint64(w)
    i1 = np.uint64(min(u + 1.0, width - 1.0))
    j1 = np.uint64(min(v + 1.0, height - 1.0))
    k1 = np.uint64(min(w + 1.0, depth - 1.0))
    fu, fv, fw = u - np.float64(i), v - np.float64(j), w - np.float64(k)
    a, b = np.float64(field[k, j, i]), np.float64(field[k, j1, i])
    c, d = np.float64(field[k1, j, i]), np.float64(field[k1, j1, i])
    a += (field[k, j, i1] - a) * fu
    b += (field[k, j1, i1] - b) * fu
    c += (field[k1, j, i1] - c) * fu
    d += (field[k1, j1, i1] - d) * fu
    a += (b - a) * fv
    c += (d - c) * fv
    return a + (c - a) * fw


@inline
def kept_depth(form, x, y, z):
    """Return how deep a point lies inside what is kept; below 0 outside of it."""
    depth = min(min(x - form[6], form[9] - x), min(y - form[7], form[10] - y))
    depth = min(depth, min(z - form[8], form[11] - z))
    taken = max(max(form[12] - x, x - form[15]), max(form[13] - y, y - form[16]))
    depth = min(depth, max(taken, max(form[14] - z, z - form[17])))
    return min(depth, form[21] - form[18] * x - form[19] * y - form[20] * z)


@inline
def depth_at(field, form, x, y, z):
    """Return a value that is positive in the material, and never more than the distance to its
    surface.
    """
    kept = kept_depth(form, x, y, z)
    if kept <= -1.0:
        return kept
    return min(kept, sample(field, x * form[0], y * form[1], z * form[2]) * (1.0 / STEPS))


@inline
def normal_at(field, form, x, y, z, normal):
    """Write the outward normal; return whether it is that of a cut."""
    u, v, w = x * form[0], y * form[1], z * form[2]
    if kept_depth(form, x, y, z) < sample(field, u, v, w) * (1.0 / STEPS):
        reach = 1e-3  # the faces are flat: a short difference is exact
        for axis in range(3):
            dx, dy, dz = reach * (axis == 0), reach * (axis == 1), reach * (axis == 2)
            normal[axis] = kept_depth(form, x - dx, y - dy, z - dz) - kept_depth(
                form, x + dx, y + dy, z + dz
            )
        cut = True
    else:
        r = 0.8
        normal[0] = form[0] * (sample(field, u - r, v, w) - sample(field, u + r, v, w))
        normal[1] = form[1] * (sample(field, u, v - r, w) - sample(field, u, v + r, w))
        normal[2] = form[2] * (sample(field, u, v, w - r) - sample(field, u, v, w + r))
        cut = False
    length = math.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    if length > 0:
        normal[0] /= length
        normal[1] /= length
        normal[2] /= length
    else:
        normal[2] = 1.0
    return cut


@inline
def _jump(skip, form, x, y, z, direction):
    """Return the length to the far side of the empty blocks around a point, else 0."""
    i = min(max(int(x * form[0]) >> 2, 0), skip.shape[2] - 1)
    j = min(max(int(y * form[1]) >> 2, 0), skip.shape[1] - 1)
    k = min(max(int(z * form[2]) >> 2, 0), skip.shape[0] - 1)
    free = skip[k, j, i] - 1
    if free < 0:
        return 0.0
    edges = (BLOCK * form[3], BLOCK * form[4], BLOCK * form[5])
    step = FAR
    if abs(direction[0]) > 1e-12:
        to = (i + 1 + free) if direction[0] > 0 else (i - free)
        step = min(step, (to * edges[0] - x) / direction[0])
    if abs(direction[1]) > 1e-12:
        to = (j + 1 + free) if direction[1] > 0 else (j - free)
        step = min(step, (to * edges[1] - y) / direction[1])
    if abs(direction[2]) > 1e-12:
        to = (k + 1 + free) if direction[2] > 0 else (k - free)
        step = min(step, (to * edges[2] - z) / direction[2])
    return max(step, 0.0) + 1e-3


@inline
def meet(field, skip, form, origin, direction):
    """Return the length at which a ray from outside enters the material, or FAR."""
    start, stop = 0.0, FAR
    for axis in range(3):
        low, high = form[6 + axis], form[9 + axis]
        if abs(direction[axis]) < 1e-12:
            if origin[axis] < low or origin[axis] > high:
                return FAR
            continue
        near, far = (low - origin[axis]) / direction[axis], (high - origin[axis]) / direction[axis]
        start, stop = max(start, min(near, far)), min(stop, max(near, far))
    if not stop < FAR:  # no direction
        return FAR
    t = start + 1e-4
    before, outer = start, -1.0
    while t < stop:
        x, y, z = (
            origin[0] + t * direction[0],
            origin[1] + t * direction[1],
            origin[2] + t * direction[2],
        )
        jump = _jump(skip, form, x, y, z, direction)
        if jump > 0:
            before, outer = t, -1.0
            t += jump
            continue
        depth = depth_at(field, form, x, y, z)
        if depth >= 0:
            # regula falsi: the field is nearly linear near the surface
            inside, above, below = t, depth, outer
            for _ in range(4):
                share = below / (below - above) if below < 0 else 0.0
                middle = before + min(max(share, 0.05), 0.95) * (inside - before)
                depth = depth_at(
                    field,
                    form,
                    origin[0] + middle * direction[0],
                    origin[1] + middle * direction[1],
                    origin[2] + middle * direction[2],
                )
                if depth >= 0:
                    inside, above = middle, depth
                else:
                    before, below = middle, depth
                if abs(depth) < 2e-3:
                    break
            return inside
        before, outer = t, depth
        t += max(LEAST_STEP, -0.95 * depth)
    return FAR


@inline
def leave(field, form, origin, direction, longest):
    """Return the length at which a ray from inside leaves the material, at most `longest`."""
    t, before, above = 0.0, 0.0, 1e-3
    while True:
        depth = depth_at(
            field,
            form,
            origin[0] + t * direction[0],
            origin[1] + t * direction[1],
            origin[2] + t * direction[2],
        )
        if depth < 0:
            outside, below = t, depth
            for _ in range(3):
                share = min(max(above / (above - below), 0.05), 0.95)
                middle = before + share * (outside - before)
                depth = depth_at(
                    field,
                    form,
                    origin[0] + middle * direction[0],
                    origin[1] + middle * direction[1],
                    origin[2] + middle * direction[2],
                )
                if depth < 0:
                    outside, below = middle, depth
                else:
                    before, above = middle, depth
                if abs(depth) < 4e-3:
                    break
            return outside
        if t + depth >= longest and depth > LEAST_STEP:
            return longest
        before, above = t, max(depth, 1e-6)
        t += max(LEAST_STEP, 0.95 * depth)
        if t >= longest:
            return longest


@inline
def step_out(field, form, point, normal, off):
    """Move a point on the surface along its normal until it is outside by `off`."""
    for _ in range(4):
        depth = depth_at(field, form, point[0], point[1], point[2])
        if depth <= -0.5 * off:
            return
        for axis in range(3):
            point[axis] += normal[axis] * (off + max(depth, 0.0))


@inline
def rim_depth(rim, coarse, x, y, z):
    """Return the depth below the outside of the form, edges of a voxel."""
    if rim.shape[0] == 0:
        return FAR
    return sample(rim, x / coarse[0], y / coarse[1], z / coarse[2])
