"""`Graph`: a symmetric M-matrix as couplings between neighbours, and its conjugate gradients."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.numerics.krylov import Iterate, LinearSystem, conjugate_gradients
from trabecula.numerics.vectors import dot


class Graph(NamedTuple):
    """The matrix `diagonal[i] x[i] - sum of weight[k] x[other[k]]`, k from start[i] to start[i +
    1].

    `diagonal` is at least the sum of a row's weights. Neighbours before i come first, up to
    middle[i]. `place` is the position of a node on the grid of voxels.
    """

    start: np.ndarray  # int64, (N + 1,)
    middle: np.ndarray  # int64, (N,)
    other: np.ndarray  # int32, (K,)
    weight: np.ndarray  # float32, (K,)
    diagonal: np.ndarray  # float64, (N,)
    place: np.ndarray  # int16, (N, 3)

    @property
    def rows(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the arrays that a product needs."""
        return self.start, self.other, self.weight, self.diagonal

    def apply(self, x: np.ndarray) -> np.ndarray:
        """Return the matrix times x, in the precision of x."""
        return multiply(*self.rows, x)


class GraphSystem(LinearSystem):
    """A graph and its preconditioner as a system of `conjugate_gradients`."""

    def __init__(self, graph: Graph, multigrid: Callable[[np.ndarray], np.ndarray]) -> None:
        self.graph, self.multigrid = graph, multigrid

    def apply(self, vector: np.ndarray) -> np.ndarray:
        """Return the matrix times a vector."""
        return self.graph.apply(vector)

    def precondition(self, residual: np.ndarray) -> np.ndarray:
        """Return an approximate solution by a cycle of multigrid."""
        return self.multigrid(residual)

    def dot(self, a: np.ndarray, b: np.ndarray) -> float:
        """Return the scalar product."""
        return float(dot(a, b))


def solve_graph(
    graph: Graph,
    right: np.ndarray,
    precondition: Callable[[np.ndarray], np.ndarray],
    *,
    accept: Callable[[Iterate], bool],
    most: int,
) -> tuple[Iterate, bool]:
    """Solve `graph x = right` from zero by flexible conjugate gradients; see `numerics.krylov`."""
    x = np.zeros(len(right))
    residual = right - graph.apply(x)
    system = GraphSystem(graph, precondition)
    return conjugate_gradients(system, x, residual, accept=accept, most=most, flexible=True)


@kernel
def multiply(start, other, weight, diagonal, x):
    """Return the matrix of a graph times x, summed in the precision of x."""
    y = np.empty_like(x)
    for i in range(len(x)):
        total = x.dtype.type(diagonal[i]) * x[i]
        for k in range(start[i], start[i + 1]):
            total -= weight[k] * x[other[k]]
        y[i] = total
    return y
