"""Soft indicators: 0 to 1 over a few voxels around an interface, made plane by plane of fields in
int8.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trabecula.engine.parallel import sum_slabs


def soft_indicator(field: np.ndarray, softness: float) -> np.ndarray:
    """0 .. 1 in float32 of a field in int8."""
    return _table(softness)[field.astype(np.int16) & 255]


@dataclass(frozen=True)
class Soft:
    """The soft indicator of a field (Z, Y, X) int8, 0 where it is not free; nowhere as a whole.

    `table` (256,) float32 is its value by the byte of the field; `free` (Z, Y, X) bool, None for
    everywhere.
    """

    field: np.ndarray
    table: np.ndarray
    free: np.ndarray | None = None

    @classmethod
    def of(cls, field: np.ndarray, softness: float, free: np.ndarray | None = None) -> Soft:
        """Of a field with the width of the soft step in its int8 steps."""
        return cls(field, _table(softness), free)

    def plane(self, z: int) -> np.ndarray:
        """Plane z (Y, X) float32."""
        return self._looked_up(self.table, z)

    def interface(self, z: int) -> np.ndarray:
        """Where plane z (Y, X) is neither 0 nor 1, bool."""
        return self._looked_up((self.table > 0) & (self.table < 1), z)

    def centred(self, mean: np.float32, z: int) -> np.ndarray:
        """Plane z less the mean, where it is free."""
        soft = self.plane(z)
        return np.subtract(soft, mean, out=soft, where=True if self.free is None else self.free[z])

    def mean_and_moving(self) -> tuple[np.float32, int]:
        """The mean over what is free, and the voxels of the interface."""
        counts = sum_slabs(self._counts, len(self.field))
        total = math.fsum((counts * self.table.astype(np.float64)).tolist())
        moving = counts[(self.table > 0) & (self.table < 1)].sum()
        return np.float32(total / max(1, int(counts.sum()))), int(moving)

    def _looked_up(self, table: np.ndarray, z: int) -> np.ndarray:
        found = table[self.field[z].view(np.uint8)]
        return found if self.free is None else found * self.free[z]

    def _counts(self, start: int, stop: int) -> np.ndarray:
        """How often each byte occurs in free voxels of these planes, (256,) int64."""
        counts = np.zeros(256, np.int64)
        for z in range(start, stop):
            plane = self.field[z].view(np.uint8)
            counts += np.bincount(
                (plane if self.free is None else plane[self.free[z]]).ravel(), minlength=256
            )
        return counts


def _table(softness: float) -> np.ndarray:
    """The soft indicator (256,) float32 of every byte of a field."""
    steps = np.arange(256, dtype=np.uint8).view(np.int8).astype(np.float64)
    return np.clip(steps / softness + 0.5, 0, 1).astype(np.float32)
