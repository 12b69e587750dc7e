"""A preconditioner for the displacements: one V-cycle over coarser grids of elements.

On a coarser grid an element of twice the edge has the mean density of the eight it covers;
densities between bounds vary so little that this stays close to the fine problem. Smoothing is by
Chebyshev polynomials of the diagonal's inverse: they have no order of nodes, so the result does not
depend on threads.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trabecula.fields.topology.part import Part

_DEGREE, _COARSEST_DEGREE = 3, 40  # products of the smoother
_LOWEST, _LOWEST_THERE = 0.12, 0.002  # of the largest eigenvalue: what the smoother goes for
_FEW = 80  # nodes of the coarsest grid, about


@dataclass(frozen=True)
class Level:
    """One grid with its densities."""

    part: Part
    density: np.ndarray
    inverse: np.ndarray
    """Of the diagonal; 0 where a node is held."""


def levels_of(part: Part, density: np.ndarray) -> list[Level]:
    """The grids, finest first."""
    levels = []
    while True:
        levels.append(Level(part, density, np.where(part.free, 1 / part.diagonal(density), 0.0)))
        if min(density.shape) < 2 or part.free[..., 0].size <= _FEW:
            return levels
        padded = np.pad(density, [(0, side % 2) for side in density.shape])
        z, y, x = (side // 2 for side in padded.shape)
        density = padded.reshape(z, 2, y, 2, x, 2).sum(axis=(1, 3, 5)) / 8
        part = _coarser(part, density > 0)


def _coarser(part: Part, inside: np.ndarray) -> Part:
    """A node is held where the fine one at its place is, or an odd one beside it, which has none at
    its own place.
    """
    held = ~part.free
    for axis, side in enumerate(inside.shape):
        fine = [np.zeros_like(held.take([0], axis)), held]
        missing = 2 * side + 2 - held.shape[axis]  # beyond the far face of an odd side
        fine.append(np.zeros_like(held.take(np.zeros(missing, int), axis)))
        long = np.concatenate(fine, axis)  # node k of the fine grid is at k + 1
        at = 2 * np.arange(side + 1) + 1
        held = long.take(at, axis) | long.take(at - 1, axis) | long.take(at + 1, axis)
    # A brick twice as large is twice as stiff.
    return replace(
        part, stiffness=2 * part.stiffness, inside=inside, free=~held, load=np.zeros(held.shape)
    )


def preconditioned(levels: list[Level], residual: np.ndarray, largest: float) -> np.ndarray:
    """One V-cycle from zero: about the displacements of a residual."""
    level = levels[0]
    if len(levels) == 1:
        return _smoothed(
            level, np.zeros_like(residual), residual, largest, _LOWEST_THERE, _COARSEST_DEGREE
        )
    u = _smoothed(level, np.zeros_like(residual), residual, largest, _LOWEST, _DEGREE)
    left = residual - level.part.product(level.density, u)
    coarse = levels[1].part.free
    down = np.where(coarse, _restricted(left, coarse.shape), 0.0)
    u = u + np.where(
        level.part.free, _prolonged(preconditioned(levels[1:], down, largest), u.shape), 0.0
    )
    return _smoothed(
        level, u, residual - level.part.product(level.density, u), largest, _LOWEST, _DEGREE
    )


def _smoothed(
    level: Level, u: np.ndarray, residual: np.ndarray, largest: float, lowest: float, degree: int
) -> np.ndarray:
    """Chebyshev iteration on the eigenvalues from `lowest` to 1 times the largest; residual is that
    of u.
    """
    middle, half = largest * (1 + lowest) / 2, largest * (1 - lowest) / 2
    step = level.inverse * residual / middle
    ratio = half / middle
    u = u + step
    for _ in range(degree - 1):
        residual = residual - level.part.product(level.density, step)
        before, ratio = ratio, 1 / (2 * middle / half - ratio)
        step = ratio * before * step + (2 * ratio / half) * (level.inverse * residual)
        u = u + step
    return u


def largest_eigenvalue(part: Part) -> float:
    """A bound for the diagonal's inverse times the stiffness: that of one brick; rounded up, since
    its bits vary.
    """
    scale = 1 / np.sqrt(np.diag(part.stiffness))
    found = np.linalg.eigvalsh(scale[:, None] * part.stiffness * scale)[-1]
    return float(np.ceil(found * 1000) / 1000)


def _prolonged(coarse: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Trilinear: a fine node at a coarse one takes its value, one between two their mean."""
    fine = coarse
    for axis, side in enumerate(shape[:3]):
        node = np.arange(side)
        even, odd = node[::2] // 2, node[1::2] // 2
        longer = np.empty((*fine.shape[:axis], side, *fine.shape[axis + 1 :]))
        to = [slice(None)] * fine.ndim
        to[axis] = slice(0, None, 2)
        longer[tuple(to)] = fine.take(even, axis)
        to[axis] = slice(1, None, 2)
        longer[tuple(to)] = (fine.take(odd, axis) + fine.take(odd + 1, axis)) / 2
        fine = longer
    return fine


def _restricted(fine: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """The transpose of `_prolonged`."""
    coarse = fine
    for axis, side in enumerate(shape[:3]):
        even, odd = (
            coarse.take(range(0, coarse.shape[axis], 2), axis),
            coarse.take(range(1, coarse.shape[axis], 2), axis),
        )
        shorter = np.zeros((*coarse.shape[:axis], side, *coarse.shape[axis + 1 :]))
        at = [slice(None)] * coarse.ndim
        at[axis] = slice(0, even.shape[axis])
        shorter[tuple(at)] += even
        at[axis] = slice(0, odd.shape[axis])
        shorter[tuple(at)] += odd / 2
        at[axis] = slice(1, odd.shape[axis] + 1)
        shorter[tuple(at)] += odd / 2
        coarse = shorter
    return coarse
