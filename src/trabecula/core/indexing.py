"""The index of `image[...]`: whole numbers, slices and `...`, one for every axis of space."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np

from trabecula.core.checks import quote
from trabecula.core.errors import InputError

_AXES = ("z", "y", "x")


def read_index(key: Any, *, shape: Sequence[int]) -> tuple[int | slice, ...]:
    """Check an index and write it out, an item for every axis.

    Parameters
    ----------
    key : int, slice, `...`, or a tuple of these
        As NumPy takes it. Numbers below 0 count from the end.
    shape : sequence of int
        Voxels along every axis of space.

    Returns
    -------
    tuple of int or slice
        Numbers from 0 on, and slices whose start and step are numbers; the stop is None where a
        step below 0 goes to the first voxel.

    Raises
    ------
    InputError
        A mask, a list, an array, a new axis or a text; more items than axes; a number outside the
        image; an empty slice; fewer than two axes left.
    """
    items = list(key) if isinstance(key, tuple) else [key]
    dots = [place for place, item in enumerate(items) if item is Ellipsis]
    if len(dots) > 1 or len(items) - len(dots) > len(shape):
        raise InputError(
            f"an image of {len(shape)} axes takes up to {len(shape)} indices and one ...: got "
            f"{quote(key)}"
        )
    place = dots[0] if dots else len(items)
    missing = [slice(None)] * (len(shape) - len(items) + len(dots))
    items[place : place + len(dots)] = missing
    axes = _AXES[-len(shape) :]
    index = tuple(
        _item(item, axis, side) for item, axis, side in zip(items, axes, shape, strict=True)
    )
    if sum(isinstance(item, slice) for item in index) < 2:
        raise InputError(
            f"{quote(key)} leaves fewer than 2 axes, an image has 2 or 3: index the array, "
            "image.values[...]"
        )
    return index


def _item(item: Any, axis: str, side: int) -> int | slice:
    if isinstance(item, slice):
        return _slice(item, axis, side)
    try:
        if isinstance(item, (bool, np.bool_)):
            raise TypeError
        number = operator.index(item)
    except TypeError:
        raise InputError(
            f"an image is indexed by whole numbers, slices and ...: got {type(item).__name__}; for "
            "a mask, a list or a new axis index the array, image.values[...]"
        ) from None
    if not -side <= number < side:
        raise InputError(f"index {number} is outside the image's {side} voxels along {axis}")
    return number % side


def _slice(item: slice, axis: str, side: int) -> slice:
    try:
        places = range(side)[item]
    except (TypeError, ValueError):
        raise InputError(
            f"a slice along {axis} takes whole numbers and a step other than 0: got {item}"
        ) from None
    if not places:
        raise InputError(
            f"the slice {item} along {axis} is empty: the image has {side} voxels there"
        )
    return slice(places.start, places.stop if places.stop >= 0 else None, places.step)


def to_json(index: Sequence[int | slice]) -> list[int | list[int | None]]:
    """Return an index that `read_index` gave as plain JSON: a number, or start, stop and step."""
    return [
        [item.start, item.stop, item.step] if isinstance(item, slice) else item for item in index
    ]


def from_json(plain: Sequence[int | Sequence[int | None]]) -> tuple[int | slice, ...]:
    """Return the index that `to_json` wrote."""
    return tuple(
        slice(*item) if isinstance(item, (list, tuple)) else item  # type: ignore[misc]
        for item in plain
    )
