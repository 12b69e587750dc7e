"""Coordinates: from voxels of a slice to those that a system is written in, and its velocities
back.

Points are lengths from the corner of the request, in the slices' order of axes (along, tall, wide).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from trabecula.synth.bubbles.flow.step import Vectors
from trabecula.synth.bubbles.flow.systems import System

Centre = tuple[np.ndarray | float, np.ndarray | float]


class Frames:
    """The coordinates of one request.

    Parameters
    ----------
    shape, spacing : along z, y, x
    order : of the axes, along, tall and wide
    extent : float
        Coordinate at half the longest side; 0 for lengths.
    """

    def __init__(
        self, shape: Sequence[int], spacing: Sequence[float], order: Sequence[int], extent: float
    ) -> None:
        self.shape, self.spacing, self.order = tuple(shape), tuple(spacing), tuple(order)
        self.sides = tuple(count * edge for count, edge in zip(shape, spacing, strict=True))
        self.middle = tuple(side / 2 for side in self.sides)
        longest = max(self.sides)
        in_slice = max(self.sides[axis] for axis in order[1:])
        self._volume_scale = extent / (longest / 2) if extent else 1.0
        self._slice_scale = extent / (in_slice / 2) if extent else 1.0

    def points(self, place: int, tall: np.ndarray, wide: np.ndarray) -> Vectors:
        """Centres of voxels of a slice, as three arrays that broadcast to (1, rows, columns)."""
        edges = [self.spacing[axis] for axis in self.order]
        nodes = (np.array([place])[:, None, None], tall[None, :, None], wide[None, None, :])
        return tuple((node + 0.5) * edge for node, edge in zip(nodes, edges, strict=True))

    def of_volume(self, point: Vectors) -> Vectors:
        """z, y, x from the middle of the request."""
        return tuple(
            (part - middle) * self._volume_scale
            for part, middle in zip(self._by_axis(point), self.middle, strict=True)
        )

    def nearest(
        self, values: np.ndarray, place: int, tall: np.ndarray, wide: np.ndarray
    ) -> np.ndarray:
        """Values of an array that spans the request, (1, rows, columns); 0 beyond it."""
        index: list[np.ndarray] = []
        inside: np.ndarray = np.ones((1, 1, 1), bool)
        for part, side, count in zip(
            self._by_axis(self.points(place, tall, wide)), self.sides, values.shape, strict=True
        ):
            index.append(np.clip(np.floor(part / side * count), 0, count - 1).astype(np.int64))
            inside = inside & (part >= 0) & (part < side)
        return np.where(inside, values[tuple(index)], 0)

    def velocity(self, system: System, centre: Centre) -> Callable[[Vectors], Vectors]:
        """A system as a function of points, its velocities in the slices' order."""
        return {"slice": self._in_slice, "volume": self._in_volume, "array": self._in_array}[
            system.frame
        ](system, centre)

    def _in_slice(self, system: System, centre: Centre) -> Callable[[Vectors], Vectors]:
        origin = (self.middle[self.order[0]], *centre)

        def velocity(point: Vectors) -> Vectors:
            z, y, x = (
                (part - zero) * self._slice_scale for part, zero in zip(point, origin, strict=True)
            )
            found = system.velocity(z, y, x)
            return (found[2] if len(found) == 3 else np.zeros(1), found[1], found[0])

        return velocity

    def _in_volume(self, system: System, centre: Centre) -> Callable[[Vectors], Vectors]:
        def velocity(point: Vectors) -> Vectors:
            x1, y1, z1 = system.velocity(*self.of_volume(point))
            return self._in_order((z1, y1, x1))

        return velocity

    def _in_array(self, system: System, centre: Centre) -> Callable[[Vectors], Vectors]:
        def velocity(point: Vectors) -> Vectors:
            shares = (
                part / side for part, side in zip(self._by_axis(point), self.sides, strict=True)
            )
            x1, y1, z1 = system.velocity(*shares)
            return self._in_order((z1, y1, x1))

        return velocity

    def _by_axis(self, point: Vectors) -> Vectors:
        """What is told in the slices' order, by z, y, x."""
        return tuple(point[self.order.index(axis)] for axis in range(3))

    def _in_order(self, vectors: Vectors) -> Vectors:
        """What is told by z, y, x, in the slices' order."""
        return tuple(vectors[axis] for axis in self.order)
