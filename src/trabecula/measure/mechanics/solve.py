"""Conjugate gradients, preconditioned by a W-cycle over coarser grids; all load cases at once.

The smoother is one damped step with the diagonal blocks: it has no order of nodes, so the result
does not depend on the threads. (Chebyshev polynomials of degree 2 and 3 saved few iterations on
bone, and each cost more.) The operator has a null space: shifts, and turns of what hangs together
along one axis only. Loads are orthogonal to it, so the method goes on without noticing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.mechanics.coarsen import Interpolation, coarsen, gather
from trabecula.measure.mechanics.lattice import (
    LEAST,
    LOADS,
    Cells,
    Operator,
    apply,
    assemble,
    dot,
    incidence,
    relax,
    row_keys,
)

_DENSE = 250  # nodes up to which the coarsest problem is solved by its inverse
# of the smoother, over the largest eigenvalue; 2 would keep the fastest error as it is
_DAMPING = 1.8


@dataclass(frozen=True)
class Solution:
    """Displacements (nodes, 3, LOADS), and how they were reached."""

    displacement: np.ndarray
    energy: np.ndarray
    """What the displacements relax, load . displacement, (LOADS,)."""
    error: np.ndarray
    """Estimated error in the energy norm, over that of the whole field, (LOADS,)."""
    iterations: int
    converged: bool


@dataclass(frozen=True)
class Level:
    """One grid of the W-cycle."""

    operator: Operator
    largest: float
    to_coarse: Interpolation | None
    inverse: np.ndarray | None
    """Of the whole operator, on the coarsest grid."""
    vectors: tuple[np.ndarray, ...]
    """Room for right side, solution and product; none on the finest grid."""


def build_levels(cells: Cells) -> list[Level]:
    """The grids, finest first."""
    levels: list[Level] = []
    while True:
        finest = not levels
        around = incidence(cells)
        operator = assemble(cells, around, row_keys(cells) if finest else None)
        last = all(len(line) == 2 for line in cells.lines) or cells.count <= _DENSE
        coarse, between = (None, None) if last else coarsen(cells, around, repeated=finest)
        inverse = _inverse(operator) if last and cells.count <= 4 * _DENSE else None
        room = tuple(np.zeros((cells.count, 3, LOADS)) for _ in range(0 if finest else 3))
        largest = _largest_of_bricks(cells.matrices) if finest else _largest(operator)
        levels.append(Level(operator, largest, between, inverse, room))
        if coarse is None:
            return levels
        cells = coarse


def solve(
    levels: list[Level],
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
    operator = levels[0].operator
    residual, x = load, np.zeros_like(load)
    z, product = np.zeros_like(load), np.zeros_like(load)
    energy: np.ndarray = np.zeros(LOADS)
    direction = np.zeros_like(load)
    before: np.ndarray = np.ones(LOADS)
    for iteration in range(most_iterations + 1):
        _cycle(levels, 0, residual, z, product)
        now = dot(residual, z)
        # a floor: along some axis nothing may be left
        left = np.maximum(whole - energy, 1e-6 * whole)
        error = np.sqrt(np.maximum(now, 0) / left)
        if error.max() <= tolerance or iteration == most_iterations:
            break
        _combine(direction, z, now / before if iteration else np.zeros(LOADS))
        apply(operator, direction, product)
        curvature = dot(direction, product)
        pace = np.where(curvature > 0, now / np.where(curvature > 0, curvature, 1.0), 0.0)
        _advance(x, direction, residual, product, pace)
        energy += pace * now
        before = np.where(now > 0, now, 1.0)
    return Solution(x, energy, error, iteration, bool(error.max() <= tolerance))


def _cycle(
    levels: list[Level], at: int, right: np.ndarray, x: np.ndarray, product: np.ndarray
) -> None:
    """x = an approximate solution for `right`, symmetric and linear in it."""
    level = levels[at]
    if level.inverse is not None:
        np.matmul(level.inverse, right.reshape(-1, LOADS), out=x.reshape(-1, LOADS))
        return
    pace = _DAMPING / level.largest
    x[:] = 0.0
    relax(level.operator, right, pace, x)
    if level.to_coarse is None:
        return
    # On coarse grids two rounds, the second on what the first left (a W-cycle): half the iterations
    # of a V-cycle.
    for again in range(2 if at else 1):
        _remainder(level.operator, right, x, product)
        if again:
            relax(level.operator, product, pace, x)
            _remainder(level.operator, right, x, product)
        coarse_right, coarse_x, coarse_product = levels[at + 1].vectors
        gather(level.to_coarse.up, product, coarse_right, add=False)
        _cycle(levels, at + 1, coarse_right, coarse_x, coarse_product)
        gather(level.to_coarse.down, coarse_x, x, add=True)
        _remainder(level.operator, right, x, product)
        relax(level.operator, product, pace, x)


def _remainder(operator: Operator, right: np.ndarray, x: np.ndarray, out: np.ndarray) -> None:
    apply(operator, x, out)
    np.subtract(right, out, out=out)


def _largest_of_bricks(matrices: np.ndarray) -> float:
    """The largest eigenvalue of D^-1 A is at most that of a single brick: A and D are sums over
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


def _largest(operator: Operator) -> float:
    """A little above the largest eigenvalue of D^-1 A, by the power method on six fixed vectors.

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


def _inverse(operator: Operator) -> np.ndarray:
    """Inverse of the operator beside its null space, (3 count, 3 count)."""
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


def _combine(direction: np.ndarray, z: np.ndarray, factor: np.ndarray) -> None:
    for_slabs(lambda a, b: _turn(direction, z, factor, a, b), len(z), least=LEAST)


def _advance(
    x: np.ndarray,
    direction: np.ndarray,
    residual: np.ndarray,
    product: np.ndarray,
    pace: np.ndarray,
) -> None:
    for_slabs(lambda a, b: _go(x, direction, residual, product, pace, a, b), len(x), least=LEAST)


@kernel
def _turn(direction, z, factor, begin, end):
    for n in range(begin, end):
        for i in range(3):
            for j in range(LOADS):
                direction[n, i, j] = z[n, i, j] + factor[j] * direction[n, i, j]


@kernel
def _go(x, direction, residual, product, pace, begin, end):
    for n in range(begin, end):
        for i in range(3):
            for j in range(LOADS):
                x[n, i, j] += pace[j] * direction[n, i, j]
                residual[n, i, j] -= pace[j] * product[n, i, j]
