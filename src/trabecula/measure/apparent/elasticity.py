"""Apparent Young's modulus of many small windows, along one axis."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.measure.apparent.spans import spanned_axes
from trabecula.numerics.small_systems import MOST, start_system, take_step


@kernel
def stretch_windows(inside, corners, width, brick, pull, whole, tolerance, found, start, stop):
    """Set found[start:stop] to Young's modulus along the first axis of windows of `width` voxels a
    side that begin at `corners` (n, 3).

    Parameters
    ----------
    brick : (24, 24) float64
        Stiffness of a voxel: three components at each of its corners.
    pull : (24,) float64
        What a unit stretch along the first axis asks of them.
    whole : float
        Its energy where none of them moves beyond it, of its volume.
    """
    for n in range(start, stop):
        z, y, x = corners[n, 0], corners[n, 1], corners[n, 2]
        window = inside[z : z + width, y : y + width, x : x + width]
        found[n] = _stretch(window, brick, pull, whole, tolerance)


@inline
def _stretch(inside, brick, pull, whole, tolerance):
    """Return the energy of a unit stretch, per volume.

    Unknown is what nodes move beyond it. Faces stay plane and slide: those across the first axis
    as stretched, the lower ones across the others where they are, the upper ones by one unknown
    each, so that no force is on them.
    """
    axes = spanned_axes(inside)
    side = len(inside)
    node = np.full((side + 1, side + 1, side + 1), -1, np.int32)
    bricks = 0
    for z in range(side):
        for y in range(side):
            for x in range(side):
                if axes[z, y, x]:
                    bricks += 1
                    for c in range(8):
                        node[z + (c >> 2), y + (c >> 1 & 1), x + (c & 1)] = 0
    count = 2  # the upper faces across axes 1 and 2
    for z in range(side + 1):
        for y in range(side + 1):
            for x in range(side + 1):
                if node[z, y, x] == 0:
                    node[z, y, x] = count
                    count += 3
    corner = np.empty((bricks, 24), np.int32)
    own, load = np.zeros(count + 1), np.zeros(count + 1)
    n = 0
    for z in range(side):
        for y in range(side):
            for x in range(side):
                if not axes[z, y, x]:
                    continue
                for c in range(8):
                    at = (z + (c >> 2), y + (c >> 1 & 1), x + (c & 1))
                    for k in range(3):
                        place = node[at] + k
                        if at[k] == 0 or (k == 0 and at[k] == side):
                            place = count  # held
                        elif at[k] == side:
                            place = k - 1
                        corner[n, 3 * c + k] = place
                        own[place] += brick[3 * c + k, 3 * c + k]
                        load[place] -= pull[3 * c + k]
                n += 1
    system, size = start_system(own[:count], load[:count])
    energy, last = whole * bricks, False
    for step in range(MOST):
        _strain(corner, brick, system.direction, system.product)
        energy, size, last = take_step(system, step, size, energy, tolerance)
        if last:
            break
    return energy / side**3


@inline
def _strain(corner, brick, vector, product):
    """Set the product of the stiffness of all bricks and a vector."""
    product[:] = 0.0
    force = np.empty(24)
    for n in range(len(corner)):
        force[:] = 0.0
        for j in range(24):
            by = vector[corner[n, j]]
            for i in range(24):
                force[i] += brick[j, i] * by
        for i in range(24):
            product[corner[n, i]] += force[i]
