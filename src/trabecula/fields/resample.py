"""Resampling of a field to another grid, and rescaling to another range."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.checks import as_number, as_shape
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.fields.grid import as_field, check_grey, history_of, of_image


def resample(field: Image, shape: int | Sequence[int]) -> Image:
    """Resample a field to another number of voxels over the same box, by linear interpolation.

    Parameters
    ----------
    field : Image
        Grey.
    shape : int or ints
        Voxels along every axis. Beyond the middles of the outermost voxels the field is constant.

    Returns
    -------
    field : Image
        With the spacing that keeps the size of the box.

    Raises
    ------
    InputError
        Not grey, or no valid shape.
    """
    check_grey(field)
    sides = as_shape(shape, ndim=field.ndim)
    spacing = [
        edge * old / new for edge, old, new in zip(field.spacing, field.shape, sides, strict=True)
    ]
    values, before = resample_array(field.values, sides), history_of(field)
    return as_field(
        values, "resample", {"shape": sides}, spacing=spacing, unit=field.unit, before=before
    )


def rescale(field: Image, *, low: float, high: float, clip: bool = False) -> Image:
    """Rescale a field linearly so that its least and greatest values are `low` and `high`.

    Parameters
    ----------
    field : Image
        Grey.
    low, high : float
    clip : bool
        Clip the values to the range instead.

    Returns
    -------
    field : Image

    Raises
    ------
    InputError
        Not grey, or `low` above `high`.

    Examples
    --------
    >>> steep = Image(np.array([[0.1, 0.5, 0.9]]), "grey")
    >>> rescale(steep, low=0.2, high=0.4).values
    array([[0.2, 0.3, 0.4]], dtype=float32)
    >>> rescale(steep, low=0.2, high=0.6, clip=True).values
    array([[0.2, 0.5, 0.6]], dtype=float32)
    """
    check_grey(field)
    least, most = (
        as_number(value, name=name, low=-1e6, high=1e6)
        for name, value in (("low", low), ("high", high))
    )
    if least > most:
        raise InputError(f"low={least:g} is above high={most:g}: exchange them")
    values = field.values.astype(np.float64)
    if not clip:
        own = values.min(), values.max()
        share = (values - own[0]) / max(own[1] - own[0], 1e-300)
        values = least + (most - least) * share
    return of_image(
        values.clip(least, most), "rescale", {"low": least, "high": most, "clip": bool(clip)}, field
    )


def resample_array(values: np.ndarray, shape: Sequence[int]) -> np.ndarray:
    """Interpolate linearly between the voxels' middles, one axis after another, in float64."""
    found = np.asarray(values, np.float64)
    for axis, side in enumerate(shape):
        old = found.shape[axis]
        if old == side:
            continue
        at = np.clip((np.arange(side) + 0.5) * old / side - 0.5, 0, old - 1)
        lower = np.minimum(at.astype(np.int64), max(old - 2, 0))
        share = (at - lower).reshape([-1 if k == axis else 1 for k in range(found.ndim)])
        upper = np.minimum(lower + 1, old - 1)
        found = found.take(lower, axis) * (1 - share) + found.take(upper, axis) * share
    return found
