"""`Graph`: a symmetric M-matrix as couplings between neighbours."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Graph(NamedTuple):
    """The matrix `diagonal[i] x[i] - sum of weight[k] x[other[k]]`, k from start[i] to start[i +
    1].

    `diagonal` is at least the sum of a row's weights. Neighbours before i come first, up to
    middle[i]. `place` is where a node lies on the grid of voxels.
    """

    start: np.ndarray  # int64, (N + 1,)
    middle: np.ndarray  # int64, (N,)
    other: np.ndarray  # int32, (K,)
    weight: np.ndarray  # float32, (K,)
    diagonal: np.ndarray  # float64, (N,)
    place: np.ndarray  # int16, (N, 3)

    @property
    def rows(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """What a product needs."""
        return self.start, self.other, self.weight, self.diagonal
