"""Boxes cut out of an image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.checks import as_corner, as_shape, check_type
from trabecula.core.errors import InputError
from trabecula.core.image import Image, with_values


def crop(image: Image, size: int | Sequence[int], *, corner: Sequence[int] | None = None) -> Image:
    """Cut a box out of an image, with one more step in its recipe.

    Parameters
    ----------
    image : Image
    size : int or sequence of int
        Voxels along every axis; one number means a cube (a square).
    corner : sequence of int, optional
        First voxel along every axis. Default: the box is central.

    Raises
    ------
    InputError
        The box is not inside the image.
    """
    check_type(image, Image, name="image", advice="tb.Image(array, kind) makes one")
    sides = as_shape(size, ndim=image.ndim, name="crop")
    if corner is None:
        first = tuple((have - want) // 2 for have, want in zip(image.shape, sides, strict=True))
    else:
        first = as_corner(corner)
    if len(first) != image.ndim or any(
        start < 0 or start + side > have
        for start, side, have in zip(first, sides, image.shape, strict=True)
    ):
        at = "" if corner is None else f" at {first}"
        raise InputError(
            f"a crop of {sides}{at} does not lie inside the image of {image.shape}: give a smaller "
            "one"
        )
    box = tuple(slice(start, start + side) for start, side in zip(first, sides, strict=True))
    values = np.ascontiguousarray(image.values[box])
    return with_values(
        image, values, recipe=image.recipe.then("crop", values, size=sides, corner=first)
    )
