"""Kernels of the sliced rounds: plain functions on arrays of whole numbers."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.random import below, philox


@kernel
def draw_starts(key, number, sides, starts):
    words = philox(key, number, 0, 0, 1)
    for axis in range(3):
        starts[axis] = below(words[axis], sides[axis])


@kernel
def draw_signs(key, number, signs):
    for i in range(len(signs)):
        signs[i] = 1.0 - 2.0 * np.float64(philox(key, number, i, 0, 2)[0] & np.uint64(1))


@kernel
def extremes(values, low, high):
    """Lower and raise low, high (P,) int64 to what the columns of values (n, P) hold."""
    for k in range(values.shape[1]):
        least, most = low[k], high[k]
        for i in range(len(values)):
            value = np.int64(values[i, k])
            least, most = min(least, value), max(most, value)
        low[k], high[k] = least, most


@kernel
def tally(values, low, size, counts):
    """Count the values (n, P) of every column in bins of size (P,) from low (P,): into counts (P,
    bins).
    """
    for k in range(values.shape[1]):
        for i in range(len(values)):
            counts[k, (np.int64(values[i, k]) - low[k]) // size[k]] += 1


@kernel
def tally_sums(values, low, size, counts):
    """The same into counts[0], and the sums of the values into counts[1]."""
    for k in range(values.shape[1]):
        for i in range(len(values)):
            value = np.int64(values[i, k])
            q = (value - low[k]) // size[k]
            counts[0, k, q] += 1
            counts[1, k, q] += value


@kernel
def destinations(mine, theirs, table):
    """table (P, bins): where the ranks of each of mine (P, bins) lie among theirs (2, P, bins),
    counts and sums.
    """
    for k in range(len(mine)):
        n, m = mine[k].sum(), theirs[0, k].sum()
        other, sums = theirs[0, k], theirs[1, k]
        at = 0
        left = other[0] * n  # of their bin `at`, in units of 1 / (n m)
        for q in range(mine.shape[1]):
            need = mine[k, q] * m
            reached = 0.0
            while need > 0:
                while left == 0:
                    at += 1
                    left = other[at] * n
                taken = min(need, left)
                reached += np.float64(taken) * (np.float64(sums[at]) / np.float64(other[at]))
                need -= taken
                left -= taken
            if mine[k, q] > 0:
                table[k, q] = np.rint(reached / (np.float64(mine[k, q]) * m))


@kernel
def moves(values, low, size, table, found):
    """found (n, P): how far each value (n, P) goes."""
    for k in range(values.shape[1]):
        for i in range(len(values)):
            value = np.int64(values[i, k])
            found[i, k] = table[k, (value - low[k]) // size[k]] - value


@kernel
def add(
    blocks,
    numbers,
    first,
    steps,
    box,
    places_z,
    places_y,
    places_x,
    rest,
    total,
    votes,
    start,
    stop,
):
    """Add neighbourhoods to rows start..stop of total (C, Z, Y, X) and votes (Z, Y, X).

    blocks (n, C * voxels) int32; numbers (sz, sy, sx) the row of each site in it, or -1; first (2,)
    the number of the first site along z and y; places_*: where what all sites cover along an axis
    lies; rest (C,) is added to each.
    """
    width, voxels = box[2], box[0] * box[1] * box[2]
    channels = len(total)
    line = np.empty((channels, len(places_x)), np.int32)
    count = np.empty(len(places_x), np.int32)
    low, high = first[0] * steps[0], (first[0] + numbers.shape[0] - 1) * steps[0] + box[0]
    near, far = first[1] * steps[1], (first[1] + numbers.shape[1] - 1) * steps[1] + box[1]
    for z in range(low, high):
        for y in range(near, far):
            if places_y[y] < start or places_y[y] >= stop:
                continue
            line[:] = 0
            count[:] = 0
            for sz in range(numbers.shape[0]):
                dz = z - (first[0] + sz) * steps[0]
                if dz < 0 or dz >= box[0]:
                    continue
                for sy in range(numbers.shape[1]):
                    dy = y - (first[1] + sy) * steps[1]
                    if dy < 0 or dy >= box[1]:
                        continue
                    at = (dz * box[1] + dy) * width
                    for sx in range(numbers.shape[2]):
                        row = numbers[sz, sy, sx]
                        if row < 0:
                            continue
                        x = sx * steps[2]
                        for c in range(channels):
                            for dx in range(width):
                                line[c, x + dx] += blocks[row, at + c * voxels + dx]
                        for dx in range(width):
                            count[x + dx] += 1
            for x in range(len(places_x)):
                for c in range(channels):
                    total[c, places_z[z], places_y[y], places_x[x]] += (
                        line[c, x] + rest[c] * count[x]
                    )
                votes[places_z[z], places_y[y], places_x[x]] += count[x]
