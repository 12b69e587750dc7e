"""Displacements of a part under its loads: conjugate gradients, preconditioned by multigrid."""

from __future__ import annotations

import numpy as np

from trabecula.core.errors import InputError
from trabecula.fields.topology.kernels import dot
from trabecula.fields.topology.multigrid import largest_eigenvalue, levels_of, preconditioned
from trabecula.fields.topology.part import Part

_SOFTEST = 2e-11  # energy over that of every node for itself; a beam of 300 elements has 1e-10
_LOOSE = (
    "the loads find no balance: the part is not held firmly enough, or lies in pieces; give more supports, or a mask "
    "in one piece"
)


def solved(
    part: Part, density: np.ndarray, start: np.ndarray, *, tolerance: float, most: int
) -> np.ndarray:
    """Displacements, begun from `start`; the residual falls to `tolerance` of the load."""
    levels, largest = levels_of(part, density), largest_eigenvalue(part)
    u = start.copy()
    residual = part.load - part.product(density, u)
    goal = tolerance * np.sqrt(dot(part.load.ravel(), part.load.ravel()))
    direction = np.zeros_like(u)
    before = 1.0
    for _ in range(most):
        if np.sqrt(dot(residual.ravel(), residual.ravel())) <= goal:
            break
        z = preconditioned(levels, residual, largest)
        now = dot(residual.ravel(), z.ravel())
        direction = z + (now / before) * direction
        before = now
        product = part.product(density, direction)
        curvature = dot(direction.ravel(), product.ravel())
        if not curvature > 0:
            raise InputError(_LOOSE)
        u += (now / curvature) * direction
        residual -= (now / curvature) * product
    else:
        raise InputError(_LOOSE)
    stretch = dot((u * part.diagonal(density)).ravel(), u.ravel())
    # it moves as a whole: only rounding holds it
    if dot(u.ravel(), part.load.ravel()) < _SOFTEST * stretch:
        raise InputError(_LOOSE)
    return u
