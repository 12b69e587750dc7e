"""The elastic solve: conjugate gradients, preconditioned by a W-cycle over coarser grids; all load
cases at once.

The smoother is one damped step with the diagonal blocks: it has no order of nodes, so the result
does not depend on the threads. (Chebyshev polynomials of degree 2 and 3 saved few iterations on
bone, and each cost more.) The operator has a null space: shifts, and turns of what is connected
along one axis only. Loads are orthogonal to it, so the method needs no care for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.mechanics.coarsen import Interpolation, coarsen, gather
from trabecula.measure.mechanics.lattice import (
    LEAST,
    LOADS,
    BlockOperator,
    Cells,
    apply,
    assemble,
    dot,
    incidence,
    relax,
    row_keys,
)
from trabecula.numerics.krylov import Iterate, LinearSystem, conjugate_gradients
from trabecula.numerics.multigrid import Multigrid, w_cycle

_DENSE = 250  # nodes up to which the coarsest problem is solved by its inverse
# of the smoother, over the largest eigenvalue; 2 would keep the fastest error as it is
_DAMPING = 1.8


@dataclass(frozen=True)
class Solution:
    """Displacements (nodes, 3, LOADS), and the iterations that they took."""

    displacement: np.ndarray
    iterations: int
    converged: bool


@dataclass(frozen=True, eq=False)
class ElasticLevel:
    """One grid of the W-cycle, with room for its vectors."""

    operator: BlockOperator
    largest: float
    """Eigenvalue of D^-1 A, or a little more; D holds the diagonal blocks."""
    to_coarse: Interpolation | None
    inverse: np.ndarray | None
    """Of the whole operator, on the coarsest grid."""
    x: np.ndarray
    product: np.ndarray
    coarse_right: np.ndarray | None

    def presmooth(self, right: np.ndarray, x: np.ndarray | None) -> np.ndarray:
        """Smooth x, from zero where it is None."""
        if x is not None:
            return self.postsmooth(right, x)
        self.x[:] = 0.0
        relax(self.operator, right, _DAMPING / self.largest, self.x)
        return self.x

    def restrict(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the residual on the next grid."""
        assert self.to_coarse is not None and self.coarse_right is not None
        gather(self.to_coarse.up, self._residual(right, x), self.coarse_right, add=False)
        return self.coarse_right

    def prolong(self, correction: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Add the correction of the next grid."""
        assert self.to_coarse is not None
        gather(self.to_coarse.down, correction, x, add=True)
        return x

    def postsmooth(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Smooth x by one damped step with the diagonal blocks."""
        relax(self.operator, self._residual(right, x), _DAMPING / self.largest, x)
        return x

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return the solution by the inverse; one step of the smoother where there is none."""
        if self.inverse is None:
            return self.presmooth(right, None)
        np.matmul(self.inverse, right.reshape(-1, LOADS), out=self.x.reshape(-1, LOADS))
        return self.x

    def _residual(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        apply(self.operator, x, self.product)
        return np.subtract(right, self.product, out=self.product)


class ElasticSystem(LinearSystem):
    """The finest grid as a system of `conjugate_gradients`, every load case a right-hand side."""

    def __init__(self, levels: list[ElasticLevel]) -> None:
        self.finest = levels[0]
        # On coarse grids a W-cycle takes half the iterations of a V-cycle.
        self.multigrid = Multigrid(levels, w_cycle)

    def apply(self, vector: np.ndarray) -> np.ndarray:
        """Return the operator times a vector."""
        return apply(self.finest.operator, vector, self.finest.product)

    def precondition(self, residual: np.ndarray) -> np.ndarray:
        """Return an approximate solution by a cycle of multigrid."""
        return self.multigrid(residual)

    def dot(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return the inner product of every load case."""
        return dot(a, b)

    def turn(self, direction: np.ndarray, factor: np.ndarray, z: np.ndarray) -> None:
        """Replace the direction by `z + factor * direction`, in threads."""
        for_slabs(partial(_turn, direction, z, factor), len(z), least=LEAST)

    def advance(
        self, at: Iterate, length: np.ndarray, direction: np.ndarray, product: np.ndarray
    ) -> None:
        """Add `length * direction` to x and take `length * product` from the residual."""
        work = partial(_advance, at.x, direction, at.residual, product, length)
        for_slabs(work, len(at.x), least=LEAST)


def build_levels(cells: Cells) -> list[ElasticLevel]:
    """Build the grids, finest first."""
    levels: list[ElasticLevel] = []
    while True:
        finest = not levels
        around = incidence(cells)
        operator = assemble(cells, around, row_keys(cells) if finest else None)
        last = all(len(line) == 2 for line in cells.lines) or cells.count <= _DENSE
        coarse, between = (None, None) if last else coarsen(cells, around, repeated=finest)
        inverse = _invert(operator) if last and cells.count <= 4 * _DENSE else None
        largest = _bound_largest(cells.matrices) if finest else _estimate_largest(operator)
        x, product = (np.zeros((cells.count, 3, LOADS)) for _ in range(2))
        right = None if coarse is None else np.zeros((coarse.count, 3, LOADS))
        levels.append(ElasticLevel(operator, largest, between, inverse, x, product, right))
        if coarse is None:
            return levels
        cells = coarse


def solve(
    levels: list[ElasticLevel],
    load: np.ndarray,
    *,
    whole: np.ndarray,
    tolerance: float,
    most_iterations: int,
) -> Solution:
    """Solve for every load case, (nodes, 3, LOADS); `load` is overwritten.

    `whole` is the energy of the unrelaxed field, (LOADS,): what remains of it is the stiffness. The
    residual times its preconditioned self estimates the square of the error in the energy norm,
    which is also the error of the stiffness.
    """

    def error(at: Iterate) -> np.ndarray:
        # a floor: along some axis nothing may be left
        left = np.maximum(whole - at.energy, 1e-6 * whole)
        return np.sqrt(np.maximum(at.rho, 0) / left)

    last, converged = conjugate_gradients(
        ElasticSystem(levels),
        np.zeros_like(load),
        load,
        accept=lambda at: bool(error(at).max() <= tolerance),
        most=most_iterations,
    )
    return Solution(last.x, last.steps, converged)


def _bound_largest(matrices: np.ndarray) -> float:
    """Bound the largest eigenvalue of D^-1 A by that of a single brick: A and D are sums over
    bricks.
    """
    largest = 0.0
    for matrix in matrices:
        diagonal = np.zeros((24, 24))
        for a in range(0, 24, 3):
            diagonal[a : a + 3, a : a + 3] = matrix[a // 3, a // 3]
        flat = matrix.transpose(0, 2, 1, 3).reshape(24, 24)
        largest = max(largest, float(np.linalg.eigvals(np.linalg.solve(diagonal, flat)).real.max()))
    return largest


def _estimate_largest(operator: BlockOperator) -> float:
    """Estimate the largest eigenvalue of D^-1 A, with a margin, by the power method on six fixed
    vectors.

    Too low a value would make the smoother amplify what it should remove, so neither the number of
    steps nor the margin is tight.
    """
    shape = (operator.count, 3, LOADS)
    # no pattern of the grid has this period
    vector = np.cos(np.arange(np.prod(shape)) * 0.7548776662).reshape(shape)
    product = np.empty(shape)
    size = np.ones(LOADS)
    for _ in range(20):
        apply(operator, vector, product)
        vector[:] = 0.0
        relax(operator, product, 1.0, vector)
        size = np.sqrt(dot(vector, vector))
        vector /= np.where(size > 0, size, 1.0)
    return 1.15 * float(size.max()) or 1.0


def _invert(operator: BlockOperator) -> np.ndarray:
    """Return the inverse of the operator beside its null space, (3 count, 3 count)."""
    o = operator
    dense = np.zeros((o.count, 3, o.count, 3))
    for n in range(o.count):
        width = int(o.first[n + 1]) - int(o.first[n])
        near = o.neighbour[o.first[n] : o.first[n + 1]]
        dense[n][:, near] = o.values[o.start[n] : int(o.start[n]) + width].transpose(1, 0, 2)
    matrix = dense.reshape(3 * o.count, 3 * o.count)
    # Scaled to a diagonal of ones: a coarse node that holds a splinter is as soft as it is small,
    # not as a null space.
    diagonal = matrix.diagonal()
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    matrix = matrix * scale * scale[:, None]
    value, vector = np.linalg.eigh((matrix + matrix.T) / 2)
    keep = value > 1e-9 * value[-1]
    vector = vector[:, keep] * scale[:, None]
    return (vector / value[keep]) @ vector.T


@kernel
def _turn(direction, z, factor, begin, end):
    for n in range(begin, end):
        for i in range(3):
            for j in range(LOADS):
                direction[n, i, j] = z[n, i, j] + factor[j] * direction[n, i, j]


@kernel
def _advance(x, direction, residual, product, pace, begin, end):
    for n in range(begin, end):
        for i in range(3):
            for j in range(LOADS):
                x[n, i, j] += pace[j] * direction[n, i, j]
                residual[n, i, j] -= pace[j] * product[n, i, j]
