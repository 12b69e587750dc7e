"""A volume for the ray marcher: smooth field, index of empty blocks, pyramid of densities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image, phase_index
from trabecula.view.kernels import blur_axis
from trabecula.view.rays import BLOCK, ISO

LEVELS = 6

# A Gaussian of sigma 0.7 voxel, in 1/256: takes the staircase off binary labels and keeps walls of
# one voxel.
WEIGHTS = np.array([3, 51, 148, 51, 3], np.int64)


class Volume(NamedTuple):
    """Arrays for `kernels.march`; see there."""

    field: np.ndarray
    labels: np.ndarray
    occupied: np.ndarray
    pyramid: np.ndarray
    offsets: np.ndarray
    shapes: np.ndarray


def visible_phases(image: Image, phase: str | int | Sequence[str | int] | None) -> list[int]:
    """Return the labels that a still shows: those requested, by default every phase but the one
    named "void".
    """
    if phase is None:
        others = [index for index, name in enumerate(image.phases) if name != "void"]
        return others
    several = [phase] if isinstance(phase, (str, int, np.integer)) else list(phase)
    if not several:
        raise InputError(f"phase is empty: name at least one of {', '.join(image.phases)}")
    return sorted({phase_index(image, one, default="solid") for one in several})


def prepare_volume(labels: np.ndarray, drawn: Sequence[int]) -> Volume:
    """Prepare the arrays of one volume.

    Parameters
    ----------
    labels : (Z, Y, X) uint8
    drawn : sequence of int
        Labels that are solid to the eye.
    """
    table = np.zeros(256, np.uint8)
    table[list(drawn)] = 255
    field = _blur(table[labels])
    levels = _levels(field)
    return Volume(
        field=field,
        labels=_spread(labels, table),
        occupied=_find_surface_blocks(field),
        pyramid=np.concatenate([level.ravel() for level in levels]),
        offsets=np.cumsum([0, *(level.size for level in levels[:-1])]),
        shapes=np.array([level.shape for level in levels], np.int64),
    )


def _blur(values: np.ndarray) -> np.ndarray:
    depth, height, width = values.shape
    other = np.empty_like(values)
    for shape in ((1, depth, height * width), (depth, height, width), (depth * height, width, 1)):
        blur_axis(values.reshape(shape), WEIGHTS, other.reshape(shape))
        values, other = other, values
    return values


def _spread(labels: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Return labels where hidden voxels beside drawn ones take theirs: smoothing may move a surface
    by half a voxel.
    """
    if np.count_nonzero(table) == 1:
        return np.full((1, 1, 1), np.flatnonzero(table)[0], np.uint8)
    spread = labels.copy()
    for axis in range(3):
        for here, there in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
            to = spread[(slice(None),) * axis + (here,)]
            source = labels[(slice(None),) * axis + (there,)]
            np.copyto(to, source, where=(table[to] == 0) & (table[source] > 0))
    return spread


def _find_surface_blocks(field: np.ndarray) -> np.ndarray:
    """Return the blocks where interpolation can reach ISO, (Z/BLOCK, Y/BLOCK, X/BLOCK) bool."""
    solid = field > int(ISO)
    for axis, length in enumerate(field.shape):
        starts = np.arange(0, length, BLOCK)
        # A point of a block reads its voxels and one more to each side.
        solid = np.moveaxis(solid, axis, 0)
        blocks = np.logical_or.reduceat(solid, starts, axis=0)
        blocks[1:] |= solid[starts[1:] - 1]
        inner = starts[:-1] + BLOCK
        blocks[:-1] |= solid[inner]
        solid = np.moveaxis(blocks, 0, axis)
    return np.ascontiguousarray(solid)


def _levels(field: np.ndarray) -> list[np.ndarray]:
    levels = [field]
    for _ in range(LEVELS - 1):
        values = levels[-1]
        padded = np.pad(values, [(0, side % 2) for side in values.shape]).astype(np.uint16)
        for axis in range(3):
            even = (slice(None),) * axis + (slice(0, None, 2),)
            odd = (slice(None),) * axis + (slice(1, None, 2),)
            padded = padded[even] + padded[odd]
        levels.append((padded >> 3).astype(np.uint8))
    return levels
