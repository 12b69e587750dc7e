"""Points in cells, and the nearest of them, in whole numbers held as float64: no sum or product is
rounded.

Symbols: s a point, D the square of its distance from a voxel's middle, in steps, of which a cell's
edge has 4096.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.random import philox


@inline
def wrapped(cell, period):
    """A cell's number, taken round an axis that repeats (period above 0)."""
    return cell if period == 0 else cell % period


@kernel
def place_points(place, word, key, first, counts, periods, around, flat, jitter):
    """A point in every cell, `jitter` / 2 steps from its middle at most, and its random word; in
    the order of the cells.
    """
    at = 0
    for z in range(counts[0]):
        for y in range(counts[1]):
            for x in range(counts[2]):
                cz = wrapped(first[0] + z - around[0], periods[0])
                cy = wrapped(first[1] + y - around[1], periods[1])
                cx = wrapped(first[2] + x - around[2], periods[2])
                w = philox(key, cz, cy, cx, 0)
                place[at, 0] = (
                    0
                    if flat
                    else (z - around[0]) * 4096 + _inside(w[0] & np.uint64(0xFFFF), jitter)
                )
                place[at, 1] = (y - around[1]) * 4096 + _inside(w[0] >> np.uint64(16), jitter)
                place[at, 2] = (x - around[2]) * 4096 + _inside(w[1] & np.uint64(0xFFFF), jitter)
                word[at] = np.int64(w[2] >> np.uint64(8))
                at += 1


@inline
def _inside(bits, jitter):
    """Steps from the corner of a cell."""
    return 2048 + (((np.int64(bits) - 32768) * jitter) >> 16)


@inline
def _first_from(at, value):
    """Number of the first of rising positions that is at least `value`."""
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
    """D * 2**24 + n of every voxel's nearest point n, the first of equally near ones: (Z, Y, X)
    float64.

    Every point is shown to the voxels within `reach`, which is quick; a voxel that none has reached
    looks for its own, which is no farther than two cells away: that of its own cell is nearer than
    any beyond. Points are fewer than 2**24.
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
                    keys[z, y, x] = _searched(az[z], ay[y], ax[x], place, counts, around)


@inline
def _searched(pz, py, px, place, counts, around):
    """The key of the nearest point among those of the cells up to two away."""
    best = np.inf
    z, y, x = (
        np.int64(pz // 4096) + around[0],
        np.int64(py // 4096) + around[1],
        np.int64(px // 4096) + around[2],
    )
    for cz in range(max(z - 2, 0), min(z + 3, counts[0])):
        for cy in range(max(y - 2, 0), min(y + 3, counts[1])):
            for cx in range(max(x - 2, 0), min(x + 3, counts[2])):
                n = (cz * counts[1] + cy) * counts[2] + cx
                square = (pz - place[n, 0]) ** 2 + (py - place[n, 1]) ** 2 + (px - place[n, 2]) ** 2
                best = min(best, square * 16777216.0 + n)
    return best
