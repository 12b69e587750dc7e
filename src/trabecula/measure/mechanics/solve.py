"""The elastic operator and its solve: conjugate gradients, preconditioned by a W-cycle over coarser
grids; all load cases at once.

Operators are rows of 3x3 blocks, assembled from the cells of a grid. On the finest grid rows are
shared: a row depends only on the materials of the eight voxels around its node, so that two phases
need at most 255 of them.

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
from trabecula.engine.rows import add_block, copy_block
from trabecula.measure.mechanics.lattice import (
    LEAST,
    LOADS,
    Cells,
    Interpolation,
    coarsen,
    gather,
    incidence,
    row_keys,
)
from trabecula.numerics.krylov import Iterate, LinearSystem, conjugate_gradients
from trabecula.numerics.multigrid import Multigrid, w_cycle

_CHUNK = 4096  # nodes that are summed together: fixed, so that sums do not depend on the threads
_SINGLE = 20_000  # nodes from which on a coarse operator is kept in float32: it only preconditions
_DENSE = 250  # nodes up to which the coarsest problem is solved by its inverse
# of the smoother, over the largest eigenvalue; 2 would keep the fastest error as it is
_DAMPING = 1.8


@dataclass(frozen=True)
class BlockOperator:
    """Row n holds the blocks `values[start[n] ...]` for the nodes `neighbour[first[n] .. first[n +
    1]]`.
    """

    first: np.ndarray
    neighbour: np.ndarray
    start: np.ndarray
    values: np.ndarray
    inverse: np.ndarray
    """(rows, 3, 3): inverse of the diagonal block of every distinct row."""
    row: np.ndarray
    """(count,): the distinct row of every node."""

    @property
    def count(self) -> int:
        """Return the number of nodes."""
        return len(self.row)


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


def assemble(
    cells: Cells, incidence: tuple[np.ndarray, np.ndarray], keys: np.ndarray | None = None
) -> BlockOperator:
    """Assemble the operator of the cells; nodes of equal `keys` share their row."""
    first, neighbour = _adjacency(cells.nodes, *incidence)
    if keys is None:
        chosen, row = np.arange(cells.count), np.arange(cells.count, dtype=np.int32)
    else:
        _, chosen, inverse = np.unique(keys, return_index=True, return_inverse=True)
        row = inverse.astype(np.int32)
    width = np.diff(first.astype(np.int64))[chosen]
    begin = np.concatenate([[0], np.cumsum(width)])
    exact = keys is not None or cells.count < _SINGLE
    values = np.zeros((begin[-1], 3, 3), np.float64 if exact else np.float32)
    diagonal = np.zeros((len(chosen), 3, 3))
    _fill(
        chosen,
        cells.nodes,
        cells.kind,
        cells.matrices,
        *incidence,
        first,
        neighbour,
        begin,
        values,
        diagonal,
    )
    inverse = np.linalg.pinv(diagonal, rcond=1e-9, hermitian=True)
    return BlockOperator(first, neighbour, begin[row].astype(np.uint32), values, inverse, row)


def apply(operator: BlockOperator, vector: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Set `out` = operator times `vector`, (count, 3, LOADS)."""
    o = operator
    for_slabs(
        lambda a, b: _apply(o.first, o.neighbour, o.start, o.values, vector, out, a, b),
        operator.count,
        least=LEAST,
    )
    return out


def relax(operator: BlockOperator, residual: np.ndarray, pace: float, x: np.ndarray) -> None:
    """Add pace * D^-1 residual to x; D holds the diagonal blocks."""
    o = operator
    for_slabs(
        lambda a, b: _relax(o.inverse, o.row, residual, pace, x, a, b), operator.count, least=LEAST
    )


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the inner product of every load case, (LOADS,): by chunks of fixed size, added in
    order.
    """
    parts = np.zeros((-(-len(a) // _CHUNK), LOADS))
    for_slabs(lambda i, j: _dots(a, b, parts, i, j), len(parts), least=1)
    return parts.sum(axis=0)


@kernel
def _adjacency(nodes, begin, entry):
    """Return for every node the nodes of its cells, in the order of the incidence."""
    count = len(begin) - 1
    seen = np.full(count, -1, np.int64)
    first = np.zeros(count + 1, np.uint32)
    neighbour = np.empty(0, np.uint32)
    for fill in range(2):
        total = 0
        for n in range(count):
            for i in range(begin[n], begin[n + 1]):
                for b in range(8):
                    m = nodes[entry[i] // 8, b]
                    if seen[m] != n + fill * count:
                        seen[m] = n + fill * count
                        if fill:
                            neighbour[total] = m
                        total += 1
            first[n + 1] = total
        if not fill:
            neighbour = np.empty(total, np.uint32)
    return first, neighbour


@kernel
def _fill(chosen, nodes, kind, matrices, begin, entry, first, neighbour, start, values, diagonal):
    slot = np.zeros(len(begin) - 1, np.int64)
    blocks = np.zeros((1, 3, 3))
    for row in range(len(chosen)):
        n = chosen[row]
        width = first[n + 1] - first[n]
        if width > len(blocks):
            blocks = np.zeros((width, 3, 3))
        blocks[:] = 0
        for k in range(width):
            slot[neighbour[first[n] + k]] = k
        for i in range(begin[n], begin[n + 1]):
            cell, a = entry[i] // 8, entry[i] % 8
            for b in range(8):
                add_block(blocks[slot[nodes[cell, b]]], matrices[kind[cell], a, b])
        for k in range(width):
            copy_block(values[start[row] + k], blocks[k])
        copy_block(diagonal[row], blocks[slot[n]])


@kernel
def _apply(first, neighbour, start, values, u, y, begin, end):
    # Three rows of accumulators and nine scalars of a block: the form that LLVM keeps in registers
    # (twice as fast).
    s0, s1, s2 = np.zeros(LOADS), np.zeros(LOADS), np.zeros(LOADS)
    for n in range(begin, end):
        for j in range(LOADS):
            s0[j] = 0.0
            s1[j] = 0.0
            s2[j] = 0.0
        at = start[n]
        for k in range(first[n], first[n + 1]):
            v = u[neighbour[k]]
            block = values[at]
            at += 1
            b00, b01, b02 = block[0, 0], block[0, 1], block[0, 2]
            b10, b11, b12 = block[1, 0], block[1, 1], block[1, 2]
            b20, b21, b22 = block[2, 0], block[2, 1], block[2, 2]
            for j in range(LOADS):
                p, q, r = v[0, j], v[1, j], v[2, j]
                s0[j] += b00 * p + b01 * q + b02 * r
                s1[j] += b10 * p + b11 * q + b12 * r
                s2[j] += b20 * p + b21 * q + b22 * r
        for j in range(LOADS):
            y[n, 0, j] = s0[j]
            y[n, 1, j] = s1[j]
            y[n, 2, j] = s2[j]


@kernel
def _relax(inverse, row, residual, pace, x, begin, end):
    for n in range(begin, end):
        d, r, t = inverse[row[n]], residual[n], x[n]
        for i in range(3):
            for j in range(LOADS):
                t[i, j] += pace * (d[i, 0] * r[0, j] + d[i, 1] * r[1, j] + d[i, 2] * r[2, j])


@kernel
def _dots(a, b, parts, begin, end):
    for part in range(begin, end):
        for n in range(part * _CHUNK, min((part + 1) * _CHUNK, len(a))):
            for i in range(3):
                for j in range(LOADS):
                    parts[part, j] += a[n, i, j] * b[n, i, j]


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
