"""The window that pairs have to fit into: its sides, those of them that wrap, and the voxels of it
that count.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import quote
from trabecula.core.errors import InputError
from trabecula.measure.phases import as_inside, as_mask, as_periodic


@dataclass(frozen=True)
class Window:
    """Sides (Z, Y, X), whether each wraps, and the voxels that count (None: all)."""

    shape: tuple[int, ...]
    wraps: tuple[bool, ...]
    where: np.ndarray | None = None

    @property
    def room(self) -> tuple[int, ...]:
        """Return the largest offset along every axis; a wrapped one is never longer than its way
        round the other side.
        """
        return tuple(
            side // 2 if wrap else side - 1
            for side, wrap in zip(self.shape, self.wraps, strict=True)
        )

    def within(self, inside: np.ndarray) -> np.ndarray:
        """Return the phase, lifted to three axes, without what does not count."""
        inside = as_inside(inside)
        return inside if self.where is None else inside & self.where


def as_window(
    shape: tuple[int, ...], periodic: bool | Sequence[bool], mask: ArrayLike | None
) -> Window:
    """Return the window of an image of 2 or 3 axes; a 2-D image is one slice.

    Raises
    ------
    InputError
        `periodic` of another length, or a mask that is not boolean, of another shape or empty.
    """
    flat = 3 - len(shape)
    wraps = as_periodic(periodic, len(shape))
    region = as_mask(mask, shape)
    return Window(
        (1,) * flat + tuple(shape),
        (False,) * flat + wraps,
        None if region is None else as_inside(region),
    )


def check_range(r_max: int, limit: float, *, why: str) -> None:
    """Raise where r_max is not a whole number from 0 to `limit`."""
    if isinstance(r_max, bool) or not isinstance(r_max, (int, np.integer)):
        raise InputError(
            f"r_max {quote(r_max)} is not a whole number: give the largest distance in voxels"
        )
    if not 0 <= r_max <= limit:
        raise InputError(f"r_max {r_max} does not fit {why}: give 0 .. {max(0, math.floor(limit))}")


def check_pairs(fits: np.ndarray, *, masked: bool, what: str = "pair of voxels") -> None:
    """Raise where some distance has nothing to count."""
    if not fits.all():
        r = int(np.flatnonzero(fits == 0)[0])
        where_to = "the image and its mask" if masked else "the image"
        raise InputError(f"no {what} {r} apart fits into {where_to}: lower r_max to {r - 1}")
