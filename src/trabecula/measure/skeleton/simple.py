"""Simple points: voxels whose removal changes neither components, tunnels nor cavities.

A neighbourhood of 3x3x3 voxels is a number of 27 bits, bit 9 dz + 3 dy + dx for offsets 0..2; the
centre is bit 13. So eight table look-ups give the change of the Euler number and a few shifts flood
the neighbours.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from trabecula.engine.compile import inline
from trabecula.measure.configurations import cube_euler

CENTRE_BIT = 13
CENTRE = 1 << CENTRE_BIT
NEIGHBOURS = (1 << 27) - 1 - CENTRE
FACES = 1 << 4 | 1 << 10 | 1 << 12 | 1 << 14 | 1 << 16 | 1 << 22


def _layer(axis: int, at: int) -> int:
    """Return the bits of the 3x3x3 voxels whose offset along an axis is `at`."""
    offsets = np.indices((3, 3, 3))[axis].ravel()
    return sum(1 << int(k) for k in np.flatnonzero(offsets == at))


# Voxels that a shift by one along x or y may arrive at: not those to which a row or slice wraps
# around.
_NOT_FIRST_X, _NOT_LAST_X = NEIGHBOURS & ~_layer(2, 0) | CENTRE, NEIGHBOURS & ~_layer(2, 2) | CENTRE
_NOT_FIRST_Y, _NOT_LAST_Y = NEIGHBOURS & ~_layer(1, 0) | CENTRE, NEIGHBOURS & ~_layer(1, 2) | CENTRE


@lru_cache
def euler_changes() -> np.ndarray:
    """Return eight times the change of the Euler number (26 neighbours) within octant o, 4 dz + 2
    dy + dx, of a voxel's neighbourhood when the voxel is removed, (8, 256) int8.
    """
    eighths = np.round(8 * cube_euler(26)).astype(np.int64)
    number = np.arange(256)
    changes = np.empty((8, 256), np.int8)
    for octant in range(8):
        own = 1 << (7 - octant)  # the voxel is the corner nearest to the middle
        changes[octant] = eighths[number & ~own] - eighths[number | own]
    return changes


def around(shape: tuple[int, ...]) -> np.ndarray:
    """Return the steps in the flat array of a volume from a voxel to its neighbourhood, in the
    order of the bits, (27,).
    """
    steps = np.stack(np.meshgrid(*[(-1, 0, 1)] * 3, indexing="ij"), axis=-1).reshape(27, 3)
    return np.asarray(steps @ np.array([shape[1] * shape[2], shape[2], 1]), np.int64)


@inline
def neighbourhood(state, at, steps):
    """Return the 27 bits around voxel `at` of a flat volume: whether the lowest bit of `state` is
    set.
    """
    found = np.int64(0)
    for k in range(27):
        found |= (np.int64(state[at + steps[k]]) & 1) << k
    return found


@inline
def _keeps_euler(found, changes):
    total = 0
    for octant in range(8):
        part = found >> (9 * (octant >> 2) + 3 * (octant >> 1 & 1) + (octant & 1))
        total += changes[octant, part & 3 | part >> 1 & 12 | part >> 5 & 48 | part >> 6 & 192]
    return total == 0


@inline
def _is_connected(found):
    """Return whether the neighbours, the centre left out, are one component of 26-connected
    voxels.
    """
    found &= NEIGHBOURS
    reached, before = found & -found, 0
    while reached != before:
        before = reached
        reached |= reached << 1 & _NOT_FIRST_X | reached >> 1 & _NOT_LAST_X
        reached |= reached << 3 & _NOT_FIRST_Y | reached >> 3 & _NOT_LAST_Y
        reached |= reached << 9 | reached >> 9
        reached &= found
    return found != 0 and reached == found


@inline
def is_simple(found, changes):
    """Return whether removing the centre changes no topology, with 26 neighbours inside and 6
    outside (Lee, Kashyap and Chu 1994).
    """
    found |= CENTRE
    return _keeps_euler(found, changes) and _is_connected(found)


@inline
def is_simple_by_faces(found, changes):
    """Return the same with 6 neighbours inside and 26 outside: then outside is what inside was."""
    return is_simple(~found & NEIGHBOURS, changes)


@inline
def is_end(found):
    """Return whether there is at most one neighbour: the end of a line, or a voxel alone."""
    found &= NEIGHBOURS
    return found & (found - 1) == 0
