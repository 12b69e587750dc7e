"""The grid of a field, and a field as an Image with its recipe."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_shape, as_spacing, check_finite, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.recipe import Recipe

AXES = {2: "yx", 3: "zyx"}


def as_sides(shape: int | Sequence[int]) -> tuple[int, ...]:
    """Return the shape of a field: two or three whole numbers; one means a cube."""
    several = (
        len(shape) == 2
        if isinstance(shape, list | tuple)
        else getattr(shape, "shape", None) == (2,)
    )
    return as_shape(shape, ndim=2 if several else 3)


def as_region(given: ArrayLike, shape: tuple[int, ...], *, name: str) -> np.ndarray:
    """Return a boolean array of `shape`, checked to contain a voxel."""
    try:
        region = np.asarray(given)
    except ValueError:
        raise InputError(
            f"the rows of {name} differ in length: give a boolean array of shape {shape}"
        ) from None
    if region.dtype != bool or region.shape != shape:
        raise InputError(
            f"{name} is {region.dtype} of shape {region.shape}: give a boolean array of shape "
            f"{shape}"
        )
    if not region.any():
        raise InputError(f"{name} holds no voxel: mark with True what counts")
    return region


def middles(shape: Sequence[int], spacing: Sequence[float]) -> list[np.ndarray]:
    """Return the positions of the voxels' middles along every axis, from 0 at the first face.

    One array an axis, which broadcast to `shape`.
    """
    found = []
    for axis, (side, edge) in enumerate(zip(shape, spacing, strict=True)):
        line = (np.arange(side) + 0.5) * edge
        found.append(line.reshape([-1 if k == axis else 1 for k in range(len(shape))]))
    return found


def as_axis(axis: str | int, ndim: int) -> int:
    """Return the number of an axis given by its letter or number."""
    if isinstance(axis, str) and axis in tuple(AXES[ndim]):
        return AXES[ndim].index(axis)
    if (
        isinstance(axis, bool)
        or not isinstance(axis, (int, np.integer))
        or not -ndim <= axis < ndim
    ):
        raise InputError(
            f"axis {quote(axis)} does not exist in {ndim}-D: give one of {', '.join(AXES[ndim])}"
        )
    return int(axis) % ndim


def as_field(
    values: np.ndarray,
    make: str,
    settings: Mapping[str, Any],
    *,
    spacing: Sequence[float] | float | None = None,
    unit: str = "voxel",
    before: Recipe | None = None,
    report: Mapping[str, Any] | None = None,
) -> Image:
    """Return values as a grey Image of float32, with the recipe's step that makes them."""
    check_finite(np.asarray(values), name=f"the field of {make}")
    field = np.ascontiguousarray(values, np.float32)
    more = {} if report is None else {"report": dict(report)}
    recipe = (before or Recipe()).then("field", field, make=make, settings=dict(settings), **more)
    return Image(
        field, "grey", spacing=as_spacing(spacing, ndim=field.ndim), unit=unit, recipe=recipe
    )


def of_image(values: np.ndarray, make: str, settings: Mapping[str, Any], image: Image) -> Image:
    """Return values as a field on the grid of an image, with its recipe and the step."""
    return as_field(
        values, make, settings, spacing=image.spacing, unit=image.unit, before=history_of(image)
    )


def history_of(image: Image) -> Recipe:
    """Return an image's recipe; for an array in memory, one with its digest."""
    return image.recipe or Recipe().then("array", image.values)


def check_grey(field: Image) -> None:
    """Raise where a field is no grey Image."""
    if not isinstance(field, Image) or field.kind != "grey":
        kind = field.kind if isinstance(field, Image) else type(field).__name__
        raise InputError(f"a field is a grey Image, got {kind}: give tb.Image(array, kind='grey')")
