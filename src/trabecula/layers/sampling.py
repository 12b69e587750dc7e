"""Layers of a volume on the pixels of a printer: the share of each pixel that each phase takes.

A share is the mean over a box around the pixel's centre, as wide as the pixel or as the voxel,
whichever is wider along that axis. Of pixels wider than voxels that is the share itself; of
narrower ones it is linear interpolation, which rounds off the corners of voxels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.lazy_volume import Slabs
from trabecula.engine.rows import add_scaled_row

_MOST = 1 << 27  # bytes of planes that are kept between layers


@dataclass(frozen=True, eq=False)
class AxisWeights:
    """Weights of the voxels of an axis in the means around evenly spaced places on it.

    Attributes
    ----------
    first : (N,) int64
        First voxel of each mean; voxels outside of the axis count as nothing.
    weights : (N, taps) float32
    """

    first: np.ndarray
    weights: np.ndarray

    @classmethod
    def over(cls, centres: np.ndarray, width: float, edge: float) -> AxisWeights:
        """Weigh voxels of length `edge` in boxes of `width` around `centres`, in the same unit."""
        low, high = (centres - width / 2) / edge, (centres + width / 2) / edge
        first = np.floor(low + 1e-9).astype(np.int64)
        taps = int((np.ceil(high - 1e-9).astype(np.int64) - first).max())
        voxels = first[:, None] + np.arange(taps)
        shares = np.minimum(high[:, None], voxels + 1) - np.maximum(low[:, None], voxels)
        return cls(first, (np.maximum(shares, 0) * edge / width).astype(np.float32))


@dataclass(eq=False)
class LayerSampler:
    """Layers of a volume.

    Parameters
    ----------
    volume : Slabs
    edges : (z, y, x)
        Sides of a voxel in millimetres.
    pitch : (z, y, x)
        Layer thickness, row and column pitch in millimetres.
    """

    volume: Slabs
    edges: tuple[float, float, float]
    pitch: tuple[float, float, float]

    def __post_init__(self) -> None:
        self._kept: tuple[int, np.ndarray] | None = None

    @property
    def size(self) -> tuple[float, float, float]:
        """Return the sides of the part in millimetres."""
        z, y, x = (side * edge for side, edge in zip(self.volume.shape, self.edges, strict=True))
        return z, y, x

    @property
    def shape(self) -> tuple[int, int, int]:
        """Return the number of layers, rows and columns; the last ones may be begun only."""
        layers, rows, columns = (
            max(1, int(np.ceil(side / step - 1e-6)))
            for side, step in zip(self.size, self.pitch, strict=True)
        )
        return layers, rows, columns

    def shares(self, layer: int, phases: Sequence[int], *, fine: int = 1) -> np.ndarray:
        """Return the share of each pixel of a layer that each phase takes, `fine` pixels in place
        of each along both axes of the layer.

        Returns
        -------
        (P, Y, X) float32
        """
        along_z = self._weights(0, 1, np.array([layer]))
        low = int(along_z.first[0])
        stop = min(low + along_z.weights.shape[1], self.volume.shape[0])
        flat = np.zeros((len(phases), *self.volume.shape[1:]), np.float32)
        for z in range(max(low, 0), stop):
            weight = along_z.weights[0, z - low]
            if weight > 0:
                _add_phases(self._plane(z), np.asarray(phases, np.int64), weight, flat)
        return average_plane(flat, self._in_plane(1, fine), self._in_plane(2, fine))

    def _in_plane(self, axis: int, fine: int) -> AxisWeights:
        if fine == 1:
            return self._rows if axis == 1 else self._columns
        return self._weights(axis, fine, np.arange(self.shape[axis] * fine))

    @cached_property
    def _rows(self) -> AxisWeights:
        return self._weights(1, 1, np.arange(self.shape[1]))

    @cached_property
    def _columns(self) -> AxisWeights:
        return self._weights(2, 1, np.arange(self.shape[2]))

    def _weights(self, axis: int, fine: int, numbers: np.ndarray) -> AxisWeights:
        step, edge = self.pitch[axis] / fine, self.edges[axis]
        return AxisWeights.over((numbers + 0.5) * step, max(step, edge), edge)

    def _plane(self, z: int) -> np.ndarray:
        """Return plane z of the labels, and keep those that are read together with it."""
        if self._kept is None or not self._kept[0] <= z < self._kept[0] + len(self._kept[1]):
            _, height, width = self.volume.shape
            together = max(1, min(self.volume.grain, _MOST // max(1, height * width)))
            first = z // together * together
            last = min(first + together, self.volume.shape[0])
            self._kept = first, self.volume.planes(first, last).values
        return self._kept[1][z - self._kept[0]]


def average_plane(values: np.ndarray, rows: AxisWeights, columns: AxisWeights) -> np.ndarray:
    """Average (P, y, x) float32 around rows and columns: (P, Y, X) float32."""
    between = np.empty((len(values), len(rows.first), values.shape[2]), np.float32)
    _average_rows(values, rows.first, rows.weights, between)
    result = np.empty((len(values), len(rows.first), len(columns.first)), np.float32)
    _average_columns(between, columns.first, columns.weights, result)
    return result


@kernel
def _add_phases(labels, phases, weight, shares):
    """Add `weight` to the share of the phase of every voxel."""
    for y in range(labels.shape[0]):
        for x in range(labels.shape[1]):
            for p in range(len(phases)):
                if labels[y, x] == phases[p]:
                    shares[p, y, x] += weight


@kernel
def _average_rows(values, first, weights, result):
    """Average along y; what lies outside counts as 0."""
    for p in range(values.shape[0]):
        for y in range(len(first)):
            result[p, y, :] = 0
            for tap in range(weights.shape[1]):
                at = first[y] + tap
                if 0 <= at < values.shape[1] and weights[y, tap] > 0:
                    add_scaled_row(result[p, y], weights[y, tap], values[p, at])


@kernel
def _average_columns(values, first, weights, result):
    """Average along x; what lies outside counts as 0."""
    for p in range(values.shape[0]):
        for y in range(values.shape[1]):
            for x in range(len(first)):
                total = np.float32(0)
                for tap in range(weights.shape[1]):
                    at = first[x] + tap
                    if 0 <= at < values.shape[2]:
                        total += weights[x, tap] * values[p, y, at]
                result[p, y, x] = total
