"""Kernels of nucleation: bubbles drawn by cell, repelled and absorbed, and the shifts of nodes.

Everything drawn is a function of seed and cell. A cell may lie anywhere; along a periodic axis it
is wrapped. Repulsion and absorption look at the cells next to a bubble's own, and read only what
was drawn: a bubble has the same fate in every box.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.random import philox

FINE = 256
"""Parts of a voxel in which bubbles are placed: differences of places are then exact."""

_PART = 1.0 / 4294967296.0  # of 32 random bits


@inline
def _count(word, table):
    """Return the number of bubbles in a cell: the first threshold above 32 random bits."""
    count = 0
    while count < len(table) and word >= table[count]:
        count += 1
    return count


@inline
def _place(cell, around, edge, lap, word):
    """Return a place in 1 / FINE of a voxel within a cell of `edge`.

    A period has `around` cells and the length `lap`; `around` is 0 where the axis is endless.
    """
    if around == 0:
        return np.int64(np.floor((np.float64(cell) + np.float64(word) * _PART) * edge))
    inside = cell % around
    return (cell - inside) // around * lap + np.int64(
        np.floor((np.float64(inside) + np.float64(word) * _PART) * edge)
    )


@kernel
def count_bubbles(starts, key, first, cells, around, table):
    """Fill `starts` (cells + 1): the first bubble of every cell, in the order z, y, x."""
    starts[0] = 0
    at = 0
    for z in range(cells[0]):
        for y in range(cells[1]):
            for x in range(cells[2]):
                i = first[0] + z if around[0] == 0 else (first[0] + z) % around[0]
                j = first[1] + y if around[1] == 0 else (first[1] + y) % around[1]
                k = first[2] + x if around[2] == 0 else (first[2] + x) % around[2]
                starts[at + 1] = starts[at] + _count(philox(key, i, j, k, 0)[0], table)
                at += 1


@kernel
def draw_bubbles(places, sizes, names, starts, key, first, cells, around, edges, laps):
    """Fill place, size and name of every bubble.

    `places` (N, 3) are in 1 / FINE of a voxel, `sizes` (N,) are rows of the table of sizes, `names`
    (N,) are random.
    """
    at = 0
    for z in range(cells[0]):
        for y in range(cells[1]):
            for x in range(cells[2]):
                cz, cy, cx = first[0] + z, first[1] + y, first[2] + x
                i = cz if around[0] == 0 else cz % around[0]
                j = cy if around[1] == 0 else cy % around[1]
                k = cx if around[2] == 0 else cx % around[2]
                for n in range(starts[at], starts[at + 1]):
                    draw = 2 * (n - starts[at]) + 1
                    w = philox(key, i, j, k, draw)
                    places[n, 0] = _place(cz, around[0], edges[0], laps[0], w[0])
                    places[n, 1] = _place(cy, around[1], edges[1], laps[1], w[1])
                    places[n, 2] = _place(cx, around[2], edges[2], laps[2], w[2])
                    names[n] = w[3]
                    sizes[n] = philox(key, i, j, k, draw + 1)[0] >> np.uint64(20)
                at += 1


@kernel
def draw_vectors(vectors, key, first, around):
    """Fill (Z, Y, X, 3) int16 with even numbers -32767 .. 32767, of the cells from `first` on."""
    for z in range(vectors.shape[0]):
        for y in range(vectors.shape[1]):
            for x in range(vectors.shape[2]):
                i = first[0] + z if around[0] == 0 else (first[0] + z) % around[0]
                j = first[1] + y if around[1] == 0 else (first[1] + y) % around[1]
                k = first[2] + x if around[2] == 0 else (first[2] + x) % around[2]
                w = philox(key, i, j, k, 0)
                for axis in range(3):
                    word = w[0] if axis == 0 else w[1] if axis == 1 else w[2]
                    vectors[z, y, x, axis] = (
                        np.int64(word >> np.uint64(16)) * 65534 // 65535 - 32767
                    )


@kernel
def shift_nodes(shifts, start, stop, origin, step, vectors, first, edges, scale):
    """Fill the shifts (Z, Y, X, 3) float32 of the nodes in planes start .. stop.

    They are smooth between the vectors of cells of `edges` voxels. Nodes lie `step` voxels apart
    from `origin` on; a vector's 32767 becomes 32767 `scale` voxels.
    """
    for z in range(start, stop):
        iz, tz = _within(origin[0] + z * step[0], edges[0])
        for y in range(shifts.shape[1]):
            iy, ty = _within(origin[1] + y * step[1], edges[1])
            for x in range(shifts.shape[2]):
                ix, tx = _within(origin[2] + x * step[2], edges[2])
                i, j, k = iz - first[0], iy - first[1], ix - first[2]
                for axis in range(3):
                    total = 0.0
                    for corner in range(8):
                        dz, dy, dx = corner >> 2, (corner >> 1) & 1, corner & 1
                        weight = (
                            (tz if dz else 1 - tz) * (ty if dy else 1 - ty) * (tx if dx else 1 - tx)
                        )
                        total += weight * vectors[i + dz, j + dy, k + dx, axis]
                    shifts[z, y, x, axis] = total * scale[axis]


@inline
def _within(place, edge):
    """Return the cell of a place, and the position in it, 0 .. 1, smoothed as 3 t^2 - 2 t^3."""
    at = place / edge
    cell = np.int64(np.floor(at))
    t = at - cell
    return cell, t * t * (3.0 - 2.0 * t)


@inline
def _ends(at, count, near):
    """Return the range of cells from `near` before to `near` behind one, within the lattice."""
    return max(at - near, 0), min(at + near, count - 1) + 1


@kernel
def repel(moved, places, starts, cells, near, apart, push):
    """Move bubbles (N, 3), in 1 / FINE of a voxel, away from those nearer than `apart`.

    Each pushes along the line between both, with 1 - distance / apart; by `push` at most, in all.
    """
    for z in range(cells[0]):
        for y in range(cells[1]):
            for x in range(cells[2]):
                row = (z * cells[1] + y) * cells[2] + x
                for i in range(starts[row], starts[row + 1]):
                    az, ay, ax = 0.0, 0.0, 0.0
                    for m in range(*_ends(z, cells[0], near[0])):
                        for n in range(*_ends(y, cells[1], near[1])):
                            low, high = _ends(x, cells[2], near[2])
                            line = (m * cells[1] + n) * cells[2]
                            for j in range(starts[line + low], starts[line + high]):
                                dz = np.float64(places[i, 0] - places[j, 0])
                                dy = np.float64(places[i, 1] - places[j, 1])
                                dx = np.float64(places[i, 2] - places[j, 2])
                                off = np.sqrt(dz * dz + dy * dy + dx * dx)
                                if 0 < off < apart:
                                    force = (1.0 / off - 1.0 / apart) * push
                                    az, ay, ax = az + dz * force, ay + dy * force, ax + dx * force
                    far = np.sqrt(az * az + ay * ay + ax * ax)
                    less = push / far if far > push else 1.0
                    moved[i, 0] = places[i, 0] + np.int64(np.floor(az * less + 0.5))
                    moved[i, 1] = places[i, 1] + np.int64(np.floor(ay * less + 0.5))
                    moved[i, 2] = places[i, 2] + np.int64(np.floor(ax * less + 0.5))


@kernel
def absorb(alive, places, brakes, starts, cells, near, least, touch):
    """Mark the bubbles that live on: all but those absorbed by a faster one.

    A faster one absorbs another that it would enclose in a ball of a radius below `least`, or that
    starts in its wall. Where two alone grow from places d apart, the slower one's part is a ball of
    radius d k / (k^2 - 1), k the ratio of speeds.
    """
    for z in range(cells[0]):
        for y in range(cells[1]):
            for x in range(cells[2]):
                row = (z * cells[1] + y) * cells[2] + x
                for i in range(starts[row], starts[row + 1]):
                    alive[i] = True
                    for m in range(*_ends(z, cells[0], near[0])):
                        for n in range(*_ends(y, cells[1], near[1])):
                            low, high = _ends(x, cells[2], near[2])
                            line = (m * cells[1] + n) * cells[2]
                            for j in range(starts[line + low], starts[line + high]):
                                if brakes[j] < brakes[i]:
                                    ratio = brakes[i] / brakes[j]
                                    dz = np.float64(places[i, 0] - places[j, 0])
                                    dy = np.float64(places[i, 1] - places[j, 1])
                                    dx = np.float64(places[i, 2] - places[j, 2])
                                    off = np.sqrt(dz * dz + dy * dy + dx * dx)
                                    if off < touch or off * ratio < least * (ratio * ratio - 1.0):
                                        alive[i] = False
