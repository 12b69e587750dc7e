"""`Graph`: a symmetric M-matrix as couplings between neighbours."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.numerics.vectors import for_chunks


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

    def trim(self) -> Graph:
        """Return what products and sweeps in float32 need, in fewer bytes: no places."""
        index = np.int32 if len(self.other) < 2**31 else np.int64
        return Graph(
            self.start.astype(index),
            self.middle.astype(index),
            self.other,
            self.weight,
            self.diagonal.astype(np.float32),
            self.place[:0].copy(),
        )

    def apply(self, x: np.ndarray) -> np.ndarray:
        """Return the matrix times x, in the precision of x."""
        y = np.empty_like(x)
        for_chunks(lambda a, b: multiply(*self.rows, x, y, a, b), len(x))
        return y


@kernel
def multiply(start, other, weight, diagonal, x, y, first, stop):
    """Set the rows first..stop of the matrix of a graph times x, summed in the precision of x."""
    for i in range(first, stop):
        total = x.dtype.type(diagonal[i]) * x[i]
        for k in range(start[i], start[i + 1]):
            total -= weight[k] * x[other[k]]
        y[i] = total
