"""What is solved: a centred box of the image, the axis of transport first, and the voxels that percolate along it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from trabecula.core.checks import as_number, as_shape
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.measure.components import label_components
from trabecula.measure.transport.result import Effective

HALVED = 48
"""Largest edge, in voxels, of the centre box whose voxels are split."""

_LONGEST = 2**15 - 1  # places are kept as int16
_MOST = 2**29  # voxels: three velocities each are numbered by int32

Solver = Callable[[np.ndarray, np.ndarray], Effective]
"""From an array (Z, Y, X), transport along its first axis, and its voxel edges."""


def effective(
    image: Image,
    values: np.ndarray,
    solver: Solver,
    *,
    axis: int,
    box: int | Sequence[int] | None,
    halving: bool,
) -> Effective:
    """Cut the box, turn the axis to the front, solve; where asked, solve a centre box twice more."""
    own, front = image.ndim, checked_axis(axis, image.ndim)
    sides = image.shape if box is None else as_shape(box, ndim=own, name="box")
    cut = np.moveaxis(centre(values, sides), front, 0)
    edges = np.roll(image.spacing[: front + 1], 1).tolist() + list(image.spacing[front + 1 :])
    if own == 2:  # one slice between two mirrors
        cut, edges = cut[:, None, :], [edges[0], min(edges), edges[1]]
    _check_size(cut.shape)
    result = solver(np.ascontiguousarray(cut), np.array(edges))
    if not halving or not 0.0 < result.value < math.inf:
        return result
    small = centre(cut, [HALVED] * 3)
    whole = solver(np.ascontiguousarray(small), np.array(edges))
    if not 0.0 < whole.value < math.inf:
        return result
    for d in range(3):
        if own == 3 or d != 1:
            small = np.repeat(small, 2, axis=d)
            edges[d] /= 2
    split = solver(np.ascontiguousarray(small), np.array(edges))
    return replace(result, halving=split.value / whole.value - 1.0)


def centre(values: np.ndarray, sides: Sequence[int]) -> np.ndarray:
    """The centred box of the given sides, or as much of it as there is."""
    cuts = []
    for length, side in zip(values.shape, sides, strict=True):
        first = max(0, (length - side) // 2)
        cuts.append(slice(first, min(length, first + side)))
    return values[tuple(cuts)]


def percolating(inside: np.ndarray) -> np.ndarray | None:
    """The voxels of the components (of shared faces) that touch both ends of the first axis; None without any."""
    if not (inside[0].any() and inside[-1].any()):
        return None
    labels, _ = label_components(inside)
    both = np.intersect1d(labels[0], labels[-1])
    both = both[both > 0]
    return np.isin(labels, both) if len(both) else None


def checked_axis(axis: int, ndim: int) -> int:
    """An axis counted from the front."""
    if isinstance(axis, bool) or not isinstance(axis, (int, np.integer)) or not -ndim <= axis < ndim:
        names = "0 (y) or 1 (x)" if ndim == 2 else "0 (z), 1 (y) or 2 (x)"
        raise InputError(f"axis {axis!r} does not exist: the image has {ndim} axes, give {names}")
    return int(axis) % ndim


def checked_tolerance(tolerance: float) -> float:
    """A tolerance that float64 can reach."""
    return float(as_number(tolerance, name="tolerance", low=1e-10, high=0.1))


def _check_size(shape: tuple[int, ...]) -> None:
    if max(shape) > _LONGEST or int(np.prod(shape, dtype=np.int64)) > _MOST:
        size = "x".join(map(str, shape))
        raise InputError(f"{size} voxels are too many to solve at once: give box=, the edge of a centred box")
