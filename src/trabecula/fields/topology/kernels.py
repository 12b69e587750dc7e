"""Elements of a regular grid applied without a matrix: one brick's stiffness, times every element's
density.

Forces and displacements are (Z + 1, Y + 1, X + 1, 3) at the nodes, densities (Z, Y, X) at the
elements; 0 is no element.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel


@inline
def _collect(u, z, y, x, local):
    """The 24 displacements of an element's corners, corner 4 dz + 2 dy + dx first."""
    for c in range(8):
        node = u[z + (c >> 2), y + ((c >> 1) & 1), x + (c & 1)]
        for i in range(3):
            local[3 * c + i] = node[i]


@inline
def _pushed(stiffness, local, force):
    """force = stiffness @ local, by columns: LLVM reorders no sum, but does rows side by side."""
    force[:] = 0.0
    for column in range(24):
        value = local[column]
        row = stiffness[column]  # symmetric
        for k in range(24):
            force[k] += row[k] * value


@kernel
def apply_layers(stiffness, density, u, force, parity, start, stop):
    """force += K u of the layers 2 k + parity with start <= k < stop, which share no nodes with
    each other.
    """
    depth, height, width = density.shape
    local, pushed = np.empty(24), np.empty(24)
    for k in range(start, stop):
        z = 2 * k + parity
        if z >= depth:
            continue
        for y in range(height):
            for x in range(width):
                rho = density[z, y, x]
                if rho == 0.0:
                    continue
                _collect(u, z, y, x, local)
                _pushed(stiffness, local, pushed)
                for c in range(8):
                    node = force[z + (c >> 2), y + ((c >> 1) & 1), x + (c & 1)]
                    for i in range(3):
                        node[i] += rho * pushed[3 * c + i]


@kernel
def energies(stiffness, inside, u, energy, start, stop):
    """u K u of every element at density 1."""
    _, height, width = inside.shape
    local, pushed = np.empty(24), np.empty(24)
    for z in range(start, stop):
        for y in range(height):
            for x in range(width):
                total = 0.0
                if inside[z, y, x]:
                    _collect(u, z, y, x, local)
                    _pushed(stiffness, local, pushed)
                    for k in range(24):
                        total += local[k] * pushed[k]
                energy[z, y, x] = total


@kernel
def dot(a, b):
    """Inner product of two flat arrays, in order."""
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total
