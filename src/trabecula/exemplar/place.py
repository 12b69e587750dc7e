"""Put a scan into a larger image, of which it is the known part."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.checks import as_shape
from trabecula.core.errors import InputError
from trabecula.core.image import Image, with_values
from trabecula.core.recipe import Recipe


def place(image: Image, shape: int | Sequence[int], *, corner: Sequence[int]) -> Image:
    """An image of `shape` that holds `image` at `corner`, and 0 elsewhere.

    Parameters
    ----------
    image : Image
    shape : int or sequence of int
        Voxels of the larger image along every axis.
    corner : sequence of int
        Where the first voxel of `image` comes to lie.

    Raises
    ------
    InputError
        The image does not lie inside the larger one there.
    """
    sides, box = _box(image.shape, shape, corner)
    values = np.zeros(sides + image.values.shape[image.ndim :], image.values.dtype)
    values[box] = image.values
    first = [part.start for part in box]
    return with_values(image, values, recipe=image.recipe.then("place", values, shape=sides, corner=first))


def block(size: Sequence[int], shape: int | Sequence[int], *, corner: Sequence[int]) -> Image:
    """Labels of `shape`: solid in the box of `size` voxels at `corner`, void elsewhere.

    It is the known part of what `place` puts there.

    Examples
    --------
    >>> block((2, 1), (3, 4), corner=(0, 3)).values.tolist()
    [[0, 0, 0, 1], [0, 0, 0, 1], [0, 0, 0, 0]]
    """
    sides, box = _box(tuple(size), shape, corner)
    values = np.zeros(sides, np.uint8)
    values[box] = 1
    first = [part.start for part in box]
    return Image(values, "labels", recipe=Recipe().then("block", values, size=list(size), shape=sides, corner=first))


def _box(
    size: tuple[int, ...], shape: int | Sequence[int], corner: Sequence[int]
) -> tuple[tuple[int, ...], tuple[slice, ...]]:
    sides = as_shape(shape, ndim=len(size))
    first = [int(start) for start in corner]
    if len(first) != len(size):
        raise InputError(f"corner {tuple(corner)} has {len(first)} numbers: give {len(size)}, slowest axis first")
    if any(start < 0 or start + have > side for start, have, side in zip(first, size, sides, strict=True)):
        raise InputError(
            f"a scan of {tuple(size)} voxels at {tuple(first)} does not lie inside {sides}: "
            "choose another corner (--at), or a larger shape"
        )
    return sides, tuple(slice(start, start + have) for start, have in zip(first, size, strict=True))
