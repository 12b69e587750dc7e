"""Gaussian fields whose covariance is turned and scaled from place to place, and cut at a level
that varies.

One white noise is convolved with the filter in every frame that the target needs, and at each voxel
the results are mixed: f(x) = sum of w_k(x) (h_k * n)(x), a Gaussian number of the variance
w^T C w with C_kl = h_k . h_l. So the level of a fraction is known at every voxel, and the
fraction is met without a trial; neighbouring frames share the noise, so that nothing breaks between
them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.request import Request
from trabecula.core.target import densities_of, frame_of, porosity_of
from trabecula.engine.blocks import Box
from trabecula.engine.compile import kernel
from trabecula.engine.gaussian_random import quantiles
from trabecula.engine.memory import Array, Stage, within
from trabecula.synth.api.windows import field_in
from trabecula.synth.noise.covariance import MOST_REACH
from trabecula.synth.shared.frames import TargetFrames, frames_of, turn_onto, turn_values
from trabecula.synth.shared.gaussian.domain import domain_of
from trabecula.synth.shared.gaussian.field import WHITE, GaussianField, integer_filter
from trabecula.synth.shared.gaussian.filters import Filter

DIRECTIONS = 120
"""Directions that stand for all: 13 degrees apart."""

_ROUND = 0.8  # of the middle gradient: a smaller one is along a direction
_DEVIATES = np.linspace(-6, 6, 4801)
_SHARES = np.array([0.5 * math.erfc(-t / math.sqrt(2)) for t in _DEVIATES.tolist()])


def principal_axis(part: Filter) -> np.ndarray:
    """Return the axis along which a field of this filter changes least.

    That is the longest mean intercept of what is cut of it: normals of a level set are distributed
    as gradients, whose second moments are the filter's.

    Raises
    ------
    RequestError
        A field that is alike in all directions.
    """
    slopes = np.gradient(part.values.astype(np.float64))
    moments = np.array([[float((a * b).sum()) for b in slopes] for a in slopes])
    values, vectors = np.linalg.eigh(moments)
    if values[0] > _ROUND * values[1]:
        raise RequestError(
            "the target orientation turns the longest direction of the material, and this one has "
            f"none (slopes along its first two axes are {math.sqrt(values[0] / values[1]):.2f} to "
            "1): give length three numbers, one longer than the others, cones, or an exemplar with "
            "a direction"
        )
    return np.asarray(vectors[:, 0])


class TurnedField:
    """The field of one request.

    Attributes
    ----------
    frames : TargetFrames
    field : GaussianField
        A filter a frame.
    """

    def __init__(self, part: Filter, request: Request) -> None:
        frame = frame_of(request.target)
        self.frames: TargetFrames = frames_of(frame, DIRECTIONS)
        self.field = GaussianField(_turned_filters(part, self.frames, turns=bool(frame)))
        self.products = _products(self.field.filters)

    def cut(
        self, request: Request, box: Box, share: np.ndarray, *, exact: bool = False
    ) -> np.ndarray:
        """Return where the field is above the level of `share` in a box (Z, Y, X), bool.

        With `exact` one number is added to all levels, such that the fraction of the box (of the
        request's mask, where it has one: the box is then all of it) is the mean of `share`.
        """
        shape = tuple(stop - start for start, stop in box)
        ways, sizes = (_in_box(request, name, box) for name in ("orientation", "size"))
        height = np.zeros(shape)

        for number in range(self.frames.count):

            def add(piece: tuple[slice, ...], z: int, plane: np.ndarray, n: int = number) -> None:
                weight = self._weights(n, ways, sizes, (piece[0].start + z, *piece[1:]))
                height[piece][z] += weight * np.rint(plane)

            if any(self._plane(number, ways, sizes, z).any() for z in range(shape[0])):
                self.field.each(number, domain_of(request), box, add, noise=0)
        levels = np.broadcast_to(np.interp(1 - share, _SHARES, _DEVIATES), shape)
        for z in range(shape[0]):
            height[z] /= np.sqrt(self._variance(ways, sizes, z, shape[1:]))
            height[z] -= levels[z]
        least = 0.0
        if exact:
            inside = np.ones(shape, bool) if request.mask is None else request.mask
            wanted = float(np.broadcast_to(share, shape)[inside].mean())
            least = float(np.quantile(height[inside], 1 - wanted))
        return height > least

    def _weights(
        self, number: int, ways: np.ndarray | None, sizes: np.ndarray | None, at: tuple[Any, ...]
    ) -> np.ndarray:
        parts = [
            one if one is None or one.ndim == last else one[at]
            for one, last in ((ways, 1), (sizes, 0))
        ]
        return self.frames.weights(number, *parts)

    def _plane(
        self, number: int, ways: np.ndarray | None, sizes: np.ndarray | None, z: int
    ) -> np.ndarray:
        return self._weights(number, ways, sizes, (z,))

    def _variance(
        self, ways: np.ndarray | None, sizes: np.ndarray | None, z: int, plane: Sequence[int]
    ) -> np.ndarray:
        """Return the variance of the mixed field in a plane (Y, X)."""
        weights = np.empty((self.frames.count, *plane))
        for number in range(self.frames.count):
            weights[number] = self._plane(number, ways, sizes, z)
        found = np.empty(tuple(plane))
        mixed_variance(weights, self.products, found)
        return found


@kernel
def mixed_variance(weights, products, found):
    """Fill `found` (Y, X) with w^T C w, of weights (K, Y, X) of which most are 0."""
    count = len(weights)
    some = np.empty(count, np.int64)
    for y in range(found.shape[0]):
        for x in range(found.shape[1]):
            n = 0
            for k in range(count):
                if weights[k, y, x] > 0.0:
                    some[n] = k
                    n += 1
            total = 0.0
            for i in range(n):
                for j in range(n):
                    a, b = some[i], some[j]
                    total += weights[a, y, x] * weights[b, y, x] * products[a, b]
            found[y, x] = total


def wanted_share(request: Request, box: Box, porosity: float, *, void_first: bool) -> np.ndarray:
    """Return the fraction of the first phase in a box: the target's, or that of the model."""
    asked = porosity_of(densities_of(request.target))
    found = np.asarray(field_in(porosity if asked is None else asked, box), np.float64)
    return found if void_first else 1 - found


def turned_stages(part: Filter, request: Request, shape: Sequence[int]) -> tuple[Stage, ...]:
    """Return the stages of making a box (Z, Y, X), with the arrays beside its result."""
    frame = frame_of(request.target)
    frames = frames_of(frame, DIRECTIONS)
    sides = _sides(part, frames, turns=bool(frame))
    one = Filter(np.broadcast_to(np.float32(0), sides), 0.0)
    filters = {"filters": Array((frames.count, *sides), np.float32)}
    plane = 8 * frames.count * int(np.prod(shape[1:]))
    held = {**filters, "total": Array(tuple(shape), np.float64)}
    whole = {**filters, "whole": filters["filters"]}
    products = Stage("products", whole, 16 * frames.count * _PART + 8 * int(np.prod(sides)))
    beside = Stage("cut", held, 6 * plane + 8 * int(np.prod(shape)))
    return (products, *within(held, GaussianField([one]).stages(shape)), beside)


_PART = 1 << 16  # voxels of all filters that are multiplied at once


def _products(filters: Sequence[Filter]) -> np.ndarray:
    """Return the covariances of the fields of filters at one place, in their whole numbers.

    Every sum is one of whole numbers below 2^53: exact in any order.
    """
    table = quantiles(WHITE).astype(np.float64)
    whole = np.stack([integer_filter(one).reshape(-1).astype(np.float32) for one in filters])
    total = np.zeros((len(filters), len(filters)))
    for start in range(0, whole.shape[1], _PART):
        rows = whole[:, start : start + _PART].astype(np.float64)
        total += rows @ rows.T
    return total * float(np.mean(table**2))


def _sides(part: Filter, frames: TargetFrames, *, turns: bool) -> tuple[int, ...]:
    """Return the sides of the turned filters."""
    if not turns:
        return part.values.shape
    reach = [side // 2 for side in part.values.shape]
    largest = float(frames.sizes[-1])
    wide = [max(reach)] * 3 if len(frames.directions) else reach
    found = tuple(2 * max(1, math.ceil(far * largest)) + 1 for far in wide)
    if max(found) > 2 * MOST_REACH + 1:
        raise RequestError(
            f"the target makes the filter reach {max(found) // 2} voxels, {MOST_REACH} at most: "
            "ask for a smaller size, or give a shorter length or reach"
        )
    return found


def _turned_filters(part: Filter, frames: TargetFrames, *, turns: bool) -> list[Filter]:
    """Return the filter in every frame, each of the same power."""
    if not turns:
        return [part]
    sides = _sides(part, frames, turns=True)
    axis = principal_axis(part) if len(frames.directions) else np.eye(3)[0]
    found = []
    for number in range(frames.count):
        direction, size = frames.split(number)
        turn = np.eye(3) if direction is None else turn_onto(axis, direction)
        values = np.zeros(sides)
        turn_values(part.values.astype(np.float64), turn.T / size, values)
        values /= math.sqrt(float((values**2).sum()))
        found.append(Filter(values.astype(np.float32), part.clipped))
    return found


def _in_box(request: Request, name: str, box: Box) -> np.ndarray | None:
    """Return a target in a box; one number or direction as it is."""
    given = request.target.get(name)
    if given is None:
        return None
    values = np.asarray(given, np.float64 if np.ndim(given) < 2 else None)
    if values.ndim == (name == "orientation"):
        return values
    if name == "orientation":
        field_in(values[..., 0], box)  # checks that the box does not leave the field
        return values[tuple(slice(start, stop) for start, stop in box)]
    return np.asarray(field_in(values, box))
