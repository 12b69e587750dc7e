"""A Runge-Kutta step: the part of a streamline that a lattice can follow.

The paper steps from a voxel by Runge-Kutta and continues with the neighbour nearest to the solution
(algorithm 2). A step here is one voxel's edge along the streamline, whatever the speed, so that the
solution lies among the neighbours and its *direction* chooses one. Half of it is taken upstream and
half downstream: the chord of a whole step downstream leaves a bend outwards, by an angle that grows
with the voxels, so that a coarse lattice would give another material.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Vectors = tuple[np.ndarray, ...]
Velocity = Callable[[Vectors], Vectors]

STILL = 1e-9
"""A velocity below this is none: rounding, not a direction."""


def step_direction(velocity: Velocity, point: Vectors, step: float) -> Vectors:
    """Return the direction of a streamline at a point, by fourth-order Runge-Kutta.

    Parameters
    ----------
    velocity : callable
        Of points, each a tuple of arrays by axis: their velocities.
    point : tuple of arrays
        Middle of the step; the arrays broadcast.
    step : float
        Length, in the points' unit.

    Returns
    -------
    tuple of arrays
        The unit vector from where the step begins to where it ends; 0 where the point stands still
        or its velocity is no number.
    """
    here = unit(velocity(point))
    ahead = _slope(velocity, point, here, step / 2)
    behind = _slope(velocity, point, here, -step / 2)
    whole = unit(tuple(a + b for a, b in zip(ahead, behind, strict=True)))
    moves = sum(part * part for part in here) > 0
    return tuple(np.where(moves, part, 0.0) for part in whole)


def _slope(velocity: Velocity, point: Vectors, first: Vectors, step: float) -> Vectors:
    """Return six times the mean velocity over a step at unit speed; below 0 it goes upstream."""
    second = unit(velocity(_shift(point, first, step / 2)))
    third = unit(velocity(_shift(point, second, step / 2)))
    fourth = unit(velocity(_shift(point, third, step)))
    return tuple(
        a + 2 * b + 2 * c + d for a, b, c, d in zip(first, second, third, fourth, strict=True)
    )


def unit(vectors: Vectors) -> Vectors:
    """Return the vectors at length 1, or 0 where there is no direction."""
    with np.errstate(all="ignore"):
        length = np.sqrt(sum(part * part for part in vectors))
        moves = (length > STILL) & (length < np.inf)
        return tuple(np.where(moves, part / length, 0.0) for part in vectors)


def pack_int8(vector: np.ndarray) -> np.ndarray:
    """Return components of unit vectors, -1 .. 1, as int8 in units of 1/127."""
    return np.rint(vector * 127.0).astype(np.int8)


def _shift(point: Vectors, direction: Vectors, length: float) -> Vectors:
    """Return points moved by a length along a direction."""
    return tuple(place + length * part for place, part in zip(point, direction, strict=True))
