"""Exact Euclidean distance, one axis after another.

Felzenszwalb and Huttenlocher 2012, "Distance transforms of sampled functions",
doi:10.4086/toc.2012.v008a019: the squared distance along a line is the lower envelope of parabolas.
Here every run of inside voxels is done alone, between the two outside voxels that bound it: no
parabola from beyond them can be lower, so short runs stay cheap and outside voxels cost nothing. A
periodic line is cut open at an outside voxel; only one without any is laid out twice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, as_spacing
from trabecula.core.errors import InputError
from trabecula.engine import memmap
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.phases import as_inside, as_periodic

_COLUMNS = 16  # lines gathered at once along y and z: a cache line of float32


def distance_transform(
    inside: ArrayLike,
    *,
    spacing: float | Sequence[float] | None = None,
    periodic: bool | Sequence[bool] = False,
) -> np.ndarray:
    """Return the distance of every inside voxel's centre to the centre of the nearest voxel that is
    not inside.

    Parameters
    ----------
    inside : bool array, (Z, Y, X) or (Y, X)
    spacing : float or sequence of float, optional
        Voxel edge along every axis. Default 1.
    periodic : bool or one per axis
        Distances wrap around the faces.

    Returns
    -------
    distance : float32 array, the shape of `inside`
        In the unit of `spacing`; 0 where not inside, infinite everywhere where every voxel is
        inside. The faces of the array are no boundary.

    Raises
    ------
    InputError
        Not boolean, wrong dimensions, bad spacing.

    Examples
    --------
    >>> distance_transform(np.array([[0, 1, 1, 1]], bool)).tolist()
    [[0.0, 1.0, 2.0, 3.0]]
    """
    solid = as_inside(inside)
    edges = as_spacing(spacing, ndim=np.ndim(inside))
    wraps = (False,) * (3 - len(edges)) + as_periodic(periodic, len(edges))
    edges = (1.0,) * (3 - len(edges)) + edges
    # In units of the smallest edge squares stay whole numbers for cubic voxels, hence exact.
    scale = min(edges[3 - np.ndim(inside) :])
    weights = [(edge / scale) ** 2 for edge in edges]
    depth, height, _ = solid.shape
    square = memmap.empty(solid.shape, np.float32)
    for_slabs(lambda a, b: _along_x(solid, square, weights[2], wraps[2], a, b), depth)
    if height > 1:
        for_slabs(lambda a, b: _along_lines(square, weights[1], wraps[1], a, b), depth)
    if depth > 1:
        for_slabs(
            lambda a, b: _along_lines(square.transpose(1, 0, 2), weights[0], wraps[0], a, b), height
        )

    def root(start: int, stop: int) -> None:
        np.sqrt(square[start:stop], out=square[start:stop])
        if scale != 1.0:
            square[start:stop] *= np.float32(scale)

    for_slabs(root, depth)
    return square.reshape(np.shape(inside))


def signed_distance(
    inside: ArrayLike,
    *,
    spacing: float | Sequence[float] | None = None,
    clip: float | None = None,
    periodic: bool | Sequence[bool] = False,
) -> np.ndarray:
    """Return the distance to the interface between inside and outside: positive inside, negative
    outside, 0 on the interface.

    The interface is half a voxel before the nearest voxel of the other side, so half the smallest
    edge is taken off `distance_transform` of either side: a voxel at a flat interface has +-h/2.

    Parameters
    ----------
    inside : bool array, (Z, Y, X) or (Y, X)
    spacing : float or sequence of float, optional
        Voxel edge along every axis. Default 1.
    clip : float, optional
        Limit the result to -clip .. clip, in the unit of `spacing`.
    periodic : bool or one per axis
        Distances wrap around the faces.

    Returns
    -------
    distance : float32 array, the shape of `inside`
        Infinite (or `clip`) everywhere where one side is empty.

    Raises
    ------
    InputError
        As `distance_transform`; a clip that is not positive.
    """
    if clip is not None and not as_number(clip, name="clip", low=-math.inf, high=math.inf) > 0:
        raise InputError(
            f"clip {clip} must be positive: give a distance in the unit of the spacing, or None"
        )
    solid = as_inside(inside)
    half = np.float32(min(as_spacing(spacing, ndim=np.ndim(inside))) / 2)
    solid = solid.reshape(np.shape(inside))
    result = distance_transform(solid, spacing=spacing, periodic=periodic)
    result -= distance_transform(~solid, spacing=spacing, periodic=periodic)
    # One of the two terms is 0 in every voxel, so half an edge goes off in the direction of the
    # sign.
    result -= np.where(solid, half, -half)
    return result if clip is None else np.clip(result, -clip, clip, out=result)


@kernel
def _along_x(inside, square, weight, wraps, start, stop):
    _, height, width = inside.shape
    for z in range(start, stop):
        for y in range(height):
            # Steps since the last outside voxel: of a periodic line, seen from beyond its start and
            # its end.
            since = until = np.inf
            if wraps:
                for x in range(width):
                    if not inside[z, y, x]:
                        since = width - 1.0 - x
                        until = min(until, np.float64(x))
            for x in range(width):
                since = since + 1.0 if inside[z, y, x] else 0.0
                square[z, y, x] = since
            for x in range(width - 1, -1, -1):
                until = until + 1.0 if inside[z, y, x] else 0.0
                nearest = min(until, np.float64(square[z, y, x]))
                square[z, y, x] = weight * nearest * nearest


@inline
def _envelope(value, vertex, base, bound, first, last, weight):
    """Replace value[first+1 .. last-1] by the lower envelope of the parabolas with apex value[q] at
    q in first..last.

    `vertex` holds the positions of the parabolas in the envelope, `base` their value + weight q^2,
    `bound` where each begins.
    """
    count = 0
    for q in range(first, last + 1):
        if value[q] == np.inf:
            continue
        height = value[q] + weight * q * q
        begin = -np.inf
        while count > 0:
            begin = (height - base[count - 1]) / (2.0 * weight * (q - vertex[count - 1]))
            if begin > bound[count - 1]:
                break
            count -= 1
        if count == 0:
            begin = -np.inf
        vertex[count] = q
        base[count] = height
        bound[count] = begin
        count += 1
    if count == 0:
        return
    bound[count] = np.inf
    at = 0
    for q in range(first, last + 1):
        while bound[at + 1] < q:
            at += 1
        value[q] = base[at] + weight * q * (q - 2.0 * vertex[at])


@inline
def _every_run(value, vertex, base, bound, length, weight):
    """Take every run of inside voxels of a line, with the outside voxels that bound it."""
    y = 0
    while y < length:
        if value[y] == 0.0:
            y += 1
            continue
        first = y - 1
        while y < length and value[y] != 0.0:
            y += 1
        _envelope(value, vertex, base, bound, max(first, 0), min(y, length - 1), weight)


@inline
def _every_run_around(value, turned, vertex, base, bound, length, weight):
    """Take every run as `_every_run`, on a line whose end is followed by its start."""
    begin = 0
    while begin < length and value[begin] != 0.0:
        begin += 1
    # From an outside voxel to its own image; without one, half a line more on either side is as far
    # as any way goes.
    count = length + 1
    if begin == length:
        begin = length - (length // 2 + 1)
        count = length + 2 * (length // 2 + 1)
    for y in range(count):
        turned[y] = value[(begin + y) % length]
    _every_run(turned, vertex, base, bound, count, weight)
    skip = (count - length) // 2
    for y in range(skip, skip + length):
        value[(begin + y) % length] = turned[y]


@kernel
def _along_lines(square, weight, wraps, start, stop):
    """Take every line along axis 1 of `square`, for indices start..stop of axis 0."""
    _, length, width = square.shape
    lines = np.empty((_COLUMNS, length))
    longest = 2 * length + 2 if wraps else length
    turned = np.empty(longest)
    vertex = np.empty(longest + 1, np.int64)
    base = np.empty(longest + 1)
    bound = np.empty(longest + 2)
    for z in range(start, stop):
        for x0 in range(0, width, _COLUMNS):
            columns = min(_COLUMNS, width - x0)
            for y in range(length):
                for x in range(columns):
                    lines[x, y] = square[z, y, x0 + x]
            for x in range(columns):
                if wraps:
                    _every_run_around(lines[x], turned, vertex, base, bound, length, weight)
                else:
                    _every_run(lines[x], vertex, base, bound, length, weight)
            for y in range(length):
                for x in range(columns):
                    square[z, y, x0 + x] = lines[x, y]
