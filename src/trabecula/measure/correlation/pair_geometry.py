"""Pairs of voxels that count as r apart: those along a ray, or all of that length."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from trabecula.core.checks import quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.measure.correlation.fourier import count_mirror_pairs
from trabecula.measure.correlation.lagged_counts import alike, both, count_along, count_offset
from trabecula.measure.correlation.window import Window, check_pairs, check_range
from trabecula.measure.phases import as_axis

_SPARSE = 0.05
"""Of the voxels: where fewer pairs fit at an offset, the errors of float32 would be more than 1e-6
of them.
"""


@dataclass(frozen=True)
class Ray:
    """Pairs one after another along a ray: sample r is r times `direction` (voxels; z, y, x)
    away.
    """

    window: Window
    r_max: int
    direction: tuple[float, ...]

    def fits(self) -> np.ndarray:
        """Count the pairs that fit, of every r."""
        where = self.window.where
        if where is not None:
            return self.count(where, None)
        lines = list(zip(self.window.shape, self.window.wraps, strict=True))
        return self._sum(
            lambda offset: math.prod(
                side if wrap else side - abs(step)
                for (side, wrap), step in zip(lines, offset, strict=True)
            )
        )

    def count(
        self, first: np.ndarray, second: np.ndarray | None, fits: np.ndarray | None = None
    ) -> np.ndarray:
        """Count the pairs with one end in `first` and the other in `second` (None: the same), mean
        of both orders.
        """
        along = [axis for axis, step in enumerate(self.direction) if step]
        step = self.direction[along[0]]
        if len(along) == 1 and step == round(step):
            wrap = self.window.wraps[along[0]]
            return count_along(
                first, second, self.r_max, axis=along[0], step=abs(round(step)), wrap=wrap
            )
        wraps = self.window.wraps
        there = self._sum(
            lambda offset: count_offset(
                first, first if second is None else second, offset, wraps, both
            )
        )
        if second is None:
            return there
        return (
            there + self._sum(lambda offset: count_offset(second, first, offset, wraps, both))
        ) / 2

    def count_same(self, labels: np.ndarray) -> np.ndarray:
        """Count the pairs with both ends in one label other than 0."""
        return self._sum(
            lambda offset: count_offset(labels, labels, offset, self.window.wraps, alike)
        )

    def _sum(self, count: Callable[[tuple[int, ...]], int]) -> np.ndarray:
        """Interpolate between the voxels around the end of the ray; where it ends at a voxel that
        one counts alone.
        """
        samples = [
            _corners(tuple(round(r * step, 9) for step in self.direction))
            for r in range(self.r_max + 1)
        ]
        known = {offset: count(offset) for corners in samples for offset, _ in corners}
        return np.array(
            [sum(weight * known[offset] for offset, weight in corners) for corners in samples],
            float,
        )


def _corners(end: tuple[float, ...]) -> list[tuple[tuple[int, ...], float]]:
    """Return the up to eight voxels around a point, with their weights in trilinear
    interpolation.
    """
    sides = [
        [(low, low + 1 - at), (low + 1, at - low)] if at > (low := math.floor(at)) else [(low, 1.0)]
        for at in end
    ]
    return [
        (tuple(at for at, _ in corner), math.prod(weight for _, weight in corner))
        for corner in product(*sides)
    ]


@dataclass(frozen=True)
class Radial:
    """All pairs whose distance, in units of the smallest voxel edge, rounds to r; `steps` are the
    edges in that unit.
    """

    window: Window
    r_max: int
    steps: tuple[float, ...]

    @property
    def reach(self) -> tuple[int, ...]:
        """Return the largest offset along every axis that can round to r_max and fits."""
        return tuple(
            min(int((self.r_max + 0.5) / step), room)
            for step, room in zip(self.steps, self.window.room, strict=True)
        )

    def fits(self) -> np.ndarray:
        """Count the pairs that fit, of every r."""
        if self.window.where is None:
            z, y, x = (
                np.full(far + 1, float(side)) if wrap else side - np.arange(far + 1.0)
                for side, wrap, far in zip(
                    self.window.shape, self.window.wraps, self.reach, strict=True
                )
            )
            return self.sum(z[:, None, None] * y[:, None] * x)
        rough = self._count(self.window.where, None, exact=False)
        return self._count(self.window.where, None, exact=True) if self.sparse(rough) else rough

    def count(self, first: np.ndarray, second: np.ndarray | None, fits: np.ndarray) -> np.ndarray:
        """Count the pairs with one end in `first` and the other in `second` (None: the same), in
        both orders.
        """
        return self._count(first, second, exact=self.sparse(fits))

    def sum(self, counts: np.ndarray) -> np.ndarray:
        """Sum over all offsets r apart, from the offsets that are not negative (see
        `count_mirror_pairs`).
        """
        lengths, images = self.lengths(), self._images()
        near = lengths <= self.r_max
        return np.bincount(lengths[near], weights=(counts * images)[near], minlength=self.r_max + 1)

    def lengths(self) -> np.ndarray:
        """Return the rounded length of every offset from 0 to `reach`, int32."""
        z, y, x = (
            np.arange(far + 1) * step for far, step in zip(self.reach, self.steps, strict=True)
        )
        return (np.sqrt((z**2)[:, None, None] + (y**2)[:, None] + x**2) + 0.5).astype(np.int32)

    def _images(self) -> np.ndarray:
        """Count the offsets that are mirror images of each; half a wrapped side is its own."""
        z, y, x = (
            np.where(
                (np.arange(far + 1) == 0) | (wrap & (2 * np.arange(far + 1) == side)), 1.0, 2.0
            )
            for far, side, wrap in zip(
                self.reach, self.window.shape, self.window.wraps, strict=True
            )
        )
        return np.asarray(z[:, None, None] * y[:, None] * x)

    def _count(self, first: np.ndarray, second: np.ndarray | None, *, exact: bool) -> np.ndarray:
        return self.sum(
            count_mirror_pairs(first, second, self.reach, self.window.wraps, exact=exact)
        )

    def sparse(self, fits: np.ndarray) -> bool:
        """Return whether so few pairs fit somewhere that they have to be counted in float64."""
        offsets = self.sum(np.ones(tuple(far + 1 for far in self.reach)))
        return bool(np.any(fits < _SPARSE * offsets * math.prod(self.window.shape)))


def select_pairs(
    image: Image, window: Window, *, r_max: int, axis: int | None, direction: Sequence[float] | None
) -> Ray | Radial:
    """Return the pairs that a caller asks for.

    Raises
    ------
    InputError
        Axis and direction both given, a direction that is none, or an r_max that does not fit.
    """
    if axis is None and direction is None:
        limit = radial_limit(image, window)
        check_range(
            r_max,
            limit,
            why=f"an image of shape {image.shape}, across which pairs reach {limit} voxels",
        )
        return Radial(window, int(r_max), steps_of(image.spacing))
    if axis is not None:
        if direction is not None:
            raise InputError(
                f"axis {axis} and direction {direction} were both given: give one of them"
            )
        along = as_axis(axis, image.ndim) + 3 - image.ndim
        vector: tuple[float, ...] = tuple(float(at == along) for at in range(3))
    else:
        vector = _as_direction(direction, image.ndim)
    for step, side, wrap, room in zip(vector, window.shape, window.wraps, window.room, strict=True):
        if step:
            why = "half of it, the image is periodic" if wrap else "below it"
            many = (
                f"{side} voxels" if abs(step) == 1 else f"{side} voxels in steps of {abs(step):g}"
            )
            check_range(r_max, room / abs(step) + 1e-9, why=f"a side of {many} ({why})")
    return Ray(window, int(r_max), vector)


def radial_limit(image: Image, window: Window) -> int:
    """Return the longest distance along any axis, in units of the smallest voxel edge."""
    return max(
        int(room * step) for room, step in zip(window.room, steps_of(image.spacing), strict=True)
    )


def steps_of(spacing: tuple[float, ...]) -> tuple[float, ...]:
    """Return the edges of a voxel in units of the smallest; a slice is one such unit thick."""
    edge = min(spacing)
    return (1.0,) * (3 - len(spacing)) + tuple(step / edge for step in spacing)


def _as_direction(direction: Sequence[float] | None, ndim: int) -> tuple[float, ...]:
    try:
        vector = np.array(direction, np.float64)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    if vector.shape != (ndim,) or not np.isfinite(vector).all() or not vector.any():
        raise InputError(
            f"direction {quote(direction)} is not a vector of {ndim} numbers: give voxels along "
            "every "
            "axis, slowest first, "
            "such as (1, 1, 0)"
        )
    return (0.0,) * (3 - ndim) + tuple(vector.tolist())


def positive_fits(pairs: Ray | Radial) -> np.ndarray:
    """Count the pairs that fit, of every r; never 0."""
    fits = pairs.fits()
    check_pairs(fits, masked=pairs.window.where is not None)
    return fits


def probability(hits: np.ndarray, fits: np.ndarray) -> np.ndarray:
    """Return hits over fits, kept within 0 and 1: float32 errs on a large volume."""
    return np.clip(hits / fits, 0.0, 1.0)
