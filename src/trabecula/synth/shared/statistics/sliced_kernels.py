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
def transport(ours, theirs, bins, moves, start, stop):
    """moves (n, P): how far each value of ours (n, P) is from where its rank lies in theirs (m, P), columns start..stop.

    Values that share a bin of the common histogram move to the mean of theirs over the ranks that they cover.
    """
    n, m = len(ours), len(theirs)
    mine = np.empty(bins, np.int64)
    other = np.empty(bins, np.int64)
    sums = np.empty(bins, np.int64)
    table = np.empty(bins, np.float64)
    for k in range(start, stop):
        low, high = np.int64(theirs[0, k]), np.int64(theirs[0, k])
        for i in range(n):
            low, high = min(low, np.int64(ours[i, k])), max(high, np.int64(ours[i, k]))
        for i in range(m):
            low, high = min(low, np.int64(theirs[i, k])), max(high, np.int64(theirs[i, k]))
        size = (high - low) // bins + 1
        mine[:] = 0
        other[:] = 0
        sums[:] = 0
        for i in range(n):
            mine[(np.int64(ours[i, k]) - low) // size] += 1
        for i in range(m):
            value = np.int64(theirs[i, k])
            other[(value - low) // size] += 1
            sums[(value - low) // size] += value
        at = 0
        left = other[0] * n  # of their bin `at`, in units of 1 / (n m)
        for q in range(bins):
            need = mine[q] * m
            reached = 0.0
            while need > 0:
                while left == 0:
                    at += 1
                    left = other[at] * n
                taken = min(need, left)
                reached += np.float64(taken) * (np.float64(sums[at]) / np.float64(other[at]))
                need -= taken
                left -= taken
            if mine[q] > 0:
                table[q] = np.rint(reached / (np.float64(mine[q]) * m))
        for i in range(n):
            value = np.int64(ours[i, k])
            moves[i, k] = table[(value - low) // size] - value


@kernel
def add(blocks, numbers, total, votes, steps, box, first, start, stop):
    """Add the neighbourhoods of a few planes of sites, the first of which is `first`, to voxel planes start..stop.

    blocks (n, C * voxels) int32; numbers (planes, y, x) the row of each site in it, or -1; steps, box (3,) int.
    """
    width, voxels = box[2], box[0] * box[1] * box[2]
    for z in range(start, stop):
        for sz in range(numbers.shape[0]):
            dz = z - (first + sz) * steps[0]
            if dz < 0 or dz >= box[0]:
                continue
            for sy in range(numbers.shape[1]):
                for sx in range(numbers.shape[2]):
                    row = numbers[sz, sy, sx]
                    if row < 0:
                        continue
                    for dy in range(box[1]):
                        y, x0 = sy * steps[1] + dy, sx * steps[2]
                        for c in range(total.shape[0]):
                            at = c * voxels + (dz * box[1] + dy) * width
                            to = total[c, z, y]
                            for dx in range(width):
                                to[x0 + dx] += blocks[row, at + dx]
                        count = votes[z, y]
                        for dx in range(width):
                            count[x0 + dx] += 1
