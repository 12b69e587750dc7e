"""Which axes of a window the components of its solid span."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline
from trabecula.measure.union_find import join, root_of


@inline
def spanned_axes(inside):
    """Return for every voxel of a cube the axes that its component (of shared faces) spans, from
    the first layer to the last: bit 0 for the first axis, 0 where nothing is inside.

    Of voxels in raster order with a layer of zeros around the cube, ((side + 2)^3,) int64.
    """
    side = len(inside)
    row = side + 2
    root = np.zeros(row * row * row, np.int64)
    faces, found = np.zeros(len(root), np.int64), np.zeros(len(root), np.int64)
    for z in range(side):
        for y in range(side):
            for x in range(side):
                n = ((z + 1) * row + y + 1) * row + x + 1
                if inside[z, y, x]:
                    root[n] = n  # those outside keep 0, which none has
                    for before in (row * row, row, 1):
                        if root[n - before] > 0:
                            join(root, n, n - before)
    for z in range(side):
        for y in range(side):
            for x in range(side):
                n = ((z + 1) * row + y + 1) * row + x + 1
                if root[n] > 0:
                    touched = 1 * (z == 0) + 2 * (y == 0) + 4 * (x == 0)
                    last = 1 * (z == side - 1) + 2 * (y == side - 1) + 4 * (x == side - 1)
                    faces[root_of(root, n)] |= touched + 8 * last
    for n in range(len(root)):
        if root[n] > 0:
            both = faces[root_of(root, n)]
            found[n] = both & both >> 3
    return found
