"""Aggregation multigrid for M-matrices on graphs: the preconditioner of every solve in this room.

Notay 2010, "An aggregation-based algebraic multigrid method" (Electronic Transactions on Numerical
Analysis 37, 123-146), with geometric aggregates: the nodes of a 2x2x2 block that are connected
inside it become one node of the next level. Pores on both sides of a wall so stay apart on every
level, however thin the wall, and blocks without walls give the coarse grid of plain geometric
multigrid. The coarse matrix is the Galerkin product with piecewise constants; the scale error of
these is repaired by two steps of conjugate gradients on every level (the K-cycle).

Vectors inside the cycle are float32.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import one_blas_thread
from trabecula.measure.transport.graph import Graph
from trabecula.measure.union_find import join, number_trees
from trabecula.numerics.multigrid import Multigrid, k_cycle

_DIRECT = 256  # unknowns of the coarsest level, which is solved by its inverse
_SLOWEST = 0.8  # of a level's nodes: one that keeps more of them is not worth its work
_STRONG = 0.1  # couplings below this share of the strongest of either node do not aggregate
_SWEEPS = 20  # of a coarsest level that is too large for its inverse


@dataclass(frozen=True, eq=False)
class GraphLevel:
    """One level: its matrix, and the way to the next."""

    graph: Graph
    inverse: np.ndarray
    """(N,) float32: of the diagonal."""
    aggregate: np.ndarray
    """(N,) int32: the node of the next level; empty on the last."""
    count: int
    """Number of nodes of the next level."""
    whole_inverse: np.ndarray | None
    """(N, N) float32: of the matrix, on a last level that is small enough."""

    def apply(self, x: np.ndarray) -> np.ndarray:
        """Return the matrix times x."""
        return self.graph.apply(x)

    def presmooth(self, right: np.ndarray, x: np.ndarray | None) -> np.ndarray:
        """Return the result of a forward Gauss-Seidel sweep from zero (the K-cycle has no other
        start)."""
        g = self.graph
        return _forward(g.start, g.middle, g.other, g.weight, self.inverse, right)

    def restrict(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the residual of a swept x, summed over aggregates."""
        g = self.graph
        return _restrict(g.start, g.middle, g.other, g.weight, self.aggregate, x, self.count)

    def prolong(self, correction: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Add the correction of its aggregate to every node."""
        _prolong(self.aggregate, correction, x)
        return x

    def postsmooth(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Smooth x by a backward Gauss-Seidel sweep."""
        g = self.graph
        _backward(g.start, g.other, g.weight, self.inverse, right, x)
        return x

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return the solution by the inverse, or nearly that by sweeps."""
        if self.whole_inverse is not None:
            return _times(self.whole_inverse, right)
        return _sweep(*self.graph.rows, self.inverse, right, _SWEEPS)


class AggregationMultigrid(Multigrid[GraphLevel]):
    """The preconditioner of a graph; calling it maps a residual to a correction, both float64."""

    def __init__(self, graph: Graph) -> None:
        super().__init__(build_levels(graph), k_cycle)

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """Return an approximate solution for a residual."""
        return self.cycle(0, np.asarray(residual, np.float32)).astype(np.float64)


def build_levels(graph: Graph) -> list[GraphLevel]:
    """Build the hierarchy below a matrix, finest first."""
    levels: list[GraphLevel] = []
    while True:
        inverse = (1.0 / graph.diagonal).astype(np.float32)
        small = len(inverse) <= _DIRECT
        coarser = None if small else _coarsen(graph)
        if coarser is None:
            whole = _invert(graph) if small else None
            return [*levels, GraphLevel(graph, inverse, np.zeros(0, np.int32), 0, whole)]
        aggregate, below = coarser
        levels.append(GraphLevel(graph, inverse, aggregate, len(below.diagonal), None))
        graph = below


def _coarsen(graph: Graph) -> tuple[np.ndarray, Graph] | None:
    """Return aggregates and the next level; None where even blocks of the whole grid would join few
    nodes.
    """
    place = graph.place
    strongest = _strongest_couplings(graph.start, graph.weight)
    while True:
        # weakly coupled nodes have to be joined at last, or the level would never get coarse
        for strong in (_STRONG, 0.0):
            aggregate, count = _aggregate_blocks(
                graph.start, graph.middle, graph.other, graph.weight, strongest, place, strong
            )
            if count <= _SLOWEST * len(place):
                links = _galerkin(*graph.rows, graph.middle, place, aggregate, count)
                return aggregate, Graph(*links)
        if not place.any():
            return None
        place = place >> 1  # no two neighbours in one block: double the blocks


def _invert(graph: Graph) -> np.ndarray:
    matrix = np.diag(graph.diagonal)
    row = np.repeat(np.arange(len(graph.diagonal)), np.diff(graph.start))
    matrix[row, graph.other] = -graph.weight
    with one_blas_thread():  # the bits of a threaded inverse depend on the number of threads
        return np.linalg.inv(matrix).astype(np.float32)


@kernel
def _times(matrix, right):
    x = np.zeros(len(right), np.float32)
    for i in range(len(right)):
        total = 0.0
        for j in range(len(right)):
            total += matrix[i, j] * right[j]
        x[i] = total
    return x


@kernel
def _forward(start, middle, other, weight, inverse, right):
    """Sweep once by Gauss-Seidel from zero: only neighbours before a node have a value yet."""
    x = np.empty(len(right), np.float32)
    for i in range(len(right)):
        total = right[i]
        for k in range(start[i], middle[i]):
            total += weight[k] * x[other[k]]
        x[i] = total * inverse[i]
    return x


@kernel
def _restrict(start, middle, other, weight, aggregate, x, count):
    """Return the residual summed over aggregates: after a forward sweep, the sum over the later
    neighbours.
    """
    coarse = np.zeros(count, np.float32)
    for i in range(len(x)):
        total = np.float32(0.0)
        for k in range(middle[i], start[i + 1]):
            total += weight[k] * x[other[k]]
        coarse[aggregate[i]] += total
    return coarse


@kernel
def _prolong(aggregate, coarse, x):
    for i in range(len(x)):
        x[i] += coarse[aggregate[i]]


@kernel
def _backward(start, other, weight, inverse, right, x):
    for i in range(len(x) - 1, -1, -1):
        total = right[i]
        for k in range(start[i], start[i + 1]):
            total += weight[k] * x[other[k]]
        x[i] = total * inverse[i]


@kernel
def _sweep(start, other, weight, diagonal, inverse, right, count):
    """Sweep by symmetric Gauss-Seidel from zero, `count` times."""
    x = np.zeros(len(right), np.float32)
    for _ in range(count):
        for n in range(2 * len(right)):
            i = n if n < len(right) else 2 * len(right) - 1 - n
            total = right[i]
            for k in range(start[i], start[i + 1]):
                total += weight[k] * x[other[k]]
            x[i] = total * inverse[i]
    return x


@kernel
def _strongest_couplings(start, weight):
    strongest = np.zeros(len(start) - 1, np.float32)
    for i in range(len(strongest)):
        for k in range(start[i], start[i + 1]):
            strongest[i] = max(strongest[i], weight[k])
    return strongest


@kernel
def _aggregate_blocks(start, middle, other, weight, strongest, place, strong):
    """Join the nodes of one 2x2x2 block along strong couplings; number aggregates by their first
    node.
    """
    parent = np.arange(len(start) - 1)
    for i in range(len(parent)):
        for k in range(start[i], middle[i]):
            j = other[k]
            same = (place[i, 0] >> 1 == place[j, 0] >> 1) and (place[i, 1] >> 1 == place[j, 1] >> 1)
            if not (same and place[i, 2] >> 1 == place[j, 2] >> 1):
                continue
            if weight[k] < strong * max(strongest[i], strongest[j]):
                continue
            join(parent, i, np.int64(j))
    aggregate, count = number_trees(parent)
    return aggregate.astype(np.int32), count


@kernel
def _list_members(aggregate, count):
    """List the nodes of every aggregate: member[first[c]] to member[first[c + 1]]."""
    first = np.zeros(count + 1, np.int64)
    for i in range(len(aggregate)):
        first[aggregate[i] + 1] += 1
    for c in range(count):
        first[c + 1] += first[c]
    member = np.empty(len(aggregate), np.int32)
    at = first[:-1].copy()
    for i in range(len(aggregate)):
        member[at[aggregate[i]]] = i
        at[aggregate[i]] += 1
    return first, member


@kernel
def _galerkin(start, other, weight, diagonal, middle, place, aggregate, count):
    """Return the matrix between aggregates, as the fields of a Graph: sums of the couplings between
    them.
    """
    first, member = _list_members(aggregate, count)
    begin, half = np.zeros(count + 1, np.int64), np.empty(count, np.int64)
    to, pull = np.empty(len(other), np.int32), np.empty(len(other), np.float32)
    total, where = np.zeros(count), np.empty((count, 3), np.int16)
    mark = np.full(count, -1, np.int64)
    used = 0
    for c in range(count):
        begin[c] = used
        for later in range(2):
            for m in range(first[c], first[c + 1]):
                i = member[m]
                if later == 0:
                    total[c] += diagonal[i]
                    for d in range(3):
                        where[c, d] = place[i, d] >> 1
                for k in range(start[i], start[i + 1]):
                    a = aggregate[other[k]]
                    if a == c:
                        total[c] -= weight[k] if later else 0.0
                    elif (a > c) == (later == 1):
                        if mark[a] < begin[c]:
                            mark[a] = used
                            to[used], pull[used] = a, 0.0
                            used += 1
                        pull[mark[a]] += weight[k]
            if later == 0:
                half[c] = used
    begin[count] = used
    return begin, half, to[:used].copy(), pull[:used].copy(), total, where
