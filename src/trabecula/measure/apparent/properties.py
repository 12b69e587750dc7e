"""Apparent conductivity, diffusivity and stiffness of windows, by name."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from trabecula.core.progress import report_count
from trabecula.engine.parallel import for_items
from trabecula.measure.apparent.conduction import conduct_windows
from trabecula.measure.apparent.elasticity import brick_of, stretch_windows
from trabecula.measure.mechanics.elements import brick_stiffness, isotropic, mean_strain
from trabecula.measure.percolation import AXES

CONDUCTION, ELASTICITY = "conductivity", "stiffness"

_POISSON = 0.3  # as of `measure.stiffness`
_TOLERANCE = {CONDUCTION: 1e-3, ELASTICITY: 1e-4}  # of an energy; errors are below 1 %
_AT_A_TIME = 64  # windows between reports of progress


def apparent_along(
    inside: np.ndarray,
    corners: np.ndarray,
    width: int,
    *,
    kind: str,
    axis: int,
    edges: Sequence[float],
) -> np.ndarray:
    """Return the conductivity or Young's modulus along an axis of windows of `width` voxels a side,
    relative to the solid's, one for each of the corners (n, 3), float64.

    Parameters
    ----------
    inside : (Z, Y, X) bool
        The solid.
    corners : (n, 3) int64
        First voxels of the windows.
    width : int
    kind : {"conductivity", "stiffness"}
        As `measure.conductivity` and `measure.stiffness` of the periodic medium that mirrors of a
        window build.
    axis : int
    edges : three of float
        Of the voxels.
    """
    order = (axis, *(other for other in range(3) if other != axis))
    turned = np.ascontiguousarray(inside.transpose(order))
    firsts = np.ascontiguousarray(corners[:, order])
    solve, matter = _solver(kind, tuple(edges[other] / min(edges) for other in order))
    found = np.empty(len(firsts))
    label = f"apparent {kind} of windows along {AXES[axis]}"
    for begin in range(0, len(firsts), _AT_A_TIME):
        report_count(label, begin, len(firsts))
        some = slice(begin, begin + _AT_A_TIME)
        work = partial(solve, turned, firsts[some], width, matter, _TOLERANCE[kind], found[some])
        for_items(work, len(firsts[some]))
    report_count(label, len(firsts), len(firsts))
    return found


def _solver(kind: str, edges: tuple[float, ...]) -> tuple[Callable[..., None], Any]:
    """Return the kernel of a property, and what it needs to know of voxels with these edges."""
    if kind == CONDUCTION:
        return conduct_windows, 1.0 / np.array(edges) ** 2
    material = isotropic(1.0, _POISSON)
    # zz, the third of Voigt's order, is the stretch along the first axis
    pull = material[2] @ mean_strain(edges).reshape(6, 24)
    blocks = brick_stiffness(material, edges) / math.prod(edges)
    return stretch_windows, brick_of(blocks, pull, float(material[2, 2]))
