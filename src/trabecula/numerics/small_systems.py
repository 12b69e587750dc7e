"""Conjugate gradients for small systems, inside kernels: no hierarchy, one system after the other.

Preparing multigrid takes longer than solving a system of some thousand unknowns. A solver writes
the product of its matrix and `direction` to `product`, and takes a step, until steps gain little.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import inline

MOST = 1500
"""Steps at most."""

_TRAIL = 10  # steps whose gains estimate what is left to gain
_EXACT = 1e-24  # of the energy: a residual that is rounding


class SmallSystem(NamedTuple):
    """A symmetric, positive semidefinite system A x = load, whose energy - 2 load . x + x . A x is
    to be least; the load has no part that A cannot balance.
    """

    scale: np.ndarray
    """(n,) float64: one over the diagonal of A, the preconditioner; 0 where that is 0."""
    residual: np.ndarray
    """(n,) float64."""
    direction: np.ndarray
    """(n + 1,) float64; the last entry is 0 and stands for all that is held."""
    product: np.ndarray
    """(n + 1,) float64: A times the direction; what the last entry is does not count."""
    gains: np.ndarray
    """Of the last steps."""


@inline
def start_system(own, load):
    """Return the system with the diagonal `own` of A at x = 0, and the square of its residual, for
    the first step; unknowns where the diagonal is 0 stay 0.
    """
    count = len(load)
    scale = np.zeros(count)
    for n in range(count):
        if own[n] > 0.0:
            scale[n] = 1.0 / own[n]
    vectors = np.zeros(count + 1), np.zeros(count + 1)
    system = SmallSystem(scale, load.copy(), vectors[0], vectors[1], np.zeros(_TRAIL))
    return system, _turn(system, 0.0)


@inline
def take_step(system, step, size, energy, tolerance):
    """Take the step `step` from a residual of square `size`; return the energy after it, the square
    of the residual, and whether it was the last step.

    It is the last where ten steps together have gained less than `tolerance` of the energy: their
    gain is the square of the error ten steps before, as far as later steps gain little (Strakos,
    Tichy 2002, Electronic Transactions on Numerical Analysis 13, section 4).
    """
    if not size > _EXACT * energy:
        return energy, size, True
    curve = 0.0
    for n in range(len(system.scale)):
        curve += system.direction[n] * system.product[n]
    if not curve > 0.0:
        return energy, size, True
    pace = size / curve
    for n in range(len(system.scale)):
        system.residual[n] -= pace * system.product[n]
    energy = max(energy - pace * size, 0.0)
    system.gains[step % _TRAIL] = pace * size
    last = step >= _TRAIL and system.gains.sum() <= tolerance * energy
    return energy, _turn(system, size), last


@inline
def _turn(system, before):
    """Turn the direction to the residual; return the residual's square, where it was `before`."""
    scale, residual, direction = system.scale, system.residual, system.direction
    size = 0.0
    for n in range(len(scale)):
        size += residual[n] * residual[n] * scale[n]
    turn = size / before if before > 0.0 else 0.0
    for n in range(len(scale)):
        direction[n] = residual[n] * scale[n] + turn * direction[n]
    return size
