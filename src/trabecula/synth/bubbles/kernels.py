"""Kernels of one block: the candidate bubbles, the first arrival at its voxels, and the walls.

    x       a voxel
    s, v    start and speed of a bubble; u = x - s
    t(x)    direction of the flow, |t| <= 1
    q       (t(x) + t(s)) / 2, with the sign of t(x) that makes it longer
    T       arrival: v^2 T^2 = |u|^2 (1 + (c - 1) |q|^2) - (c - a) (q.u)^2, where a flow of
            randomness r makes bubbles grow r^(1/3) times as fast across it (c = r^(-2/3)) and
            r^(-2/3) times as fast along it (a = r^(4/3))

T^2 is found at nodes, four voxels apart; between the nodes of a block it is trilinear with the bend
of a quadric, which is exact for a straight flow. Blocks lie at multiples of four voxels, and the
result of one depends on nothing else, so that every box of the material has the same voxels. A
picture is a volume of one plane, in which z is 0.

The voxels of a block are counted along x slowest, then z, then y: number x * rows + z * 4 + y, of
16 rows (in a picture 4).
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline

BLOCK = 4
"""Voxels between two nodes."""

SUPER = 4
"""Blocks along an edge of a cube. The blocks of a cube share one search for bubbles."""

MOST = 512
"""Candidate bubbles of a block, at most: those at two voxels from bubble to bubble."""

HALF = 1.0 / 254.0
"""Factor that scales a direction of length 127 to 1/2, so that the sum of two is their mean."""

NEVER = np.float32(np.inf)
_FULL = np.float32(1.0)
_STEP = np.float32(1.0 / BLOCK)


@inline
def _quadric(i, around, n, places, flows, across, along):
    """Return T^2 v^2 of bubble i at place n, |u|^2, and the squares of q.

    A place is z, y, x, and the flow there of length 1/2.
    """
    uz = around[n, 0] - places[i, 0]
    uy = around[n, 1] - places[i, 1]
    ux = around[n, 2] - places[i, 2]
    square = uz * uz + uy * uy + ux * ux
    if len(flows) == 0:
        return square, square, 0.0, 0.0, 0.0
    sz, sy, sx = flows[i, 0], flows[i, 1], flows[i, 2]
    sign = 1.0 if sz * around[n, 3] + sy * around[n, 4] + sx * around[n, 5] >= 0 else -1.0
    qz, qy, qx = sz + sign * around[n, 3], sy + sign * around[n, 4], sx + sign * around[n, 5]
    drift = qz * uz + qy * uy + qx * ux
    zz, yy, xx = qz * qz, qy * qy, qx * qx
    form = square * (1.0 + (across - 1.0) * (zz + yy + xx)) - (across - along) * drift * drift
    return max(form, 0.0), square, zz, yy, xx


@inline
def _set_node(around, n, z, y, x, shifts, flow, origins):
    """Set row n to the place of node (z, y, x) once it is shifted, and half of the flow there."""
    around[n, 0], around[n, 1], around[n, 2] = BLOCK * z, BLOCK * y, BLOCK * x
    if len(shifts) > 0:
        # Unsigned, since Numba checks an index that may be negative for wraparound.
        i, j, k = np.uint64(z - origins[0]), np.uint64(y - origins[1]), np.uint64(x - origins[2])
        around[n, 0] += shifts[i, j, k, 0]
        around[n, 1] += shifts[i, j, k, 1]
        around[n, 2] += shifts[i, j, k, 2]
    if len(flow) > 0:
        i, j, k = np.uint64(z - origins[3]), np.uint64(y - origins[4]), np.uint64(x - origins[5])
        around[n, 3], around[n, 4] = flow[i, j, k, 0] * HALF, flow[i, j, k, 1] * HALF
        around[n, 5] = flow[i, j, k, 2] * HALF


@inline
def set_around(around, z, y, x, side, flat, shifts, flow, origins):
    """Set places and flows at the corners (0 .. 7) and middle (8) of a cube of `side` blocks.

    The cube starts at node (z, y, x). Behind the middle's: the largest distance of a corner from
    it, and of a corner's flow from its own.
    """
    deep = 0 if flat else side
    for n in range(8):
        at_y, at_x = y + side * (n >> 1 & 1), x + side * (n & 1)
        _set_node(around, n, z + deep * (n >> 2), at_y, at_x, shifts, flow, origins)
    for i in range(6 if len(flow) > 0 else 3):
        total = 0.0
        for n in range(8):
            total += around[n, i]
        around[8, i] = 0.125 * total
    far, bend = 0.0, 0.0
    for n in range(8):
        dz = around[n, 0] - around[8, 0]
        dy = around[n, 1] - around[8, 1]
        dx = around[n, 2] - around[8, 2]
        far = max(far, dz * dz + dy * dy + dx * dx)
        if len(flow) > 0:
            dz = around[n, 3] - around[8, 3]
            dy = around[n, 4] - around[8, 4]
            dx = around[n, 5] - around[8, 5]
            bend = max(bend, dz * dz + dy * dy + dx * dx)
    around[8, 6], around[8, 7] = np.sqrt(far), np.sqrt(bend)


@inline
def keep_near(found, count, kept, around, places, brakes, flows, law, times, slacks):
    """Keep those of the first `count` that may come first about the middle, or leave a wall.

    Returns their number. The one that comes first in the middle is put first.
    """
    across, along = law[3], law[4]
    widest = np.sqrt(across)
    least = law[0]
    for n in range(count):
        i = found[n]
        form, square, _, _, _ = _quadric(i, around, 8, places, flows, across, along)
        times[n] = np.sqrt(form) * brakes[i]
        slacks[n] = widest * brakes[i] * around[8, 6]
        if len(flows) > 0:
            slacks[n] += widest * brakes[i] * around[8, 7] * np.sqrt(square)
        least = min(least, times[n] + slacks[n])
    slowest = 0.0
    for n in range(count):
        if times[n] - slacks[n] <= least:
            slowest = max(slowest, brakes[found[n]])
    left, half, soonest, at = 0, 0.5 * law[1] * widest, np.inf, 0
    for n in range(count):
        if times[n] - slacks[n] <= least + half * (brakes[found[n]] + slowest):
            kept[left] = found[n]
            if times[n] < soonest:
                soonest, at = times[n], left
            left += 1
    if left > 0:
        first = kept[at]
        kept[at] = kept[0]
        kept[0] = first
    return left


@inline
def gather(found, node, flat, starts, places, brakes, first, cells, edges, law, ends):
    """Gather the bubbles within reach of the cube from a node on, by cell; returns their number."""
    reach, soonest = law[2], np.sqrt(law[4]) / law[0]
    for axis in range(3):
        low, high = BLOCK * node[axis] - reach, BLOCK * (node[axis] + SUPER) + reach
        if flat and axis == 0:
            low, high = 0.0, 0.0
        ends[0, axis] = max(np.int64(np.floor(low / (edges[axis]))) - first[axis], 0)
        ends[1, axis] = min(np.int64(np.floor(high / (edges[axis]))) - first[axis], cells[axis] - 1)
    count = 0
    for z in range(ends[0, 0], ends[1, 0] + 1):
        for y in range(ends[0, 1], ends[1, 1] + 1):
            row = (z * cells[1] + y) * cells[2]
            for i in range(starts[row + ends[0, 2]], starts[row + ends[1, 2] + 1]):
                square = 0.0
                for axis in range(1 if flat else 0, 3):
                    at = places[i, axis]
                    off = max(BLOCK * node[axis] - at, at - BLOCK * (node[axis] + SUPER), 0.0)
                    square += off * off
                if square <= reach * reach and square * (soonest * brakes[i]) ** 2 <= 1.0:
                    found[count] = i
                    count += 1
    return count


@inline
def _rows(at, low, rise, flat, bz, by):
    """Set T^2 at the first voxel of every row of a block, and its rise along x."""
    for n in range(4 if flat else 16):
        z, y = np.float32(n >> 2) * _STEP, np.float32(n & 3) * _STEP
        bend = bz * (z - z * z) + by * (y - y * y)
        a, b = at[0] + (at[4] - at[0]) * z, at[1] + (at[5] - at[1]) * z
        c, d = at[2] + (at[6] - at[2]) * z, at[3] + (at[7] - at[3]) * z
        start, end = a + (c - a) * y, b + (d - b) * y
        low[n], rise[n] = start - bend, (end - start) * _STEP


@inline
def _slope(at, slopes, m):
    """Set the slope of T^2 along z, y, x in the middle of a block; returns its length."""
    z = 0.25 * _STEP * (at[4] + at[5] + at[6] + at[7] - at[0] - at[1] - at[2] - at[3])
    y = 0.25 * _STEP * (at[2] + at[3] + at[6] + at[7] - at[0] - at[1] - at[4] - at[5])
    x = 0.25 * _STEP * (at[1] + at[3] + at[5] + at[7] - at[0] - at[2] - at[4] - at[6])
    slopes[m, 0], slopes[m, 1], slopes[m, 2] = z, y, x
    return np.sqrt(z * z + y * y + x * x)


@inline
def set_forms(
    forms, slopes, at, ahead, low, rise, kept, count, around, flat, places, brakes, flows, law
):
    """Set T^2 of bubbles at the voxels of a block, and its slopes in the middle.

    `forms` are (bubble, voxel) float32. Of the first `count` kept, those stay that matter beside
    the first one, judged at the corners; returns their number.
    """
    across, less, rows = law[3], law[3] - law[4], 4 if flat else 16
    left, steep = 0, 0.0
    for m in range(count):
        i = kept[m]
        slow = brakes[i] * brakes[i]
        zz, yy, xx, behind = 0.0, 0.0, 0.0, np.inf
        for n in range(8):
            form, _, pz, py, px = _quadric(i, around, n, places, flows, across, law[4])
            at[n] = np.float32(form * slow)
            if m == 0:
                ahead[n] = at[n]
            behind = min(behind, at[n] - ahead[n])
            zz, yy, xx = zz + 0.125 * pz, yy + 0.125 * py, xx + 0.125 * px
        rising = _slope(at, slopes, left)
        if m == 0:
            steep = rising
        # Half a wall, and the bend of T^2 between the corners.
        elif behind > 0.5 * law[1] * (rising + 1.5 * steep) + 0.75 * BLOCK * BLOCK * across * slow:
            continue
        kept[left] = i
        full = 1.0 + (across - 1.0) * (zz + yy + xx)
        wide = slow * (BLOCK * BLOCK)
        bz, by = np.float32((full - less * zz) * wide), np.float32((full - less * yy) * wide)
        _rows(at, low, rise, flat, bz, by)
        for x in range(BLOCK):
            along = np.float32(x)
            bend = np.float32((full - less * xx) * slow * (x * (BLOCK - x)))
            for n in range(rows):
                forms[left, x * rows + n] = low[n] + rise[n] * along - bend
        left += 1
    return left


@inline
def _merges(one, two, merging):
    """Return whether two bubbles that meet have no wall."""
    return (
        (np.uint64(one) ^ np.uint64(two)) * np.uint64(2654435761) & np.uint64(0xFFFFFFFF)
    ) < merging


@inline
def set_arrivals(arrivals, walls, forms, slopes, kept, count, voxels, level, wall, names, merging):
    """Set T^2 of the first bubble at the voxels of a block; NEVER beyond `level` and in walls.

    |T_i^2 - T_j^2| over its slope is the distance to the plane where bubbles i and j meet: a wall,
    where it is below half of one.
    """
    for v in range(voxels):
        arrivals[v], walls[v] = NEVER, _FULL
    for m in range(count):
        for v in range(voxels):
            f, a = forms[m, v], arrivals[v]
            arrivals[v] = f if f < a else a
    for i in range(count):
        for j in range(i):
            dz = slopes[i, 0] - slopes[j, 0]
            dy = slopes[i, 1] - slopes[j, 1]
            dx = slopes[i, 2] - slopes[j, 2]
            near = np.float32(0.25 * wall * wall * (dz * dz + dy * dy + dx * dx))
            if near > 0 and not _merges(names[kept[i]], names[kept[j]], merging):
                for v in range(voxels):
                    f, g, w = forms[i, v], forms[j, v], walls[v]
                    first = f if f < g else g
                    gap = (f - g) * (f - g) - near
                    gap = gap if first <= arrivals[v] else _FULL
                    walls[v] = gap if gap < w else w
    for v in range(voxels):
        arrivals[v] = arrivals[v] if arrivals[v] <= level and walls[v] >= 0 else NEVER
