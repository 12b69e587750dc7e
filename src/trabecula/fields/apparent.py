"""Apparent properties of every window of an image, from those that are solved.

A window's conductivity goes with its volume fraction, and its stiffness with its conductivity, far
nearer than either does with where the window is. So conductivity is solved in windows at every
eighth of a side, and between them it is the volume fraction times what the quotient of both is
around; stiffness at every half of a side, times the quotient of stiffness and conductivity.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.progress import part_of
from trabecula.fields.grid import take_between
from trabecula.measure.apparent import CONDUCTION, ELASTICITY, apparent_along
from trabecula.measure.percolation import AXES

WIDEST = 64
"""Voxels a side of a window at most: it is solved without a hierarchy."""

_PER_SIDE = {CONDUCTION: 8, ELASTICITY: 2}  # windows in a side
_COST = {CONDUCTION: 1, ELASTICITY: 50}  # of a window, about


def apparent_windows(
    inside: np.ndarray,
    fraction: np.ndarray,
    name: str,
    *,
    width: int,
    edges: Sequence[float],
) -> np.ndarray:
    """Return an apparent property of all windows, float32 of the shape of `fraction`.

    Parameters
    ----------
    inside : (Z, Y, X) bool
        What carries it.
    fraction : array
        Its volume fraction in every window.
    name : str
        "apparent_conductivity", "apparent_diffusivity", "apparent_stiffness": the mean over the
        axes, or along one, as in "apparent_stiffness:z".
    width : int
        Side of the windows, voxels.
    edges : three of float
        Of the voxels.
    """
    head, colon, axis = name.partition(":")
    axes = (AXES.index(axis),) if colon else (0, 1, 2)
    kinds = (CONDUCTION, ELASTICITY) if head == "apparent_stiffness" else (CONDUCTION,)
    costs = [_COST[kind] * _PER_SIDE[kind] ** 3 for _ in axes for kind in kinds]
    total, done = np.zeros(fraction.shape), 0
    for along in axes:
        values = fraction
        for kind in kinds:
            with part_of(costs, done):
                values = _spread(inside, values, kind, along, width, edges)
            done += 1
        total += values
    return (total / len(axes)).astype(np.float32)


def _spread(
    inside: np.ndarray,
    guide: np.ndarray,
    kind: str,
    axis: int,
    width: int,
    edges: Sequence[float],
) -> np.ndarray:
    """Solve some windows, and return all of them as a guide times the quotient of both around."""
    step = max(1, width // _PER_SIDE[kind])
    places = [_places(side, step) for side in guide.shape]
    corners = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1).reshape(-1, 3)
    solved = apparent_along(inside, corners, width, kind=kind, axis=axis, edges=edges)
    values = solved.reshape([len(at) for at in places])
    if step == 1:
        return values
    below = _between(guide[np.ix_(*places)].astype(np.float64), places, guide.shape)
    quotient = np.divide(
        _between(values, places, guide.shape), below, out=np.zeros(guide.shape), where=below > 0
    )
    return quotient * guide


def _places(count: int, step: int) -> np.ndarray:
    """Return every `step`-th of so many places, and the last."""
    return np.unique(np.append(np.arange(0, count, step), count - 1))


def _between(values: np.ndarray, places: Sequence[np.ndarray], shape: Sequence[int]) -> np.ndarray:
    """Interpolate linearly from places to all of `shape`, axis by axis."""
    for axis, (at, side) in enumerate(zip(places, shape, strict=True)):
        values = take_between(values, np.interp(np.arange(side), at, np.arange(len(at))), axis)
    return values
