"""One voxel as a finite element: a trilinear brick of an isotropic material.

Displacements are in the order of the array's axes (z, y, x). Strain and stress are Voigt vectors in
the order xx, yy, zz, yz, xz, xy, with engineering shear strains (twice the tensor's). Corner c of a
brick is 4 dz + 2 dy + dx.
"""

from __future__ import annotations

from itertools import product

import numpy as np

CORNERS = np.array(list(product((0, 1), repeat=3)))
_X, _Y, _Z = 2, 1, 0  # component of the displacement, and axis of the array
_VOIGT = ((_X, _X), (_Y, _Y), (_Z, _Z), (_Y, _Z), (_X, _Z), (_X, _Y))


def isotropic(young: float, poisson: float) -> np.ndarray:
    """Return the stiffness of an isotropic material, (6, 6)."""
    lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    shear = young / (2 * (1 + poisson))
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = lame
    matrix[range(6), range(6)] += [2 * shear] * 3 + [shear] * 3
    return matrix


def brick_stiffness(material: np.ndarray, edges: tuple[float, ...]) -> np.ndarray:
    """Return the stiffness of a brick by 2x2x2 Gauss points (exact for a trilinear brick), (8, 8,
    3, 3): 3x3 blocks per pair of corners.
    """
    points = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3)
    total = np.zeros((24, 24))
    for at in product(points, repeat=3):
        strain = _strain(np.array(at), edges).reshape(6, 24)
        total += strain.T @ material @ strain
    return np.ascontiguousarray(
        (total * np.prod(edges) / 8).reshape(8, 3, 8, 3).transpose(0, 2, 1, 3)
    )


def mean_strain(edges: tuple[float, ...]) -> np.ndarray:
    """Return the strain averaged over a brick, for a unit displacement of every corner and
    component, (6, 8, 3).
    """
    return _strain(np.full(3, 0.5), edges)


def _strain(at: np.ndarray, edges: tuple[float, ...]) -> np.ndarray:
    """Return the strain at a point of the unit cube, (6, 8, 3)."""
    shape = np.where(CORNERS, at, 1 - at)  # (8, 3)
    slope = np.where(CORNERS, 1.0, -1.0) / np.array(edges)
    gradient = np.stack(
        [slope[:, k] * np.delete(shape, k, axis=1).prod(axis=1) for k in range(3)], axis=1
    )
    strain = np.zeros((6, 8, 3))
    for row, (i, j) in enumerate(_VOIGT):
        strain[row, :, i] += gradient[:, j]
        if i != j:
            strain[row, :, j] += gradient[:, i]
    return strain
