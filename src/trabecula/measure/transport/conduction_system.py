"""Laplace's equation on segments as a system of conjugate gradients, with multigrid as its
preconditioner.

The solution is float64. The residual, directions and products are of the residual's type; the
multigrid cycle is float32.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.measure.transport import conduction_segments as kernels
from trabecula.measure.transport.conduction_segments import ConductionSegments
from trabecula.measure.transport.finest_level import FinestLevel
from trabecula.measure.transport.graph import Graph
from trabecula.numerics.krylov import Iterate, LinearSystem, Scalar
from trabecula.numerics.multigrid import Multigrid, k_cycle
from trabecula.numerics.vectors import add_to, dot


class ConductionLevel(FinestLevel):
    """The finest level of the multigrid."""

    def __init__(self, part: ConductionSegments) -> None:
        self.matrix = part.matrix

        def rows(number: np.ndarray, a: int, b: int) -> Graph:
            linked = part.table[a:b], part.code[a:b], part.coupling, part.place[a:b], number
            return Graph(*kernels.conduction_graph(*linked))

        super().__init__(part, rows)
        self.x = np.zeros(part.length, np.float32)

    def presmooth(self, right: np.ndarray, x: np.ndarray | None) -> np.ndarray:
        """Return the result of a forward Gauss-Seidel sweep from zero."""
        kernels.sweep_forward(*self.matrix, right, self.x)
        return self.x

    def restrict(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Return the residual of a swept x, summed over aggregates."""
        kernels.restrict(*self.matrix, self.aggregate, x, self.coarse)
        return self.coarse

    def postsmooth(self, right: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Smooth x by a backward Gauss-Seidel sweep."""
        kernels.sweep_backward(*self.matrix, right, x)
        return x


class ConductionSystem(LinearSystem):
    """The matrix of segments and its multigrid."""

    def __init__(self, part: ConductionSegments) -> None:
        self.part = part
        finest = ConductionLevel(part)
        self.multigrid: Multigrid[Any] = Multigrid([finest, *finest.below], k_cycle)
        self.product = np.zeros(0)

    def apply(self, vector: np.ndarray) -> np.ndarray:
        """Return the matrix times a vector, in the same array at every call."""
        if self.product.dtype != vector.dtype or not len(self.product):
            self.product = np.zeros_like(vector)
        kernels.multiply(*self.part.matrix, vector, self.product)
        return self.product

    def precondition(self, residual: np.ndarray) -> np.ndarray:
        """Return an approximate solution by a cycle of multigrid; where it is float32, in the same
        array at every call.
        """
        found = self.multigrid(np.asarray(residual, np.float32))
        return found.astype(residual.dtype, copy=False)

    def dot(self, a: np.ndarray, b: np.ndarray) -> float:
        """Return the scalar product."""
        return float(dot(a, b))

    def turn(self, direction: np.ndarray, factor: Scalar, z: np.ndarray) -> None:
        """Replace the direction by `z + factor * direction`."""
        _turn(direction, factor, z)

    def advance(
        self, at: Iterate, length: Scalar, direction: np.ndarray, product: np.ndarray
    ) -> None:
        """Add `length * direction` to x and take `length * product` from the residual."""
        add_to(at.x, length, direction)
        add_to(at.residual, -length, product)


@kernel
def _turn(direction, factor, z):
    for i in range(len(direction)):
        direction[i] = z[i] + factor * direction[i]
