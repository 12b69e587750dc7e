"""The window that pairs have to fit into: its sides, which of them wrap, and which voxels of it count."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.measure.phases import as_inside


@dataclass(frozen=True)
class Window:
    """Sides (Z, Y, X), whether each wraps, and the voxels that count (None: all)."""

    shape: tuple[int, ...]
    wraps: tuple[bool, ...]
    where: np.ndarray | None = None

    @property
    def room(self) -> tuple[int, ...]:
        """The largest offset along every axis; a wrapped one is never longer than its way round the other side."""
        return tuple(side // 2 if wrap else side - 1 for side, wrap in zip(self.shape, self.wraps, strict=True))

    def within(self, inside: np.ndarray) -> np.ndarray:
        """The phase, lifted to three axes, without what does not count."""
        inside = as_inside(inside)
        return inside if self.where is None else inside & self.where


def as_window(shape: tuple[int, ...], periodic: bool | Sequence[bool], mask: ArrayLike | None) -> Window:
    """The window of an image of 2 or 3 axes; a 2-D image is one slice.

    Raises
    ------
    InputError
        `periodic` of another length, or a mask that is not boolean or of another shape.
    """
    ndim = len(shape)
    one = isinstance(periodic, (bool, np.bool_))
    wraps = (bool(periodic),) * ndim if one else tuple(bool(wrap) for wrap in periodic)  # type: ignore[union-attr]
    if len(wraps) != ndim:
        raise InputError(f"periodic has {len(wraps)} values: give one, or one for each of the {ndim} axes")
    flat = 3 - ndim
    where = None if mask is None else as_inside(_checked_mask(mask, shape))
    return Window((1,) * flat + tuple(shape), (False,) * flat + wraps, where)


def _checked_mask(mask: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(mask)
    if array.dtype != bool or array.shape != shape:
        raise InputError(
            f"the mask is {array.dtype} of shape {array.shape}: a boolean array of shape {shape} is needed"
        )
    return array


def checked_axis(axis: int, ndim: int) -> int:
    """`axis` of an image, counted in (Z, Y, X)."""
    if not -ndim <= axis < ndim:
        raise InputError(f"axis {axis} does not exist: the image has {ndim}")
    return int(axis) % ndim + 3 - ndim


def check_range(r_max: int, limit: float, *, why: str) -> None:
    """Raise where r_max is not a whole number from 0 to `limit`."""
    if isinstance(r_max, bool) or not isinstance(r_max, (int, np.integer)):
        raise InputError(f"r_max {r_max!r} is not a whole number: give the largest distance in voxels")
    if not 0 <= r_max <= limit:
        raise InputError(f"r_max {r_max} does not fit {why}: give 0 .. {max(0, math.floor(limit))}")


def check_pairs(fits: np.ndarray, *, masked: bool, what: str = "pair of voxels") -> None:
    """Raise where some distance has nothing to count."""
    if not fits.all():
        r = int(np.flatnonzero(fits == 0)[0])
        where_to = "the image and its mask" if masked else "the image"
        advice = f"lower r_max to {r - 1}" if r else "give a mask that holds some voxels"
        raise InputError(f"no {what} {r} apart fits into {where_to}: {advice}")
