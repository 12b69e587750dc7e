"""A multigrid cycle over levels that bring their own smoother, restriction and prolongation.

The cycle is a preconditioner: it maps a right-hand side to an approximate solution. Its visits to
the next level make it a V-cycle (one visit), a W-cycle (two, the second from the result of the
first) or a K-cycle (two, joined by conjugate gradients). See Briggs, Henson and McCormick 2000,
doi:10.1137/1.9780898719505, chapter 3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Generic, Protocol, TypeVar

import numpy as np

from trabecula.numerics.vectors import combine, dot, subtract

_ENOUGH = 0.25  # residual after one coarse step below which the K-cycle leaves out the second


class GridLevel(Protocol):
    """One grid of the cycle; the last one needs `solve` alone."""

    def presmooth(self, right: np.ndarray, x: np.ndarray | None) -> np.ndarray:
        """Return x smoothed; None stands for zero."""

    def restrict(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the residual of a smoothed x on the next level."""

    def prolong(self, correction: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return x and the next level's correction added."""

    def postsmooth(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return x smoothed, by the transpose of `presmooth`."""

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return the solution on the coarsest grid, or nearly that."""


class ProductLevel(GridLevel, Protocol):
    """A level that knows its matrix, for the K-cycle."""

    def apply(self, x: np.ndarray) -> np.ndarray:
        """Return the matrix times x."""


L = TypeVar("L", bound=GridLevel)
P = TypeVar("P", bound=ProductLevel)
Visit = Callable[["Multigrid[L]", int, np.ndarray], np.ndarray]
"""Approximate solution on a level for a right-hand side, by one or more cycles from there."""


class Multigrid(Generic[L]):
    """The preconditioner: levels, finest first, and the way in which a level visits the next one.

    Calling it maps a residual to a correction.
    """

    def __init__(self, levels: Sequence[L], visit: Visit[L]) -> None:
        self.levels, self.visit = levels, visit

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """Return an approximate solution for a residual."""
        return self.cycle(0, residual)

    def cycle(self, depth: int, right: np.ndarray, x: np.ndarray | None = None) -> np.ndarray:
        """Return x improved by one cycle from level `depth` down; None stands for zero."""
        level = self.levels[depth]
        if depth + 1 == len(self.levels):
            return level.solve(right)
        x = level.presmooth(right, x)
        below = level.restrict(right, x)
        last = depth + 2 == len(self.levels)
        correction = self.cycle(depth + 1, below) if last else self.visit(self, depth + 1, below)
        return level.postsmooth(right, level.prolong(correction, x))


def v_cycle(multigrid: Multigrid[L], depth: int, right: np.ndarray) -> np.ndarray:
    """Solve roughly by one cycle."""
    return multigrid.cycle(depth, right)


def w_cycle(multigrid: Multigrid[L], depth: int, right: np.ndarray) -> np.ndarray:
    """Solve roughly by two cycles, the second from the result of the first."""
    return multigrid.cycle(depth, right, multigrid.cycle(depth, right))


def k_cycle(multigrid: Multigrid[P], depth: int, right: np.ndarray) -> np.ndarray:
    """Solve roughly by two steps of flexible conjugate gradients, each preconditioned by a cycle.

    Notay and Vassilevski 2008, doi:10.1002/nla.542. Right-hand sides are vectors of one axis.
    """
    level = multigrid.levels[depth]
    first = multigrid.cycle(depth, right)
    image = level.apply(first)
    energy, along = dot(first, image), dot(first, right)
    if energy <= 0.0:
        return first
    step = along / energy
    rest = subtract(right, step, image)
    if dot(rest, rest) <= _ENOUGH**2 * dot(right, right):
        return combine(step, first, 0.0, first)
    second = multigrid.cycle(depth, rest)
    cross, own = dot(second, image), dot(second, level.apply(second))
    gain = dot(second, rest)
    remaining = own - cross * cross / energy
    if remaining <= 0.0:
        return combine(step, first, 0.0, first)
    return combine(step - cross * gain / (energy * remaining), first, gain / remaining, second)
