"""Which faces of a window the components of its solid join."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline
from trabecula.measure.union_find import join, number_trees


@inline
def spanned_axes(inside):
    """Return for every voxel the axes that its component (of shared faces) spans, from the first
    layer to the last: bit 0 for the first axis; (Z, Y, X) uint8.
    """
    depth, height, width = inside.shape
    tree = np.arange(depth * height * width)
    for z in range(depth):
        for y in range(height):
            for x in range(width):
                if not inside[z, y, x]:
                    continue
                n = (z * height + y) * width + x
                if z and inside[z - 1, y, x]:
                    join(tree, n, n - height * width)
                if y and inside[z, y - 1, x]:
                    join(tree, n, n - width)
                if x and inside[z, y, x - 1]:
                    join(tree, n, n - 1)
    number, count = number_trees(tree)
    faces = np.zeros(count, np.uint8)
    for z in range(depth):
        for y in range(height):
            for x in range(width):
                if inside[z, y, x]:
                    touched = (z == 0) | (z == depth - 1) << 1
                    touched |= (y == 0) << 2 | (y == height - 1) << 3
                    touched |= (x == 0) << 4 | (x == width - 1) << 5
                    faces[number[(z * height + y) * width + x]] |= np.uint8(touched)
    found = np.zeros(inside.shape, np.uint8)
    for z in range(depth):
        for y in range(height):
            for x in range(width):
                if inside[z, y, x]:
                    touched = faces[number[(z * height + y) * width + x]]
                    for axis in range(3):
                        if touched >> (2 * axis) & 3 == 3:
                            found[z, y, x] |= np.uint8(1 << axis)
    return found
