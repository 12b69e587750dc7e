"""White noise: a function of seed and coordinate alone."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.gaussian_random import normal_line
from trabecula.engine.random import philox


@kernel
def white_plane(plane, key, z, corner, periods, table):
    """Independent normal numbers in the table's units, of the voxels from (z, *corner) on, (Y, X)
    float64; periods 0: endless.
    """
    for y in range(plane.shape[0]):
        row = corner[0] + y
        if periods[0] > 0:
            row = row % periods[0]
        normal_line(plane[y], key, z, row, corner[1], periods[1], table)


@kernel
def cube_words(values, key, cz, cy, cx):
    """Random whole numbers 0 .. 2**31 - 1 of the cubes that the voxels are in, four a draw: (Z, Y,
    X) int32.
    """
    for z in range(values.shape[0]):
        for y in range(values.shape[1]):
            group = np.int64(-1) << np.int64(40)
            w = philox(key, 0, 0, 0, 0)
            row = values[z, y]
            for x in range(len(row)):
                cell = cx[x]
                if cell >> 2 != group:
                    group = cell >> 2
                    w = philox(key, cz[z], cy[y], group, 0)
                at = cell & 3
                word = w[0] if at == 0 else w[1] if at == 1 else w[2] if at == 2 else w[3]
                row[x] = np.int32(word >> np.uint64(1))
