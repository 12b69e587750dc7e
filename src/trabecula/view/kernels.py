"""The ray marcher: plain functions on arrays.

Glossary: positions are in voxels as (x, y, z), the corner of voxel 0 at 0, so a voxel's centre is at +0.5. `stretch` is
the spacing over its smallest axis; directions of rays are divided by it, so that their parameter t is a true length in
smallest voxel edges. `field` is the drawn phases' indicator, slightly blurred, 0..255; the surface is where it crosses
ISO. `pyramid` holds means of the field over cells of 1, 2, 4, ... voxels, one level after the other (`offsets` and
`shapes` say where); beyond the box it counts as void.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel

ISO = 127.5
BLOCK = 4
"""Edge of the blocks that are skipped where they hold no surface, voxels."""

FAR = 1e30


@kernel
def blur_axis(values, weights, out):
    """Convolve (A, B, C) along its middle axis with weights that sum to 256; edge values are repeated."""
    reach = len(weights) // 2
    for a in range(values.shape[0]):
        for b in range(values.shape[1]):
            for c in range(values.shape[2]):
                total = 128
                for k in range(len(weights)):
                    total += weights[k] * values[a, min(max(b + k - reach, 0), values.shape[1] - 1), c]
                out[a, b, c] = total >> 8


@inline
def _sample(field, x, y, z):
    """Trilinear, edge values repeated."""
    u = min(max(x - 0.5, 0.0), field.shape[2] - 1.0)
    v = min(max(y - 0.5, 0.0), field.shape[1] - 1.0)
    w = min(max(z - 0.5, 0.0), field.shape[0] - 1.0)
    i, j, k = int(u), int(v), int(w)
    fu, fv, fw = u - i, v - j, w - k
    i1, j1, k1 = min(i + 1, field.shape[2] - 1), min(j + 1, field.shape[1] - 1), min(k + 1, field.shape[0] - 1)
    low = (field[k, j, i] * (1 - fu) + field[k, j, i1] * fu) * (1 - fv) + (
        field[k, j1, i] * (1 - fu) + field[k, j1, i1] * fu
    ) * fv
    high = (field[k1, j, i] * (1 - fu) + field[k1, j, i1] * fu) * (1 - fv) + (
        field[k1, j1, i] * (1 - fu) + field[k1, j1, i1] * fu
    ) * fv
    return low * (1 - fw) + high * fw


@inline
def _density(pyramid, offsets, shapes, level, x, y, z):
    """Trilinear mean density 0..1 at a level of the pyramid, void outside."""
    size = 1.0 / (1 << level)
    u, v, w = x * size - 0.5, y * size - 0.5, z * size - 0.5
    depth, height, width = shapes[level, 0], shapes[level, 1], shapes[level, 2]
    if u <= -1 or v <= -1 or w <= -1 or u >= width or v >= height or w >= depth:
        return 0.0
    i, j, k = int(np.floor(u)), int(np.floor(v)), int(np.floor(w))
    total = 0.0
    for dk in range(2):
        if 0 <= k + dk < depth:
            fw = w - k if dk else 1 - (w - k)
            for dj in range(2):
                if 0 <= j + dj < height:
                    fv = v - j if dj else 1 - (v - j)
                    row = offsets[level] + ((k + dk) * height + j + dj) * width
                    if i >= 0:
                        total += fw * fv * (1 - (u - i)) * pyramid[row + i]
                    if i + 1 < width:
                        total += fw * fv * (u - i) * pyramid[row + i + 1]
    return total / 255.0


@inline
def _openness(pyramid, offsets, shapes, directions, px, py, pz, normal, stretch):
    """Share of the light from all round that reaches a point: wide cones along fixed directions, weighted by cosine."""
    total, weight = 0.0, 0.0
    for c in range(len(directions)):
        cosine = directions[c, 0] * normal[0] + directions[c, 1] * normal[1] + directions[c, 2] * normal[2]
        if cosine > 0.05:
            through = 1.0
            for level in range(1, len(offsets)):
                reach = 1.0 * (1 << level)
                there = _density(
                    pyramid,
                    offsets,
                    shapes,
                    level,
                    px + reach * directions[c, 0] / stretch[0],
                    py + reach * directions[c, 1] / stretch[1],
                    pz + reach * directions[c, 2] / stretch[2],
                )
                through *= 1 - min(1.0, 1.5 * there)
            total += cosine * through
            weight += cosine
    return total / weight


@inline
def _lit(pyramid, offsets, shapes, px, py, pz, light, stretch):
    """Share of the lamp that is visible: one narrow cone, so that shadows soften with distance."""
    through = 1.0
    reach = 1.0
    limit = 1.8 * max(shapes[0, 0] * stretch[2], shapes[0, 1] * stretch[1], shapes[0, 2] * stretch[0])
    while reach < limit and through > 0.02:
        level = 0
        while level + 1 < len(offsets) and reach * 0.16 > (1 << level):
            level += 1
        x, y, z = (
            px + reach * light[0] / stretch[0],
            py + reach * light[1] / stretch[1],
            pz + reach * light[2] / stretch[2],
        )
        if x < 0 or y < 0 or z < 0 or x > shapes[0, 2] or y > shapes[0, 1] or z > shapes[0, 0]:
            break
        there = min(1.0, max(0.0, (_density(pyramid, offsets, shapes, level, x, y, z) - 0.2) * 1.8))
        through *= 1 - 0.75 * there
        reach += max(0.8, 0.12 * reach)
    return through


@inline
def _span(origin, direction, low, high):
    """Where a ray is inside a box: entry, exit, and the axes of the faces it passes."""
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
def _skip(occupied, x, y, z, direction):
    """Length to the far side of the block around a point where the block holds no surface, else 0."""
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
def _first_hit(field, occupied, origin, direction, start, stop):
    """Length at which the ray enters the surface after `start`, or FAR. Half a voxel a step, then bisection."""
    before = start
    t = start
    while t < stop:
        x, y, z = origin[0] + t * direction[0], origin[1] + t * direction[1], origin[2] + t * direction[2]
        jump = _skip(occupied, x, y, z, direction)
        if jump > 0:
            before = t
            t += jump
            continue
        if _sample(field, x, y, z) >= ISO:
            inside = t
            for _ in range(6):
                middle = (before + inside) / 2
                if (
                    _sample(
                        field,
                        origin[0] + middle * direction[0],
                        origin[1] + middle * direction[1],
                        origin[2] + middle * direction[2],
                    )
                    >= ISO
                ):
                    inside = middle
                else:
                    before = middle
            return inside
        before = t
        t += 0.5
    return FAR


@inline
def _normal(field, x, y, z, stretch, normal):
    """Outward normal of the surface: minus the gradient of the field over a voxel to each side."""
    for axis in range(3):
        dx, dy, dz = 1.0 * (axis == 0), 1.0 * (axis == 1), 1.0 * (axis == 2)
        fall = _sample(field, x - dx, y - dy, z - dz) - _sample(field, x + dx, y + dy, z + dz)
        normal[axis] = fall / stretch[axis]
    length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    if length > 0:
        normal /= length
    return length > 0


@inline
def _entry(origin, direction, sides, removed):
    """Where a ray meets what is left of the box: start, stop, and the axis of the plane it comes through."""
    start, stop, axis, _ = _span(origin, direction, np.zeros(3), sides)
    cut_start, cut_stop, _, cut_axis = _span(origin, direction, removed[0], removed[1])
    # The octant faces the viewer, so that a ray meets it first or never.
    if start < stop and cut_start < cut_stop and cut_start <= start + 1e-6:
        start, axis = cut_stop, cut_axis
    return start, stop - 1e-6, axis


@inline
def _hit(field, occupied, origin, direction, start, stop, axis, stretch, viewer, normal):
    """Length to the surface (or FAR), and whether it lies in a plane; `normal` is written.

    Where a ray enters the solid through a face of the box or of the cut, the normal is the plane's: the gradient there
    is that of the inside and would come out speckled.
    """
    x, y, z = origin[0] + start * direction[0], origin[1] + start * direction[1], origin[2] + start * direction[2]
    if _sample(field, x, y, z) >= ISO:
        normal[:] = 0.0
        normal[axis] = -np.sign(direction[axis])
        return start, True
    t = _first_hit(field, occupied, origin, direction, start, stop)
    if t < FAR:
        x, y, z = origin[0] + t * direction[0], origin[1] + t * direction[1], origin[2] + t * direction[2]
        if not _normal(field, x, y, z, stretch, normal):
            normal[:] = viewer
    return t, False


@inline
def _shade(pyramid, offsets, shapes, directions, lights, surface, x, y, z, normal, stretch):
    """Light at a point: from the lamp, openness to the light from all round, how far it faces the viewer, highlight."""
    lamp, viewer, half = lights[0], lights[1], lights[2]
    px, py, pz = x + normal[0] / stretch[0], y + normal[1] / stretch[1], z + normal[2] / stretch[2]
    lit = normal[0] * lamp[0] + normal[1] * lamp[1] + normal[2] * lamp[2]
    lit = lit * _lit(pyramid, offsets, shapes, px, py, pz, lamp, stretch) if lit > 0 else 0.0
    openness = _openness(pyramid, offsets, shapes, directions, px, py, pz, normal, stretch)
    facing = max(0.0, normal[0] * viewer[0] + normal[1] * viewer[1] + normal[2] * viewer[2])
    shine = max(0.0, normal[0] * half[0] + normal[1] * half[1] + normal[2] * half[2])
    return lit, openness, facing, surface[3] * shine ** surface[4] * lit


@inline
def _label(labels, x, y, z, normal):
    """The label a quarter of a voxel below the surface."""
    i = min(max(int(x - 0.25 * normal[0]), 0), labels.shape[2] - 1)
    j = min(max(int(y - 0.25 * normal[1]), 0), labels.shape[1] - 1)
    k = min(max(int(z - 0.25 * normal[2]), 0), labels.shape[0] - 1)
    return labels[k, j, i]


@kernel
def march(
    field, labels, occupied, pyramid, offsets, shapes, camera, stretch, removed, directions, lights, palette, surface,
    sampling, first, last, out,
):  # fmt: skip
    """Shade the rows `first`..`last` of `out` (H, W, 3), linear light, with sampling**2 rays a pixel.

    camera (4, 3): middle of the upper left pixel, steps to the next pixel and the next row (voxels), direction of the
    rays (voxels per unit length). removed (2, 3): corners of the part that is cut away. lights (4, 3): directions to
    the lamp, to the viewer and half between them (true space), colour of the light from all round. palette: background,
    dye of cut faces, phases. surface: strength of lamp, light from all round and fill, gloss, polish.
    """
    sides = np.array([field.shape[2], field.shape[1], field.shape[0]], np.float64)
    direction = camera[3]
    origin, normal = np.empty(3), np.empty(3)
    share = 1.0 / (sampling * sampling)
    for row in range(first, last):
        for column in range(out.shape[1]):
            for s in range(sampling * sampling):
                right = column + (s % sampling + 0.5) / sampling - 0.5
                down = row + (s // sampling + 0.5) / sampling - 0.5
                for k in range(3):
                    origin[k] = camera[0, k] + right * camera[1, k] + down * camera[2, k]
                start, stop, axis = _entry(origin, direction, sides, removed)
                t, plane = FAR, False
                if start < stop:
                    t, plane = _hit(
                        field, occupied, origin, direction, start, stop, axis, stretch, lights[1], normal
                    )  # fmt: skip
                if t == FAR:
                    for c in range(3):
                        out[row, column, c] += share * palette[0, c]
                    continue
                x, y, z = origin[0] + t * direction[0], origin[1] + t * direction[1], origin[2] + t * direction[2]
                lit, openness, facing, gloss = _shade(
                    pyramid, offsets, shapes, directions, lights, surface, x, y, z, normal, stretch
                )  # fmt: skip
                tint = 2 + _label(labels, x, y, z, normal)
                for c in range(3):
                    albedo = palette[tint, c] * palette[1, c] if plane else palette[tint, c]
                    # Light between bright walls bounces: occlusion takes less from what reflects more.
                    around = openness * (1 + 0.7 * albedo * (1 - openness))
                    light = surface[0] * lit + (surface[1] * lights[3, c] + surface[2] * facing) * around
                    out[row, column, c] += share * (albedo * light + gloss)
