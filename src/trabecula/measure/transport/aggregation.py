"""Levels of aggregation multigrid for M-matrices on graphs: below the finest one, every solve of
this room has them.

Notay 2010, "An aggregation-based algebraic multigrid method" (Electronic Transactions on Numerical
Analysis 37, 123-146), with geometric aggregates: the nodes of a 2x2x2 block that are connected
inside it become one node of the next level. Pores on both sides of a wall so stay apart on every
level, however thin the wall, and blocks without walls give the coarse grid of plain geometric
multigrid. The coarse matrix is the Galerkin product with piecewise constants; the scale error of
these is repaired by two steps of conjugate gradients on every level (the K-cycle).

Vectors inside the cycle are float32.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import one_blas_thread
from trabecula.measure.transport.graph import Graph
from trabecula.measure.union_find import join, number_trees

DIRECT = 256  # unknowns of the coarsest level, which is solved by its inverse
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


def build_levels(graph: Graph) -> list[GraphLevel]:
    """Build the hierarchy below a matrix, finest first."""
    levels: list[GraphLevel] = []
    while True:
        inverse = (1.0 / graph.diagonal).astype(np.float32)
        small = len(inverse) <= DIRECT
        coarser = None if small else _coarsen(graph)
        if coarser is None:
            whole = _invert(graph) if small else None
            return [*levels, GraphLevel(graph.trim(), inverse, np.zeros(0, np.int32), 0, whole)]
        aggregate, below = coarser
        levels.append(GraphLevel(graph.trim(), inverse, aggregate, len(below.diagonal), None))
        graph = below


def coarsen_parts(
    parts: Sequence[Callable[[], Graph]], nodes: int
) -> tuple[np.ndarray, Graph] | None:
    """Return aggregates of blocks and the next level of a matrix that is never held as a whole:
    part after part returns the rows of some nodes, no block in two of them; called once or twice.

    None where blocks join few nodes.
    """
    for strong in (_STRONG, 0.0):
        aggregate, count = np.empty(nodes, np.int32), 0
        first = 0
        for rows in parts:
            part = rows()
            strongest = _strongest_couplings(part.start, part.weight)
            linked = part.start, part.middle, part.other, part.weight
            found, more = _aggregate_blocks(*linked, strongest, part.place, strong, first)
            last = first + len(found)
            aggregate[first:last] = found + np.int32(count)
            first, count = last, count + more
        if count <= _SLOWEST * nodes:
            return aggregate, _sum_parts(parts, aggregate, count)
    return None


def _sum_parts(parts: Sequence[Callable[[], Graph]], aggregate: np.ndarray, count: int) -> Graph:
    """Return the matrix between aggregates, part after part."""
    mark = np.full(count, -1, np.int64)
    found: list[tuple[np.ndarray, ...]] = []
    first = done = used = 0
    for rows in parts:
        part = rows()
        last = first + len(part.place)
        own = aggregate[first:last]
        some = int(own.max()) + 1 - done
        linked = *part.rows, part.middle, part.place
        found.append(_galerkin(*linked, own - np.int32(done), some, aggregate, mark, done, used))
        first, done, used = last, done + some, used + len(found[-1][2])
    begin, *fields = [np.concatenate(field) for field in _columns(found)]
    return Graph(np.append(begin, used), *fields)


def _columns(found: list[tuple[np.ndarray, ...]]) -> Iterator[list[np.ndarray]]:
    """Return one field after the other of all parts, dropping it from them."""
    rest = [list(reversed(fields)) for fields in found]
    found.clear()
    while rest[0]:
        yield [fields.pop() for fields in rest]


def _coarsen(graph: Graph) -> tuple[np.ndarray, Graph] | None:
    """Return aggregates and the next level; None where even blocks of the whole grid would join few
    nodes.
    """
    while True:
        # weakly coupled nodes have to be joined at last, or the level would never get coarse
        found = coarsen_parts([partial(_itself, graph)], len(graph.place))
        if found is not None or not graph.place.any():
            return found
        graph = graph._replace(place=graph.place >> 1)  # no two neighbours in one block: double


def _itself(graph: Graph) -> Graph:
    return graph


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
def _aggregate_blocks(start, middle, other, weight, strongest, place, strong, first):
    """Join the nodes of one 2x2x2 block along strong couplings; number aggregates by their first
    node. The rows are those of the nodes from `first` on.
    """
    parent = np.arange(len(start) - 1)
    for i in range(len(parent)):
        for k in range(start[i], middle[i]):
            j = other[k] - first
            if j < 0:
                continue
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
def _galerkin(
    start, other, weight, diagonal, middle, place, own, count, aggregate, mark, done, used
):
    """Return rows of the matrix between aggregates, as the fields of a Graph without the end of the
    last row: sums of the couplings between them.

    The rows are those of nodes whose aggregates, less `done`, are `own`, `count` of them; before
    them are `used` couplings. `mark` holds where the last coupling to an aggregate is.
    """
    first, member = _list_members(own, count)
    begin, half = np.zeros(count, np.int64), np.empty(count, np.int64)
    to, pull = np.empty(len(other), np.int32), np.empty(len(other), np.float32)
    total, where = np.zeros(count), np.empty((count, 3), np.int16)
    at = used
    for c in range(count):
        begin[c] = at
        for later in range(2):
            for m in range(first[c], first[c + 1]):
                i = member[m]
                if later == 0:
                    total[c] += diagonal[i]
                    for d in range(3):
                        where[c, d] = place[i, d] >> 1
                for k in range(start[i], start[i + 1]):
                    a = aggregate[other[k]]
                    if a == c + done:
                        total[c] -= weight[k] if later else 0.0
                    elif (a > c + done) == (later == 1):
                        if mark[a] < begin[c]:
                            mark[a] = at
                            to[at - used], pull[at - used] = a, 0.0
                            at += 1
                        pull[mark[a] - used] += weight[k]
            if later == 0:
                half[c] = at
    return begin, half, to[: at - used].copy(), pull[: at - used].copy(), total, where
