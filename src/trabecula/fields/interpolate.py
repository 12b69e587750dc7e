"""Interpolation: by inverse distance from points or a region, and linear onto another grid; and
rescaling to another range.

By inverse distance: Liu and Shapiro 2016, equation 7 (after Biswas, Shapiro, Tsukanov 2004,
doi:10.1016/j.cagd.2003.08.003): D(y) = sum_i D(y_i) / d(y, y_i)^p over sum_i 1 / d(y, y_i)^p. In a
domain that bends, d may be the length of the shortest path inside it (Fryazinov, Sanchez, Pasko
2015, doi:10.1016/j.cag.2014.09.026): the eikonal equation |grad t| = 1 by fast sweeping, upwind
differences of first order, updated in the eight orders of running through the axes (Zhao 2005,
doi:10.1090/S0025-5718-04-01678-3), until nothing changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, as_shape, as_spacing, check_finite
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.core.recipe import digest
from trabecula.engine.compile import inline, kernel
from trabecula.fields.grid import (
    as_field,
    as_region,
    as_sides,
    check_grey,
    history_of,
    middles,
    of_image,
    resample_array,
)
from trabecula.numerics.transforms import fast_side

_BALL = 4  # voxels around the source in which the straight line is taken, where all are inside
_CONVERGED = 1e-9  # largest change of the last round, in voxel edges
_MOST = 1000  # rounds; no form of a material has as many turns
_HIGHEST = 4.0  # power up to which sums by transform resolve all weights that matter


def interpolate(
    shape: int | Sequence[int],
    points: ArrayLike,
    values: ArrayLike,
    *,
    power: float = 4.0,
    mask: ArrayLike | None = None,
    spacing: float | Sequence[float] | None = None,
    unit: str = "voxel",
) -> Image:
    """Interpolate a field from its values at some points (equation 7).

    Parameters
    ----------
    shape : int or two or three ints
        Voxels along (z, y, x), or (y, x).
    points : (N, 3) or (N, 2) floats
        Positions from the first voxel's corner in the unit of the spacing: a voxel's middle is at
        (index + 0.5) * spacing.
    values : (N,) floats
    power : float
        p of equation 7, 0.5 .. 16. Higher: more like the nearest point's value.
    mask : bool array of `shape`, optional
        The domain. Distances are then lengths of paths inside it, and points have to be inside.
        Voxels that no path reaches, and those outside, take straight distances.
    spacing, unit
        Spacing and unit of the grid.

    Returns
    -------
    field : Image
        Grey, float32; between the least and the greatest value.

    Raises
    ------
    InputError
        Points, values or a mask that do not fit together; a point outside the mask.

    Examples
    --------
    >>> interpolate((1, 3), [(0.5, 0.5), (0.5, 2.5)], [0.0, 1.0]).values
    array([[0. , 0.5, 1. ]], dtype=float32)
    """
    sides = as_sides(shape)
    edges = as_spacing(spacing, ndim=len(sides))
    where, known = _as_points(points, values, len(sides))
    power = as_number(power, name="power", low=0.5, high=16)
    domain = _as_domain(mask, sides, where, edges)
    at = middles(sides, edges)
    above, below, exact = np.zeros(sides), np.zeros(sides), np.full(sides, np.nan)
    for place, value in track(list(zip(where, known, strict=True)), "interpolating"):
        apart = np.sqrt(sum((line - p) ** 2 for line, p in zip(at, place, strict=True)))
        if domain is not None:
            inner = interior_distance(domain, place, edges)
            apart = np.where(np.isfinite(inner), inner, apart)
        exact[apart == 0] = value
        weight = (min(edges) / np.where(apart == 0, np.inf, apart)) ** power
        above += weight * value
        below += weight
    field = np.where(np.isnan(exact), above / np.where(below > 0, below, 1), exact)
    field = field.clip(known.min(), known.max())
    settings: dict[str, Any] = {"shape": sides, "points": where, "values": known, "power": power}
    settings |= {"spacing": edges, "unit": unit}
    if domain is not None:  # an array cannot be replayed from a recipe: its digest says so
        settings["mask"] = digest(domain.view(np.uint8))
    return as_field(field, "interpolate", settings, spacing=edges, unit=unit)


def fill(field: Image, known: ArrayLike, *, power: float = 4.0) -> Image:
    """Fill in a field that is known in a region: equation 7 with every known voxel as a point.

    Parameters
    ----------
    field : Image
        Grey; its values where it is not known do not matter.
    known : bool array, the field's shape
        True where the field is known, and stays as it is.
    power : float
        p of equation 7, 0.5 .. 4. The sums are convolutions, so the number of voxels hardly
        matters.

    Returns
    -------
    field : Image
        Between the least and the greatest known value.

    Raises
    ------
    InputError
        Not grey; a region of another shape or type, or without a voxel.
    """
    check_grey(field)
    region = as_region(known, field.shape, name="known")
    power = as_number(power, name="power", low=0.5, high=_HIGHEST)
    held = np.where(region, field.values.astype(np.float64), 0)
    middle = float(held[region].mean())  # values near 0 lose the least in the transforms
    above = _sums(np.where(region, held - middle, 0), field.spacing, power)
    below = _sums(region.astype(np.float64), field.spacing, power)
    found = middle + above / np.maximum(below, 1e-300)
    filled = np.where(region, held, found.clip(held[region].min(), held[region].max()))
    return of_image(filled, "fill", {"power": power, "known": digest(region.view(np.uint8))}, field)


def _sums(values: np.ndarray, spacing: tuple[float, ...], power: float) -> np.ndarray:
    """Sum over all other voxels their values over distance^power, in units of the shortest edge."""
    sides = [fast_side(2 * side - 1) for side in values.shape]
    squares: np.ndarray | float = 0.0
    for axis, (side, full, edge) in enumerate(zip(values.shape, sides, spacing, strict=True)):
        offset = np.minimum(np.arange(full), full - np.arange(full)) * (edge / min(spacing))
        offset[side : full - side + 1] = np.inf  # padding: no two voxels are so far apart
        squares = squares + (offset**2).reshape(
            [-1 if k == axis else 1 for k in range(values.ndim)]
        )
    squares = np.asarray(squares)
    squares[(0,) * values.ndim] = np.inf
    axes = tuple(range(values.ndim))
    spectrum = np.fft.rfftn(squares ** (-power / 2), sides, axes) * np.fft.rfftn(
        values, sides, axes
    )
    return np.fft.irfftn(spectrum, sides, axes)[tuple(slice(side) for side in values.shape)]


def _as_points(points: ArrayLike, values: ArrayLike, ndim: int) -> tuple[np.ndarray, np.ndarray]:
    """Convert points (N, ndim) and values (N,) to float64, and check them."""
    try:
        where, known = np.array(points, np.float64), np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(
            "points and values are not made of numbers: give (N, 3) positions and N values"
        ) from None
    if where.ndim != 2 or where.shape[1] != ndim or not len(where):
        raise InputError(f"points have shape {where.shape}: give (N, {ndim}), slowest axis first")
    if known.shape != (len(where),):
        raise InputError(
            f"{len(where)} points have values of shape {known.shape}: give one number for each"
        )
    check_finite(where, name="points")
    check_finite(known, name="values")
    return where, known


def _as_domain(
    mask: ArrayLike | None, sides: tuple[int, ...], points: np.ndarray, edges: tuple[float, ...]
) -> np.ndarray | None:
    """Return the domain as a bool array, or None; check that all points are inside."""
    if mask is None:
        return None
    domain = as_region(mask, sides, name="the mask")
    for point in points:
        cell = np.floor(point / np.array(edges)).astype(np.int64)
        if (cell < 0).any() or (cell >= sides).any() or not domain[tuple(cell)]:
            raise InputError(
                f"the point {point.tolist()} lies outside the mask: no way inside leads from it"
            )
    return domain


def interior_distance(
    inside: np.ndarray, point: Sequence[float], spacing: Sequence[float]
) -> np.ndarray:
    """Return the length of the shortest path inside a domain from a point to every voxel's middle.

    Parameters
    ----------
    inside : (Z, Y, X) or (Y, X) bool
        The domain.
    point : one float per axis
        From the first voxel's corner, in the unit of the spacing; in a voxel of the domain.
    spacing : one float per axis
        Voxel edges.

    Returns
    -------
    distance : float64 array, the domain's shape
        Infinite outside the domain, and where no path leads. First order: up to some percent too
        long across the grid.
    """
    deep = np.ascontiguousarray(inside if inside.ndim == 3 else inside[None])
    edges = np.array(spacing if inside.ndim == 3 else (1.0, *spacing), np.float64)
    at = np.array(point if inside.ndim == 3 else (0.5, *point), np.float64)
    time = np.full(deep.shape, np.inf)
    held = _start_at(deep, at, edges, time)
    for _ in range(_MOST):
        if _sweep(deep, held, edges, time) <= _CONVERGED * edges.min():
            break
    return time if inside.ndim == 3 else time[0]


def _start_at(
    inside: np.ndarray, at: np.ndarray, edges: np.ndarray, time: np.ndarray
) -> np.ndarray:
    """Write straight distances around the source into `time`; return where, a bool array."""
    cell = np.clip((at / edges).astype(np.int64), 0, np.array(inside.shape) - 1)
    for reach in (_BALL, 1, 0):
        box = tuple(slice(max(0, c - reach), c + reach + 1) for c in cell)
        if inside[box].all() or reach == 0:
            break
    grid = np.meshgrid(
        *(np.arange(s.start, min(s.stop, n)) for s, n in zip(box, inside.shape, strict=True)),
        indexing="ij",
    )
    apart = [
        (index + 0.5) * edge - origin for index, edge, origin in zip(grid, edges, at, strict=True)
    ]
    time[box] = np.sqrt(sum(difference**2 for difference in apart))
    held = np.zeros(inside.shape, bool)
    held[box] = True
    return held


@inline
def _upwind(a, b, c, p, q, r):
    """Return the arrival time from neighbours at times a, b, c, at distances p, q, r on the axes.

    Solves ((t - a) / p)^2 + ((t - b) / q)^2 + ((t - c) / r)^2 = 1 over the neighbours before t.
    """
    if b < a:
        a, b, p, q = b, a, q, p
    if c < b:
        b, c, q, r = c, b, r, q
    if b < a:
        a, b, p, q = b, a, q, p
    t = a + p
    if t <= b:
        return t
    # The quadratic equation with two neighbours, and then with the third.
    u, v = 1.0 / (p * p), 1.0 / (q * q)
    square, line, rest = u + v, u * a + v * b, u * a * a + v * b * b - 1.0
    t = (line + np.sqrt(max(0.0, line * line - square * rest))) / square
    if t <= c:
        return t
    w = 1.0 / (r * r)
    square, line, rest = square + w, line + w * c, rest + w * c * c
    return (line + np.sqrt(max(0.0, line * line - square * rest))) / square


@kernel
def _sweep(inside, held, edges, time):
    """Update all times in the eight orders; return the largest change."""
    depth, height, width = time.shape
    largest = 0.0
    far = np.inf
    for order in range(8):
        for i in range(depth):
            z = i if order & 4 else depth - 1 - i
            for j in range(height):
                y = j if order & 2 else height - 1 - j
                for k in range(width):
                    x = k if order & 1 else width - 1 - k
                    if not inside[z, y, x] or held[z, y, x]:
                        continue
                    a = min(
                        time[z - 1, y, x] if z else far, time[z + 1, y, x] if z + 1 < depth else far
                    )
                    b = min(
                        time[z, y - 1, x] if y else far,
                        time[z, y + 1, x] if y + 1 < height else far,
                    )
                    c = min(
                        time[z, y, x - 1] if x else far, time[z, y, x + 1] if x + 1 < width else far
                    )
                    if min(a, b, c) == far:
                        continue
                    t = _upwind(a, b, c, edges[0], edges[1], edges[2])
                    if t < time[z, y, x]:
                        change = time[z, y, x] - t
                        largest = max(largest, change)
                        time[z, y, x] = t
    return largest


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
