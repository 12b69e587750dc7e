"""Aggregation multigrid for M-matrices on graphs: the preconditioner of every solve in this room.

Notay 2010, "An aggregation-based algebraic multigrid method" (Electronic Transactions on Numerical
Analysis 37, 123-146), with geometric aggregates: the nodes of a 2x2x2 block that hang together
inside it become one node of the next level. Pores on both sides of a wall so stay apart on every
level, however thin the wall, and blocks without walls give the coarse grid of plain geometric
multigrid. The coarse matrix is the Galerkin product with piecewise constants; the scale error of
these is repaired by two steps of conjugate gradients on every level (the K-cycle).

The matrix of a level is `diagonal[i] x[i] - sum of weight[k] x[other[k]]`, k in start[i] .. start[i
+ 1], where the neighbours before i come first, up to middle[i]. Vectors inside the cycle are
float32.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trabecula.engine.parallel import one_blas_thread
from trabecula.measure.transport.graph import Graph
from trabecula.measure.transport.multigrid_kernels import (
    aggregate_blocks,
    apply,
    backward,
    forward,
    galerkin,
    multiply,
    prolong,
    restrict,
    strongest_couplings,
    sweeps,
)
from trabecula.measure.transport.vectors import combine, dot, subtract

_DIRECT = 256  # unknowns of the coarsest level, which is solved by its inverse
_SLOWEST = 0.8  # of a level's nodes: one that keeps more of them is not worth its work
_ENOUGH = 0.25  # residual after one coarse step below which the second is left out
_STRONG = 0.1  # couplings below this share of the strongest of either node do not aggregate


class Level(NamedTuple):
    """One level: its matrix, the inverse of its diagonal, and the node of the next level that each
    node belongs to.
    """

    graph: Graph
    inverse: np.ndarray
    aggregate: np.ndarray


@dataclass(frozen=True)
class Multigrid:
    """A hierarchy of levels, finest first, and what solves the last one (None: sweeps alone)."""

    levels: tuple[Level, ...]
    last: np.ndarray | None

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        """An approximate solution of `matrix @ x = residual`, float32."""
        return self._cycle(0, np.asarray(residual, np.float32))

    def _cycle(self, depth: int, right: np.ndarray) -> np.ndarray:
        level = self.levels[depth]
        graph = level.graph
        if depth + 1 == len(self.levels):
            if self.last is not None:
                return apply(self.last, right)
            return sweeps(*graph.rows, level.inverse, right, 20)
        x = forward(graph.start, graph.middle, graph.other, graph.weight, level.inverse, right)
        below = len(self.levels[depth + 1].inverse)
        coarse = restrict(
            graph.start, graph.middle, graph.other, graph.weight, level.aggregate, x, below
        )
        correction = self._coarse(depth + 1, coarse)
        prolong(level.aggregate, correction, x)
        backward(graph.start, graph.other, graph.weight, level.inverse, right, x)
        return x

    def _coarse(self, depth: int, right: np.ndarray) -> np.ndarray:
        """Two steps of flexible conjugate gradients, each preconditioned by the cycle of this
        level.
        """
        if depth + 1 == len(self.levels):
            return self._cycle(depth, right)
        rows = self.levels[depth].graph.rows
        first = self._cycle(depth, right)
        image = multiply(*rows, first)
        energy, along = dot(first, image), dot(first, right)
        if energy <= 0.0:
            return first
        step = along / energy
        rest = subtract(right, step, image)
        if dot(rest, rest) <= _ENOUGH**2 * dot(right, right):
            return combine(step, first, 0.0, first)
        second = self._cycle(depth, rest)
        cross, own, gain = (
            dot(second, image),
            dot(second, multiply(*rows, second)),
            dot(second, rest),
        )
        remaining = own - cross * cross / energy
        if remaining <= 0.0:
            return combine(step, first, 0.0, first)
        return combine(step - cross * gain / (energy * remaining), first, gain / remaining, second)


def multigrid(graph: Graph) -> Multigrid:
    """The hierarchy below a matrix."""
    levels = []
    while True:
        inverse = (1.0 / graph.diagonal).astype(np.float32)
        found = None if len(inverse) <= _DIRECT else _coarser(graph)
        if found is None:
            levels.append(Level(graph, inverse, np.zeros(0, np.int32)))
            return Multigrid(tuple(levels), _inverse(graph) if len(inverse) <= _DIRECT else None)
        levels.append(Level(graph, inverse, found[0]))
        graph = found[1]


def _coarser(graph: Graph) -> tuple[np.ndarray, Graph] | None:
    """Aggregates and the next level; None where even blocks of the whole grid would join few nodes."""
    place = graph.place
    strongest = strongest_couplings(graph.start, graph.weight)
    while True:
        # what hangs on weakly has to be joined at last, or it would never get coarse
        for strong in (_STRONG, 0.0):
            aggregate, count = aggregate_blocks(
                graph.start, graph.middle, graph.other, graph.weight, strongest, place, strong
            )
            if count <= _SLOWEST * len(place):
                return aggregate, Graph(
                    *galerkin(*graph.rows, graph.middle, place, aggregate, count)
                )
        if not place.any():
            return None
        place = place >> 1  # neighbours lie in other blocks: double the blocks


def _inverse(graph: Graph) -> np.ndarray:
    matrix = np.diag(graph.diagonal)
    row = np.repeat(np.arange(len(graph.diagonal)), np.diff(graph.start))
    matrix[row, graph.other] = -graph.weight
    with one_blas_thread():  # the bits of a threaded inverse depend on the number of threads
        return np.linalg.inv(matrix).astype(np.float32)
