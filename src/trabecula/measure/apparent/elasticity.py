"""Apparent Young's modulus of many small windows, along one axis.

A brick's displacements are taken apart into Walsh's modes, sums of its corners with signs: uniform,
linear along each axis, and products of these. By the symmetry of a brick each of them meets two
others at most, so that its stiffness takes 72 products for 576.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.measure.apparent.spans import spanned_axes
from trabecula.numerics.small_systems import MOST, start_system, take_step

_CORNERS, _OTHERS = 8, 2


class Brick(NamedTuple):
    """A voxel of a window: three components at each of its corners."""

    diagonal: np.ndarray
    """(3,) float64: of its stiffness, the same at every corner."""
    own: np.ndarray
    """(24,) float64: the stiffness of each mode by itself."""
    other: np.ndarray
    """(24, 2) int64: the modes that it meets."""
    shared: np.ndarray
    """(24, 2) float64: the stiffness between them."""
    pull: np.ndarray
    """(24,) float64: what a unit stretch along the first axis asks of its corners."""
    whole: float
    """The energy of that stretch where no corner moves beyond it."""


def brick_of(stiffness: np.ndarray, pull: np.ndarray, whole: float) -> Brick:
    """Return a brick of an isotropic material by its stiffness, (8, 8, 3, 3)."""
    signs = [[(-1) ** (a & b).bit_count() for b in range(_CORNERS)] for a in range(_CORNERS)]
    walsh = np.array(signs) / _CORNERS
    modes = np.einsum("ma,abij,nb->minj", walsh, stiffness, walsh).reshape(24, 24)
    own = modes.diagonal().copy()
    rest = np.where(np.abs(modes) > 1e-9 * own.max(), modes, 0.0)
    np.fill_diagonal(rest, 0.0)
    other = np.argsort(rest == 0.0, axis=1, kind="stable")[:, :_OTHERS]
    shared = np.take_along_axis(rest, other, axis=1)
    diagonal = stiffness[0, 0].diagonal().copy()
    return Brick(diagonal, own, np.ascontiguousarray(other), shared, pull, whole)


@kernel
def stretch_windows(inside, corners, width, brick, tolerance, found, start, stop):
    """Set found[start:stop] to Young's modulus along the first axis of windows of `width` voxels a
    side that begin at `corners` (n, 3).
    """
    for n in range(start, stop):
        z, y, x = corners[n, 0], corners[n, 1], corners[n, 2]
        window = inside[z : z + width, y : y + width, x : x + width]
        found[n] = _stretch(window, brick, tolerance)


@inline
def _stretch(inside, brick, tolerance):
    """Return the energy of a unit stretch, per volume.

    Unknown is what nodes move beyond it. Faces stay plane and slide: those across the first axis
    as stretched, the lower ones across the others where they are, the upper ones by one unknown
    each, so that no force is on them.
    """
    axes = spanned_axes(inside)
    side = len(inside)
    row = side + 2
    place = np.zeros(len(axes), np.int64)  # of nodes, each at the first corner of its voxel
    bricks = bearing = 0
    for n in range(len(axes)):
        bearing |= axes[n]
        if axes[n]:
            bricks += 1
            for c in range(8):
                place[_corner_of(n, c, row)] = 1
    if not bearing & 1:
        return 0.0
    count = 2  # the upper faces across axes 1 and 2
    for n in range(len(place)):
        if place[n]:
            place[n] = count
            count += 3
    corner = np.zeros(24 * bricks, np.int64)
    own, load = np.zeros(count + 1), np.zeros(count + 1)
    at = 0
    for n in range(len(axes)):
        if axes[n] == 0:
            continue
        for c in range(8):
            node = _corner_of(n, c, row)
            layers = (node // (row * row), node // row % row, node % row)
            for k in range(3):
                free = place[node] + k
                if layers[k] == 1 or (k == 0 and layers[k] == side + 1):
                    free = count  # held
                elif layers[k] == side + 1:
                    free = k - 1
                corner[at] = free
                own[free] += brick.diagonal[k]
                load[free] -= brick.pull[3 * c + k]
                at += 1
    system, size = start_system(own[:count], load[:count])
    energy, last = brick.whole * bricks, False
    for step in range(MOST):
        _strain(corner, brick, system.direction, system.product)
        energy, size, last = take_step(system, step, size, energy, tolerance)
        if last:
            break
    return energy / side**3


@inline
def _corner_of(voxel, corner, row):
    """Return the node at a corner of a voxel: the number of the voxel whose first corner it is."""
    return voxel + ((corner >> 2) * row + (corner >> 1 & 1)) * row + (corner & 1)


@inline
def _strain(corner, brick, vector, product):
    """Set the product of the stiffness of all bricks and a vector."""
    product[:] = 0.0
    mode, force = np.zeros(24), np.zeros(24)
    for begin in range(0, len(corner), 24):
        for j in range(24):
            mode[j] = vector[corner[begin + j]]
        _walsh(mode)
        for j in range(24):
            force[j] = (
                brick.own[j] * mode[j]
                + brick.shared[j, 0] * mode[brick.other[j, 0]]
                + brick.shared[j, 1] * mode[brick.other[j, 1]]
            )
        _walsh(force)
        for j in range(24):
            product[corner[begin + j]] += force[j]


@inline
def _walsh(values):
    """Transform three components at eight corners in place; done twice it is eight times."""
    for k in range(3):
        a0, a4 = values[k] + values[12 + k], values[k] - values[12 + k]
        a1, a5 = values[3 + k] + values[15 + k], values[3 + k] - values[15 + k]
        a2, a6 = values[6 + k] + values[18 + k], values[6 + k] - values[18 + k]
        a3, a7 = values[9 + k] + values[21 + k], values[9 + k] - values[21 + k]
        b0, b2, b1, b3 = a0 + a2, a0 - a2, a1 + a3, a1 - a3
        b4, b6, b5, b7 = a4 + a6, a4 - a6, a5 + a7, a5 - a7
        values[k], values[3 + k] = b0 + b1, b0 - b1
        values[6 + k], values[9 + k] = b2 + b3, b2 - b3
        values[12 + k], values[15 + k] = b4 + b5, b4 - b5
        values[18 + k], values[21 + k] = b6 + b7, b6 - b7
