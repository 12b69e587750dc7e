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
    row = side + 2
    number = np.zeros(len(axes), np.int64)  # from 1
    count = 0
    for n in range(len(axes)):
        if axes[n] & 1:
            count += 1
            number[n] = count
    beside = np.zeros(6 * count, np.int64)
    own, load = np.zeros(count), np.zeros(count)
    driven = 0.0
    for n in range(len(axes)):
        if number[n] == 0:
            continue
        at = number[n] - 1
        for k in range(6):
            by = row * row if k < 2 else row if k < 4 else 1
            other = number[n + by * (2 * (k & 1) - 1)]
            beside[6 * at + k] = other - 1 if other else count  # nothing flows there
            if other:
                own[at] += pull[k // 2]
        layer = n // (row * row)
        if layer == 1:
            own[at] += 2.0 * pull[0]
        if layer == side:
            own[at] += 2.0 * pull[0]
            load[at] = 2.0 * pull[0]
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
    for n in range(len(own)):
        k = 6 * n
        total = own[n] * vector[n] - pull[0] * (vector[beside[k]] + vector[beside[k + 1]])
        total -= pull[1] * (vector[beside[k + 2]] + vector[beside[k + 3]])
        product[n] = total - pull[2] * (vector[beside[k + 4]] + vector[beside[k + 5]])
