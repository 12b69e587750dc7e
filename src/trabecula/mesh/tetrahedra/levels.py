"""Which phase a point is of: labels smoothed, and compared with each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.smooth import gaussian

_NEAR = 0.3  # of a level: what counts as near to an interface


def smooth_levels(values: np.ndarray, labels: Sequence[int], sigma: float) -> np.ndarray:
    """Return a level for every label, (labels, Z, Y, X) float32: where it is the highest, there is
    its phase.
    """
    return np.stack([gaussian(values == label, sigma) for label in labels])


def interface_voxels(levels: np.ndarray) -> np.ndarray:
    """Return by how many voxels each phase grows for a unit that its level rises and the others
    sink, (labels,): about, of the voxels that are near to an interface.
    """
    found = []
    for number in range(len(levels)):
        apart = levels[number] - np.delete(levels, number, axis=0).max(axis=0)
        found.append(max(np.count_nonzero(np.abs(apart) < _NEAR) / _NEAR, 1.0))
    return np.array(found)


def level_at(levels: np.ndarray, number: int, points: np.ndarray) -> np.ndarray:
    """Return by how much a level is above those after it, (N,) float64, at points (N, 3) in voxels
    (z, y, x; the first voxel reaches from 0 to 1).
    """
    found = np.empty(len(points))
    places = np.ascontiguousarray(points, np.float64)

    def work(start: int, stop: int) -> None:
        _sample(levels, number, places, found, start, stop)

    for_slabs(work, len(places), least=10_000)
    return found


@kernel
def _sample(levels, number, points, found, start, stop):
    """Interpolate linearly between the centres of voxels."""
    shape = levels.shape[1:]
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    part = np.empty(3)
    for n in range(start, stop):
        for axis in range(3):
            at = min(max(points[n, axis] - 0.5, 0.0), shape[axis] - 1.0)
            low[axis] = int(at)
            high[axis] = min(low[axis] + 1, shape[axis] - 1)
            part[axis] = at - low[axis]
        own, most = 0.0, -np.inf
        for k in range(number, len(levels)):
            level = 0.0
            for corner in range(8):
                z = high[0] if corner & 4 else low[0]
                y = high[1] if corner & 2 else low[1]
                x = high[2] if corner & 1 else low[2]
                weight = (part[0] if corner & 4 else 1 - part[0]) * (
                    part[1] if corner & 2 else 1 - part[1]
                )
                weight *= part[2] if corner & 1 else 1 - part[2]
                level += weight * levels[k, z, y, x]
            if k == number:
                own = level
            else:
                most = max(most, level)
        found[n] = own - most
