"""Meeting of rays and a surface: plain functions on arrays.

Glossary: positions are in voxels as (x, y, z), the corner of voxel 0 at 0, so a voxel's centre is
at +0.5. `stretch` is the spacing over its smallest axis; directions of rays are divided by it, so
that their parameter t is a true length in smallest voxel edges. `field` is the drawn phases'
indicator, slightly blurred, 0..255; the surface is where it crosses ISO. `box` (4, 3): the lower
and upper corner of the part that is kept, then of the part taken out of it. `plane` (4,): a normal
in true space and an offset in smallest voxel edges; kept is where normal . position <= offset.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline

ISO = 127.5
BLOCK = 4
"""Edge of the blocks that are skipped where they hold no surface, voxels."""

FAR = 1e30


@inline
def point(origin, direction, t):
    """Return the point of a ray at length t."""
    return (
        origin[0] + t * direction[0],
        origin[1] + t * direction[1],
        origin[2] + t * direction[2],
    )


@inline
def sample(field, x, y, z):
    """Interpolate trilinearly, edge values repeated."""
    u = min(max(x - 0.5, 0.0), field.shape[2] - 1.0)
    v = min(max(y - 0.5, 0.0), field.shape[1] - 1.0)
    w = min(max(z - 0.5, 0.0), field.shape[0] - 1.0)
    i, j, k = int(u), int(v), int(w)
    fu, fv, fw = u - i, v - j, w - k
    i1, j1 = min(i + 1, field.shape[2] - 1), min(j + 1, field.shape[1] - 1)
    k1 = min(k + 1, field.shape[0] - 1)
    low = (field[k, j, i] * (1 - fu) + field[k, j, i1] * fu) * (1 - fv) + (
        field[k, j1, i] * (1 - fu) + field[k, j1, i1] * fu
    ) * fv
    high = (field[k1, j, i] * (1 - fu) + field[k1, j, i1] * fu) * (1 - fv) + (
        field[k1, j1, i] * (1 - fu) + field[k1, j1, i1] * fu
    ) * fv
    return low * (1 - fw) + high * fw


@inline
def is_cut(box, plane, stretch, x, y, z):
    """Return whether a point was cut away: beyond the kept part, inside the part taken out, or
    beyond the plane.
    """
    if (
        x < box[0, 0]
        or y < box[0, 1]
        or z < box[0, 2]
        or x > box[1, 0]
        or y > box[1, 1]
        or z > box[1, 2]
    ):
        return True
    if box[2, 0] < x < box[3, 0] and box[2, 1] < y < box[3, 1] and box[2, 2] < z < box[3, 2]:
        return True
    return (
        plane[0] * x * stretch[0] + plane[1] * y * stretch[1] + plane[2] * z * stretch[2] > plane[3]
    )


@inline
def _span(origin, direction, low, high):
    """Return the span of a ray inside a box: entry, exit, and the axes of the faces it passes."""
    enter, leave, enter_axis, leave_axis = -FAR, FAR, 0, 0
    for axis in range(3):
        if abs(direction[axis]) < 1e-12:
            if origin[axis] < low[axis] or origin[axis] > high[axis]:
                return FAR, -FAR, 0, 0
            continue
        near = (low[axis] - origin[axis]) / direction[axis]
        far = (high[axis] - origin[axis]) / direction[axis]
        if near > far:
            near, far = far, near
        if near > enter:
            enter, enter_axis = near, axis
        if far < leave:
            leave, leave_axis = far, axis
    return enter, leave, enter_axis, leave_axis


@inline
def _clip_span(origin, direction, box, plane, stretch, normal):
    """Return the span of a ray inside the kept part: start and stop; `normal` is written, outward
    at the start.
    """
    start, stop, axis, _ = _span(origin, direction, box[0], box[1])
    normal[:] = 0.0
    normal[axis] = -np.sign(direction[axis])
    rate, height = 0.0, -plane[3]
    for axis in range(3):
        rate += plane[axis] * direction[axis] * stretch[axis]
        height += plane[axis] * origin[axis] * stretch[axis]
    if abs(rate) < 1e-9:
        return start, (-FAR if height > 0 else stop)
    if rate > 0:
        return start, min(stop, -height / rate)
    if -height / rate > start:
        start = -height / rate
        for axis in range(3):
            normal[axis] = plane[axis]
    return start, stop


@inline
def _skip(occupied, x, y, z, direction):
    """Return the length to the far side of a block that holds no surface, else 0."""
    i = min(max(int(x) // BLOCK, 0), occupied.shape[2] - 1)
    j = min(max(int(y) // BLOCK, 0), occupied.shape[1] - 1)
    k = min(max(int(z) // BLOCK, 0), occupied.shape[0] - 1)
    if occupied[k, j, i]:
        return 0.0
    step = FAR
    if abs(direction[0]) > 1e-12:
        step = min(step, ((i + (direction[0] > 0)) * BLOCK - x) / direction[0])
    if abs(direction[1]) > 1e-12:
        step = min(step, ((j + (direction[1] > 0)) * BLOCK - y) / direction[1])
    if abs(direction[2]) > 1e-12:
        step = min(step, ((k + (direction[2] > 0)) * BLOCK - z) / direction[2])
    return max(step, 0.0) + 1e-3


@inline
def _first_inside(field, occupied, origin, direction, start, stop):
    """Find the length at which the ray enters the surface after `start`, or FAR: half a voxel a
    step, then bisection.
    """
    before = start
    t = start
    while t < stop:
        x, y, z = point(origin, direction, t)
        jump = _skip(occupied, x, y, z, direction)
        if jump > 0:
            before = t
            t += jump
            continue
        if sample(field, x, y, z) >= ISO:
            inside = t
            for _ in range(6):
                middle = (before + inside) / 2
                x, y, z = point(origin, direction, middle)
                if sample(field, x, y, z) >= ISO:
                    inside = middle
                else:
                    before = middle
            return inside
        before = t
        t += 0.5
    return FAR


@inline
def _gradient(field, x, y, z, stretch, normal):
    """Compute the outward normal of the surface, minus the gradient of the field over a voxel to
    each side; return False where it is flat.
    """
    for axis in range(3):
        dx, dy, dz = 1.0 * (axis == 0), 1.0 * (axis == 1), 1.0 * (axis == 2)
        fall = sample(field, x - dx, y - dy, z - dz) - sample(field, x + dx, y + dy, z + dz)
        normal[axis] = fall / stretch[axis]
    length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    if length > 0:
        for axis in range(3):  # and not the array: that takes Numba seconds to compile
            normal[axis] /= length
    return length > 0


@inline
def _in_plane(field, origin, direction, t):
    """Return whether a ray that comes through a plane at `t` is in the solid there."""
    x, y, z = point(origin, direction, t)
    return sample(field, x, y, z) >= ISO


@inline
def hit(field, occupied, origin, direction, box, plane, stretch, viewer, normal):
    """Return the length to the surface (or FAR), and whether it lies in a plane; write `normal`.

    Where a ray enters the solid through a face of the box or of a cut, the normal is the plane's:
    the gradient there is that of the inside and would come out speckled.
    """
    start, stop = _clip_span(origin, direction, box, plane, stretch, normal)
    out, back, _, axis = _span(origin, direction, box[2], box[3])
    out, back = max(out, start), min(back, stop)
    if start >= stop:
        return FAR, False
    for part in range(2):
        first, last = start, stop
        if out < back:  # the ray crosses the part taken out: one span before it, one behind it
            first, last = (start, out) if part == 0 else (back, stop)
            if part == 1:
                normal[:] = 0.0
                normal[axis] = -np.sign(direction[axis])
        elif part == 1:
            break
        if first >= last - 1e-6:
            continue
        if _in_plane(field, origin, direction, first):
            return first, True
        t = _first_inside(field, occupied, origin, direction, first, last - 1e-6)
        if t < FAR:
            x, y, z = point(origin, direction, t)
            if not _gradient(field, x, y, z, stretch, normal):
                for k in range(3):
                    normal[k] = viewer[k]
            return t, False
    return FAR, False
