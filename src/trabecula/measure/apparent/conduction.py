"""Apparent conductivity of many small windows, along one axis."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.measure.apparent.spans import spanned_axes
from trabecula.numerics.small_systems import MOST, start_system, take_step


@kernel
def conduct_windows(inside, corners, width, pull, tolerance, found, start, stop):
    """Set found[start:stop] to the conductivity along the first axis of windows of `width` voxels a
    side that begin at `corners` (n, 3); `pull` is 1 / edge^2 along every axis.
    """
    for n in range(start, stop):
        z, y, x = corners[n, 0], corners[n, 1], corners[n, 2]
        window = inside[z : z + width, y : y + width, x : x + width]
        found[n] = _conduct(window, pull, tolerance)


@inline
def _conduct(inside, pull, tolerance):
    """Return the power of a unit drop of the potential, as a conductivity: 0 before the first
    layer, 1 behind the last, half a voxel from their centres.
    """
    axes = spanned_axes(inside)
    side = len(inside)
    number = np.full((side + 2, side + 2, side + 2), -1, np.int32)
    count = 0
    for z in range(side):
        for y in range(side):
            for x in range(side):
                if axes[z, y, x] & 1:
                    number[z + 1, y + 1, x + 1] = count
                    count += 1
    beside = np.empty((count, 6), np.int32)
    own, load = np.zeros(count), np.zeros(count)
    driven = 0.0
    for z in range(1, side + 1):
        for y in range(1, side + 1):
            for x in range(1, side + 1):
                n = number[z, y, x]
                if n < 0:
                    continue
                beside[n, 0], beside[n, 1] = number[z - 1, y, x], number[z + 1, y, x]
                beside[n, 2], beside[n, 3] = number[z, y - 1, x], number[z, y + 1, x]
                beside[n, 4], beside[n, 5] = number[z, y, x - 1], number[z, y, x + 1]
                for k in range(6):
                    if beside[n, k] < 0:
                        beside[n, k] = count  # nothing flows there
                    else:
                        own[n] += pull[k // 2]
                if z == 1:
                    own[n] += 2.0 * pull[0]
                if z == side:
                    own[n] += 2.0 * pull[0]
                    load[n] = 2.0 * pull[0]
                    driven += 2.0 * pull[0]
    system, size = start_system(own, load)
    power, last = driven, False
    for step in range(MOST):
        _spread(beside, own, pull, system.direction, system.product)
        power, size, last = take_step(system, step, size, power, tolerance)
        if last:
            break
    return power / (side * pull[0])


@inline
def _spread(beside, own, pull, vector, product):
    """Set the product of Laplace's matrix and a vector."""
    for n in range(len(beside)):
        b = beside[n]
        total = own[n] * vector[n] - pull[0] * (vector[b[0]] + vector[b[1]])
        total -= pull[1] * (vector[b[2]] + vector[b[3]])
        product[n] = total - pull[2] * (vector[b[4]] + vector[b[5]])
