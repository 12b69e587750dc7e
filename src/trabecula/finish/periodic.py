"""Images that continue at the opposite face: a frame of reference that rolls along, and margins of
periodic images.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from trabecula.measure.smooth import gaussian, reach_of


def periodic_setting(wraps: Sequence[bool]) -> list[bool] | bool:
    """Return `wraps` as a recipe's step records it: False where no axis is periodic."""
    return [bool(wrap) for wrap in wraps] if any(wraps) else False


def material_origin(values: np.ndarray, wraps: Sequence[bool]) -> tuple[int, ...]:
    """Return the voxel of labels that is taken for their first one; 0 along other axes.

    It rolls along with the image, so that ties that are broken by the order of voxels are broken
    alike in every rolled image. Planes differ by their sum, and by the faces of voxels between them
    and the next; the origin begins the smallest sequence of these. Where a material
    repeats within the image, any of several planes is taken.
    """
    origin = [0] * values.ndim
    for axis in np.flatnonzero(wraps):
        planes = np.moveaxis(values, axis, 0)
        sums = np.array(
            [
                (
                    planes[k].sum(dtype=np.int64),
                    np.count_nonzero(planes[k] != planes[(k + 1) % len(planes)]),
                )
                for k in range(len(planes))
            ]
        )
        _, rank = np.unique(sums, axis=0, return_inverse=True)
        rank = rank.reshape(-1)
        starts = np.arange(len(planes))
        for step in range(len(planes)):
            next_rank = rank[(starts + step) % len(planes)]
            starts = starts[next_rank == next_rank.min()]
            if len(starts) == 1:
                break
        origin[axis] = int(starts[0])
    return tuple(origin)


def roll_by(values: np.ndarray, shift: Sequence[int]) -> np.ndarray:
    """Return an array rolled by voxels along every axis; the array itself where all are 0."""
    return np.roll(values, tuple(shift), tuple(range(values.ndim))) if any(shift) else values


def wrap_margins(inside: np.ndarray, wraps: Sequence[bool]) -> tuple[int, ...]:
    """Return the voxels of a margin that holds the cells next to a periodic face: one and a half
    mean chords of phase and rest together, at most a period; 0 along other axes.
    """
    margins = []
    for axis, wrap in enumerate(wraps):
        planes = np.moveaxis(inside, axis, 0)
        faces = np.count_nonzero(planes[1:] != planes[:-1])
        margins.append(min(len(planes), -(-3 * inside.size // max(faces, 1))) if wrap else 0)
    return tuple(margins)


def pad_wrapped(values: np.ndarray, margins: Sequence[int]) -> np.ndarray:
    """Return an array with margins that repeat it."""
    return np.pad(values, [(margin, margin) for margin in margins], mode="wrap")


def crop_margins(values: np.ndarray, margins: Sequence[int]) -> np.ndarray:
    """Return the view of an array without its margins."""
    return values[
        tuple(
            slice(margin, side - margin) for margin, side in zip(margins, values.shape, strict=True)
        )
    ]


def gaussian_around(
    values: np.ndarray, widths: Sequence[float], wraps: Sequence[bool]
) -> np.ndarray:
    """Return the Gaussian of an array that continues across its periodic faces; widths in voxels,
    one per axis.
    """
    margins = [
        reach_of(width) if wrap and side > 1 else 0
        for width, wrap, side in zip(widths, wraps, values.shape, strict=True)
    ]
    return crop_margins(gaussian(pad_wrapped(values, margins), widths), margins)


def periodic_images(at: np.ndarray, margins: Sequence[int], shape: Sequence[int]) -> np.ndarray:
    """Return all voxels (m, D) that are the same as the voxels `at` (n, D), in an array of `shape`
    with margins that repeat it.
    """
    margin = np.array(margins)
    side = np.array(shape) - 2 * margin
    first = np.where(margin > 0, margin + (at - margin) % side, at)
    counts = -(-margin // side)
    found = [
        first + np.array(step) * side
        for step in product(*(range(-count, count + 1) for count in counts))
    ]
    every = np.concatenate(found)
    return every[((every >= 0) & (every < shape)).all(axis=1)]
