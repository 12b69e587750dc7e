"""A scan, or a picture, placed in a larger image as its known part."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.checks import as_shape
from trabecula.core.errors import InputError
from trabecula.core.image import Image, with_values
from trabecula.core.recipe import Recipe
from trabecula.exemplar.views import as_axis, check_plane


def place(
    image: Image,
    shape: int | Sequence[int],
    *,
    corner: Sequence[int],
    plane: str | None = None,
    across: float = 1.0,
) -> Image:
    """Return an image of `shape` that holds `image` at `corner`, and 0 elsewhere.

    Parameters
    ----------
    image : Image
    shape : int or sequence of int
        Voxels of the larger image along every axis.
    corner : sequence of int
        Position of the first voxel of `image`.
    plane : str, optional
        Of a picture that is put into a volume: the volume's axes along its rows and columns, "yx",
        "zx", "zy", or turned "xy", "xz", "yz".
    across : float
        Edge of a voxel across that plane, in the picture's unit.

    Raises
    ------
    InputError
        The image is not inside the larger one there; a picture for a volume without a plane.
    UnknownNameError
        No such plane.

    Examples
    --------
    >>> picture = Image(np.ones((2, 3), int), "labels")
    >>> place(picture, (4, 4, 4), corner=(1, 0, 0), plane="yx").values.sum(axis=(1, 2)).tolist()
    [0, 6, 0, 0]
    """
    flat = image if plane is None else as_slab(image, plane, across=across)
    sides, box = _box(flat.shape, shape, corner)
    values = np.zeros(sides + flat.values.shape[flat.ndim :], flat.values.dtype)
    values[box] = flat.values
    first = [part.start for part in box]
    turned = {} if plane is None else {"plane": plane, "across": across}
    return with_values(
        flat, values, recipe=image.recipe.then("place", values, shape=sides, corner=first, **turned)
    )


def as_slab(picture: Image, plane: str, *, across: float = 1.0) -> Image:
    """Return a picture as a volume one voxel thick; `plane` and `across` as in `place`.

    Raises
    ------
    InputError
        Not a picture.
    UnknownNameError
        No such plane.
    """
    check_plane(plane)
    if picture.ndim != 2:
        raise InputError(
            f"a plane ({plane}) is for a picture, got {picture.ndim} axes of shape {picture.shape}"
        )
    axis = as_axis(plane)
    # z, y, x is the order of the axes: rows along the slower one come first
    ordered = plane[0] > plane[1]
    values = picture.values if ordered else picture.values.swapaxes(0, 1)
    edges = list(picture.spacing if ordered else picture.spacing[::-1])
    edges.insert(axis, across)
    return with_values(
        picture, np.ascontiguousarray(np.expand_dims(values, axis)), spacing=tuple(edges)
    )


def block(size: Sequence[int], shape: int | Sequence[int], *, corner: Sequence[int]) -> Image:
    """Return labels of `shape`: solid in the box of `size` voxels at `corner`, void elsewhere.

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
    return Image(
        values,
        "labels",
        recipe=Recipe().then("block", values, size=list(size), shape=sides, corner=first),
    )


def _box(
    size: tuple[int, ...], shape: int | Sequence[int], corner: Sequence[int]
) -> tuple[tuple[int, ...], tuple[slice, ...]]:
    sides = as_shape(shape, ndim=len(size))
    first = [int(start) for start in corner]
    if len(first) != len(size):
        raise InputError(
            f"corner {tuple(corner)} has {len(first)} numbers: give {len(size)}, slowest axis first"
        )
    if any(
        start < 0 or start + have > side
        for start, have, side in zip(first, size, sides, strict=True)
    ):
        raise InputError(
            f"a scan of {tuple(size)} voxels at {tuple(first)} does not lie inside {sides}: "
            "choose another corner (--at), or a larger shape"
        )
    return sides, tuple(slice(start, start + have) for start, have in zip(first, size, strict=True))
