"""The planes that a site is seen in: along the axes, or turned by 45 degrees about one of them.

A volume that is only ever looked at along its axes comes out with boxes and rods along them. Where
a material is alike in all directions any plane will do; so sweeps take in turn three planes along
the axes, and three that are turned. Along a diagonal voxels lie sqrt(2) apart: its k-th neighbour
stands for the picture's pixel at rint(k sqrt(2)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Step = tuple[int, int, int]


@dataclass(frozen=True)
class Plane:
    """A plane by what one step along a picture's rows' axis, and one along its columns' axis, is in
    voxels (z, y, x).
    """

    rows: Step
    columns: Step

    @property
    def stretched(self) -> tuple[bool, bool]:
        """Whether the steps are diagonals."""
        return sum(map(abs, self.rows)) > 1, sum(map(abs, self.columns)) > 1

    @property
    def mirrored(self) -> Plane:
        """The same plane, its picture seen from behind."""
        z, y, x = self.columns
        return Plane(self.rows, (-z, -y, -x))

    def offsets(self, width: int) -> np.ndarray:
        """Where the neighbours lie, (w^2 - 1, 3) int64, in the order of a picture's pixels."""
        steps = np.arange(width) - width // 2
        grid = steps[:, None, None] * np.array(self.rows) + steps[None, :, None] * np.array(
            self.columns
        )
        return np.delete(grid.reshape(-1, 3), width**2 // 2, axis=0)


def across(axis: int) -> Plane:
    """The plane along two axes that is seen across the third."""
    rows, columns = (other for other in range(3) if other != axis)
    return Plane(_unit(rows), _unit(columns))


def turned(axis: int) -> tuple[Plane, Plane, Plane]:
    """Three orthogonal planes, turned by 45 degrees about an axis."""
    first, second = (other for other in range(3) if other != axis)
    up, down = np.add(_unit(first), _unit(second)), np.subtract(_unit(first), _unit(second))
    rising, falling, along = tuple(up.tolist()), tuple(down.tolist()), _unit(axis)
    return Plane(rising, falling), Plane(along, rising), Plane(along, falling)


def pixels_along(width: int, stretched: bool) -> np.ndarray:
    """Where the neighbours lie along an axis of the picture, pixels from the centre."""
    steps = np.arange(width) - width // 2
    return np.rint(steps * np.sqrt(2)).astype(np.int64) if stretched else steps


def union_of(planes: Sequence[Plane], width: int) -> np.ndarray:
    """All neighbours in three dimensions, each once (equation 11)."""
    return np.unique(np.concatenate([plane.offsets(width) for plane in planes]), axis=0)


def _unit(axis: int) -> Step:
    steps = [0, 0, 0]
    steps[axis] = 1
    return steps[0], steps[1], steps[2]
