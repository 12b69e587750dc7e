"""Displacements of a part under its loads: conjugate gradients, preconditioned by a V-cycle over
coarser grids of elements.

On a coarser grid an element of twice the edge has the mean density of the eight it covers;
densities between bounds vary so little that this stays close to the fine problem. Smoothing is by
Chebyshev polynomials of the diagonal's inverse: they have no order of nodes, so the result does not
depend on threads.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from trabecula.core.errors import InputError
from trabecula.fields.topology.elements import ElementGrid, dot
from trabecula.fields.topology.places import at_corners
from trabecula.numerics.krylov import Iterate, LinearSystem, conjugate_gradients
from trabecula.numerics.multigrid import Multigrid, v_cycle

_DEGREE, _COARSEST_DEGREE = 3, 40  # products of the smoother
_LOWEST, _LOWEST_THERE = 0.12, 0.002  # of the largest eigenvalue: the smoother's lower end
_FEW = 80  # nodes of the coarsest grid, about
_SOFTEST = 2e-11  # energy over that of every node for itself; a beam of 300 elements has 1e-10
_LOOSE = (
    "the loads find no balance: the part is not held firmly enough, or is not connected; give more "
    "supports, or a mask of one connected component"
)


@dataclass(frozen=True, eq=False)
class DensityLevel:
    """One grid of the V-cycle with its densities."""

    grid: ElementGrid
    density: np.ndarray
    inverse: np.ndarray
    """Of the diagonal; 0 where a node is held."""
    largest: float
    """Bound for the eigenvalues of the diagonal's inverse times the stiffness."""
    free_below: np.ndarray | None = None
    """Of the next grid; None on the last."""

    def presmooth(self, right: np.ndarray, x: np.ndarray | None) -> np.ndarray:
        """Smooth x, from zero where it is None."""
        if x is not None:
            return self.postsmooth(right, x)
        return self._chebyshev(np.zeros_like(right), right, _LOWEST, _DEGREE)

    def restrict(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the residual on the next grid."""
        assert self.free_below is not None
        left = self._residual(right, x)
        return np.where(self.free_below, _restrict(left, self.free_below.shape), 0.0)

    def prolong(self, correction: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return x and the correction of the next grid added."""
        return x + np.where(self.grid.free, _prolong(correction, x.shape), 0.0)

    def postsmooth(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return x smoothed."""
        return self._chebyshev(x, self._residual(right, x), _LOWEST, _DEGREE)

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return the solution on the coarsest grid by a polynomial of high degree."""
        return self._chebyshev(np.zeros_like(right), right, _LOWEST_THERE, _COARSEST_DEGREE)

    def _residual(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        return right - self.grid.product(self.density, x)

    def _chebyshev(
        self, u: np.ndarray, residual: np.ndarray, lowest: float, degree: int
    ) -> np.ndarray:
        """Improve u by Chebyshev polynomials for eigenvalues from `lowest` to 1 times the largest;
        the residual is that of u.
        """
        middle, half = self.largest * (1 + lowest) / 2, self.largest * (1 - lowest) / 2
        step = self.inverse * residual / middle
        ratio = half / middle
        u = u + step
        for _ in range(degree - 1):
            residual = self._residual(residual, step)
            before, ratio = ratio, 1 / (2 * middle / half - ratio)
            step = ratio * before * step + (2 * ratio / half) * (self.inverse * residual)
            u = u + step
        return u


class DensitySystem(LinearSystem):
    """Elements with their densities as a system of `conjugate_gradients`."""

    def __init__(self, grid: ElementGrid, density: np.ndarray) -> None:
        self.grid, self.density = grid, density
        self.multigrid = Multigrid(build_levels(grid, density), v_cycle)

    def apply(self, vector: np.ndarray) -> np.ndarray:
        """Return the forces of displacements."""
        return self.grid.product(self.density, vector)

    def precondition(self, residual: np.ndarray) -> np.ndarray:
        """Return approximate displacements by a cycle of multigrid."""
        return self.multigrid(residual)

    def dot(self, a: np.ndarray, b: np.ndarray) -> float:
        """Return the inner product."""
        return float(dot(a.ravel(), b.ravel()))


def solve_displacements(
    grid: ElementGrid, density: np.ndarray, start: np.ndarray, *, tolerance: float, most: int
) -> np.ndarray:
    """Solve for the displacements, from `start`; the residual falls to `tolerance` of the load.

    Raises
    ------
    InputError
        Loads that no support balances.
    """
    system = DensitySystem(grid, density)
    u = start.copy()
    goal = tolerance * np.sqrt(system.dot(grid.load, grid.load))

    def accept(at: Iterate) -> bool:
        return bool(np.sqrt(system.dot(at.residual, at.residual)) <= goal)

    residual = grid.load - system.apply(u)
    if not conjugate_gradients(system, u, residual, accept=accept, most=most)[1]:
        raise InputError(_LOOSE)
    stretch = system.dot(u * grid.diagonal(density), u)
    # it moves as a whole: only rounding holds it
    if system.dot(u, grid.load) < _SOFTEST * stretch:
        raise InputError(_LOOSE)
    return u


def build_levels(grid: ElementGrid, density: np.ndarray) -> list[DensityLevel]:
    """Build the grids, finest first."""
    levels: list[DensityLevel] = []
    largest = bound_eigenvalue(grid)
    while True:
        inverse = np.where(grid.free, 1 / grid.diagonal(density), 0.0)
        level = DensityLevel(grid, density, inverse, largest)
        if min(density.shape) < 2 or grid.free[..., 0].size <= _FEW:
            return [*levels, level]
        padded = np.pad(density, [(0, side % 2) for side in density.shape])
        z, y, x = (side // 2 for side in padded.shape)
        density = padded.reshape(z, 2, y, 2, x, 2).sum(axis=(1, 3, 5)) / 8
        grid = _coarsen(grid, density > 0)
        levels.append(replace(level, free_below=grid.free))


def _coarsen(grid: ElementGrid, inside: np.ndarray) -> ElementGrid:
    """Return the next grid: a node is held where the fine one at its place is, or an odd one
    beside it, which has none at its own place. Nodes outside of the part hold nothing.
    """
    held = ~grid.free & at_corners(grid.inside)[..., None]
    for axis, side in enumerate(inside.shape):
        fine = [np.zeros_like(held.take([0], axis)), held]
        missing = 2 * side + 2 - held.shape[axis]  # beyond the far face of an odd side
        fine.append(np.zeros_like(held.take(np.zeros(missing, int), axis)))
        long = np.concatenate(fine, axis)  # node k of the fine grid is at k + 1
        at = 2 * np.arange(side + 1) + 1
        held = long.take(at, axis) | long.take(at - 1, axis) | long.take(at + 1, axis)
    # A brick twice as large is twice as stiff.
    return replace(
        grid,
        stiffness=2 * grid.stiffness,
        inside=inside,
        free=~held & at_corners(inside)[..., None],
        load=np.zeros(held.shape),
    )


def bound_eigenvalue(grid: ElementGrid) -> float:
    """Bound the eigenvalues of the diagonal's inverse times the stiffness by those of one brick;
    round up, since their bits vary.
    """
    scale = 1 / np.sqrt(np.diag(grid.stiffness))
    found = np.linalg.eigvalsh(scale[:, None] * grid.stiffness * scale)[-1]
    return float(np.ceil(found * 1000) / 1000)


def _prolong(coarse: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Interpolate linearly along every axis: a fine node at a coarse one takes its value, one
    between two their mean.
    """
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


def _restrict(fine: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Apply the transpose of `_prolong`."""
    coarse = fine
    for axis, side in enumerate(shape[:3]):
        even, odd = (coarse.take(range(k, coarse.shape[axis], 2), axis) for k in (0, 1))
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
