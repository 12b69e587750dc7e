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
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_each, one_blas_thread
from trabecula.measure.transport.graph import Graph
from trabecula.measure.transport.sweep_parts import SweptNodes, cut_planes
from trabecula.measure.union_find import join, number_trees
from trabecula.numerics.vectors import for_chunks

DIRECT = 256  # unknowns of the coarsest level, which is solved by its inverse
_SLOWEST = 0.8  # of a level's nodes: one that keeps more of them is not worth its work
_STRONG = 0.1  # couplings below this share of the strongest of either node do not aggregate
_RUN = 32
"""Parts whose couplings are held in one array."""
PART_NODES = 1 << 18
"""Of a part that is swept by itself, at least."""
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
    parts: Sequence[SweptNodes] = ()
    """Of its nodes, swept at once; none on the last level."""

    def apply(self, x: np.ndarray) -> np.ndarray:
        """Return the matrix times x."""
        return self.graph.apply(x)

    def presmooth(self, right: np.ndarray, x: np.ndarray | None) -> np.ndarray:
        """Return the result of a forward Gauss-Seidel sweep from zero (the K-cycle has no other
        start)."""
        given = self.graph, self.inverse, right, np.empty(len(right), np.float32)
        for_each(lambda part: _forward(*given, part), self.parts)
        return given[-1]

    def restrict(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the residual of a swept x, summed over aggregates."""
        given = self.graph, self.aggregate, x, np.zeros(self.count, np.float32)
        for_each(lambda part: _restrict(*given, part), self.parts)
        return given[-1]

    def prolong(self, correction: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Add the correction of its aggregate to every node."""
        for_chunks(lambda a, b: _prolong(self.aggregate, correction, x, a, b), len(x))
        return x

    def postsmooth(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Smooth x by a backward Gauss-Seidel sweep."""
        old = x.copy() if len(self.parts) > 1 else x
        given = self.graph, self.inverse, right, x, old
        for_each(lambda part: _backward(*given, part), self.parts)
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
        parts = _cut_nodes(graph.place[:, 0], aggregate)
        levels.append(
            GraphLevel(graph.trim(), inverse, aggregate, len(below.diagonal), None, parts)
        )
        graph = below


def _cut_nodes(plane: np.ndarray, aggregate: np.ndarray) -> list[SweptNodes]:
    """Return parts of the nodes of planes in rising order; no aggregate is cut."""
    begins = np.searchsorted(plane, np.arange(int(plane[-1]) + 2))
    begins = begins[np.append(np.diff(begins) > 0, True)]
    highest = np.maximum.accumulate(np.maximum.reduceat(aggregate, begins[:-1]))
    lowest = np.minimum.reduceat(aggregate, begins[:-1])[::-1]
    lowest = np.minimum.accumulate(lowest)[::-1]
    allowed = np.append(False, highest[:-1] < lowest[1:])
    return cut_planes(begins, np.diff(begins), allowed, PART_NODES)


class RowsPart(NamedTuple):
    """A part of a matrix: what returns its rows, of so many nodes and couplings at most."""

    rows: Callable[[], Graph]
    nodes: int
    couplings: int


def coarsen_parts(parts: Sequence[RowsPart]) -> tuple[np.ndarray, Graph] | None:
    """Return aggregates of blocks and the next level of a matrix that is never held as a whole: no
    block is in two parts, whose rows are asked for once or twice.

    None where blocks join few nodes.
    """
    bounds = list(pairwise([0, *np.cumsum([part.nodes for part in parts]).tolist()]))
    for strong in (_STRONG, 0.0):
        aggregate, groups = _join_parts(parts, bounds, strong)
        if groups[-1][1] <= _SLOWEST * len(aggregate):
            return aggregate, _sum_parts(parts, aggregate, bounds, groups)
    return None


def _join_parts(
    parts: Sequence[RowsPart], bounds: Sequence[tuple[int, int]], strong: float
) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Return the aggregate of every node, and the first one of each part and of the next."""
    aggregate, counts = np.empty(bounds[-1][1], np.int32), np.zeros(len(parts), np.int64)

    def join_part(n: int) -> None:
        part, (first, last) = parts[n].rows(), bounds[n]
        linked = part.start, part.middle, part.other, part.weight
        strongest = _strongest_couplings(part.start, part.weight)
        found = _aggregate_blocks(*linked, strongest, part.place, strong, first)
        aggregate[first:last], counts[n] = found

    for_each(join_part, range(len(parts)))
    groups = list(pairwise([0, *np.cumsum(counts).tolist()]))
    for (first, last), (before, _) in zip(bounds, groups, strict=True):
        aggregate[first:last] += np.int32(before)
    return aggregate, groups


def _sum_parts(
    parts: Sequence[RowsPart],
    aggregate: np.ndarray,
    bounds: Sequence[tuple[int, int]],
    groups: Sequence[tuple[int, int]],
) -> Graph:
    """Return the matrix between aggregates, part after part: of the nodes within `bounds`, whose
    aggregates are those within `groups`.

    Couplings of several parts are held in one array, of which the rest is never touched: many small
    ones would leave gaps in memory.
    """
    count = groups[-1][1]
    begin, half = np.zeros((2, count), np.int64)
    total, where = np.zeros(count), np.empty((count, 3), np.int16)
    runs = list(pairwise([*range(0, len(parts), _RUN), len(parts)]))
    found: list[tuple[np.ndarray, ...]] = [()] * len(runs)

    def sum_part(n: int, mark: np.ndarray, used: int, to: np.ndarray, pull: np.ndarray) -> int:
        """Return where its couplings end; its rows are held no longer than this call."""
        part, (first, last), (done, end) = parts[n].rows(), bounds[n], groups[n]
        out = begin[done:end], half[done:end], to, pull, total[done:end], where[done:end]
        own = aggregate[first:last] - np.int32(done)
        return int(_galerkin(part, own, aggregate, mark, done, used, Graph(*out)))

    def sum_run(number: int) -> None:
        start, stop = runs[number]
        room = sum(part.couplings for part in parts[start:stop])
        to, pull = np.empty(room, np.int32), np.empty(room, np.float32)
        mark, used = np.full(count, -1, np.int64), 0
        for n in range(start, stop):
            used = sum_part(n, mark, used, to, pull)
        found[number] = to[:used], pull[:used]

    for_each(sum_run, range(len(runs)))
    used = 0
    for (start, stop), columns in zip(runs, found, strict=True):
        inside = slice(groups[start][0], groups[stop - 1][1])
        begin[inside] += used
        half[inside] += used
        used += len(columns[0])
    to, pull = (np.concatenate(field) for field in _columns(found))
    return Graph(np.append(begin, used), half, to, pull, total, where)


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
        part = RowsPart(partial(_itself, graph), len(graph.place), len(graph.other))
        # weakly coupled nodes have to be joined at last, or the level would never get coarse
        found = coarsen_parts([part])
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
def _forward(graph, inverse, right, x, part):
    """Sweep the nodes of a part once by Gauss-Seidel from zero: only neighbours before a node have
    a value yet, and none of another part, as those before `edge` have.
    """
    start, middle, other, weight = graph.start, graph.middle, graph.other, graph.weight
    first, edge, _, stop = part
    for i in range(first, edge):
        total = right[i]
        for k in range(start[i], middle[i]):
            if other[k] >= first:
                total += weight[k] * x[other[k]]
        x[i] = total * inverse[i]
    for i in range(edge, stop):
        total = right[i]
        for k in range(start[i], middle[i]):
            total += weight[k] * x[other[k]]
        x[i] = total * inverse[i]


@kernel
def _restrict(graph, aggregate, x, coarse, part):
    """Add the residual to aggregates: after a forward sweep, the sum over the later neighbours, and
    over those of the part before.
    """
    start, middle, other, weight = graph.start, graph.middle, graph.other, graph.weight
    first, edge, _, stop = part
    for i in range(first, stop):
        total = np.float32(0.0)
        for k in range(middle[i], start[i + 1]):
            total += weight[k] * x[other[k]]
        if i < edge:
            for k in range(start[i], middle[i]):
                if other[k] < first:
                    total += weight[k] * x[other[k]]
        coarse[aggregate[i]] += total


@kernel
def _prolong(aggregate, coarse, x, start, stop):
    for i in range(start, stop):
        x[i] += coarse[aggregate[i]]


@kernel
def _backward(graph, inverse, right, x, old, part):
    """Sweep the nodes of a part once by Gauss-Seidel, the last one first; neighbours of other
    parts, which those before `edge` and from `back` on have, are `old`.
    """
    start, other, weight = graph.start, graph.other, graph.weight
    first, edge, back, stop = part
    for i in range(stop - 1, first - 1, -1):
        total = right[i]
        if edge <= i < back:
            for k in range(start[i], start[i + 1]):
                total += weight[k] * x[other[k]]
        else:
            for k in range(start[i], start[i + 1]):
                j = other[k]
                total += weight[k] * (x[j] if first <= j < stop else old[j])
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
def _galerkin(part, own, aggregate, mark, done, used, out):
    """Set rows of the matrix between aggregates, in the fields of a Graph: sums of the couplings
    between them. Return where their couplings end.

    The rows are those of the nodes of a `part`, a Graph, whose aggregates, less `done`, are `own`;
    before them are `used` couplings. `mark` holds where the last coupling to an aggregate is.
    """
    start, _, other, weight, diagonal, place = part
    begin, half, to, pull, total, where = out
    first, member = _list_members(own, len(begin))
    at = used
    for c in range(len(begin)):
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
                            to[at], pull[at] = a, 0.0
                            at += 1
                        pull[mark[a]] += weight[k]
            if later == 0:
                half[c] = at
    return at
