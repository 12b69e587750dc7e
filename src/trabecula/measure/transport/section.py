"""The part of an image that is solved: a centred box, the axis of transport first, and the voxels
that percolate along it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.parallel import for_slabs, thread_count
from trabecula.measure.centre_crop import box_sides, centre, centre_box, check_memory
from trabecula.measure.labelling import label_components
from trabecula.measure.percolation import spanning_voxels
from trabecula.measure.phases import as_axis
from trabecula.measure.transport.finest_level import PART
from trabecula.measure.transport.result import Effective

HALVED = 48
"""Largest edge, in voxels, of the centre box whose voxels are split."""

_LONGEST = 2**15 - 1  # places are kept as int16
_MOST = 2**29  # voxels: three velocities each are numbered by int32

_GRID_BYTES = 12  # per voxel, of the phase or not: labels, components, numbers
_ROW_BYTES = 75  # per voxel of the phase whose row of the matrix is held while levels are built


@dataclass(frozen=True)
class Solver:
    """The solve of a coefficient, and the memory that it takes."""

    solve: Callable[[np.ndarray, np.ndarray], Effective]
    """From an array (Z, Y, X), which may be a view, transport along its first axis, and its voxel
    edges."""
    carries: np.ndarray
    """bool: whether each value of the array carries anything."""
    voxel_bytes: int
    """Memory per voxel that carries, at the peak."""


def effective(
    image: Image,
    values: np.ndarray,
    solver: Solver,
    *,
    axis: int,
    box: int | Sequence[int] | None,
    halving: bool,
) -> Effective:
    """Cut the box, turn the axis to the front, and solve; with `halving` solve a centre box twice
    more.
    """
    own, front = image.ndim, as_axis(axis, image.ndim)
    cut = np.moveaxis(centre(values, box_sides(box, image.shape)), front, 0)
    edges = np.roll(image.spacing[: front + 1], 1).tolist() + list(image.spacing[front + 1 :])
    if own == 2:  # one slice between two mirrors
        cut, edges = cut[:, None, :], [edges[0], min(edges), edges[1]]
    _check_size(cut.shape)
    carrying = carrying_voxels(cut.view(np.uint8), solver.carries)
    check_memory(forecast_bytes(carrying, solver.voxel_bytes, split=own if halving else 0))
    del carrying
    result = solver.solve(cut, np.array(edges))
    if not halving or not 0.0 < result.value < math.inf:
        return result
    small = centre_box(cut, HALVED)
    whole = solver.solve(small, np.array(edges))
    if not 0.0 < whole.value < math.inf:
        return result
    for d in range(3):
        if own == 3 or d != 1:
            small = np.repeat(small, 2, axis=d)
            edges[d] /= 2
    split = solver.solve(small, np.array(edges))
    return replace(result, halving=split.value / whole.value - 1.0)


def forecast_bytes(carrying: np.ndarray, voxel_bytes: int, *, split: int = 0) -> int:
    """Forecast the bytes that a solve takes beyond its input; with `split` axes halved in a centre
    box, those of the larger solve.

    What does not percolate is left out of the solve, but is found too late to count here.
    """

    def one(inside: np.ndarray) -> int:
        count = int(np.count_nonzero(inside))
        rows = max(PART, 2 * count // len(inside))  # a part, or two planes
        rows = min(count, rows * thread_count())
        return count * voxel_bytes + inside.size * _GRID_BYTES + rows * _ROW_BYTES

    if not split:
        return one(carrying)
    return max(
        one(carrying),
        2**split * one(centre_box(carrying, HALVED)),
    )


def carrying_voxels(labels: np.ndarray, carries: np.ndarray) -> np.ndarray:
    """Return which voxels have a label, or value, that carries anything, (256,) bool or fewer."""
    found = np.empty(labels.shape, bool)

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):  # NumPy widens what it looks up by to 8 bytes
            found[z] = carries[labels[z]]

    for_slabs(work, len(labels))
    return found


def percolating_voxels(inside: np.ndarray) -> np.ndarray | None:
    """Return the voxels of the components (of shared faces) that touch both ends of the first axis;
    None without any.
    """
    if not (inside[0].any() and inside[-1].any()):
        return None
    voxels = spanning_voxels(label_components(inside)[0], 0)
    return voxels if voxels.any() else None


def as_tolerance(tolerance: float) -> float:
    """Return a tolerance that float64 can reach."""
    return float(as_number(tolerance, name="tolerance", low=1e-10, high=0.1))


def _check_size(shape: tuple[int, ...]) -> None:
    if max(shape) > _LONGEST or int(np.prod(shape, dtype=np.int64)) > _MOST:
        size = "x".join(map(str, shape))
        raise InputError(
            f"{size} voxels are too many to solve at once: give box=, the edge of a centred box"
        )
