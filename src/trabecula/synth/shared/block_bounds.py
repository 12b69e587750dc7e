"""Bounds on how many voxels of the second of two phases the blocks of a volume have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.engine.parallel import for_slabs


@dataclass(frozen=True)
class BlockBounds:
    """Fewest and most voxels of the second phase in each block of `sides` voxels, (z, y, x)
    int32.
    """

    least: np.ndarray
    most: np.ndarray
    sides: tuple[int, int, int]

    @property
    def size(self) -> int:
        """Return the voxels of a block."""
        return int(np.prod(self.sides))

    def excess(self, phases: np.ndarray) -> np.ndarray:
        """Return how many voxels every block has too many of both phases, (z, y, x, 2) int64; below
        0 where it may have more.

        Parameters
        ----------
        phases : (Z, Y, X) uint8
            0 and 1, whole blocks.
        """
        (deep, high, wide), (_, rows, columns) = self.sides, self.least.shape
        found = np.empty((*self.least.shape, 2), np.int64)

        def work(start: int, stop: int) -> None:
            layers = phases[start * deep : stop * deep]
            parts = layers.reshape(stop - start, deep, rows, high, columns, wide)
            second = parts.sum(axis=(1, 3, 5), dtype=np.int64)
            found[start:stop, ..., 0] = self.least[start:stop] - second
            found[start:stop, ..., 1] = second - self.most[start:stop]

        for_slabs(work, len(self.least), least=1)
        return found
