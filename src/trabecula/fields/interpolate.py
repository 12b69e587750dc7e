"""Inverse-distance interpolation: values that are known in places, everywhere.

Liu and Shapiro 2016, equation 7 (after Biswas, Shapiro, Tsukanov 2004,
doi:10.1016/j.cagd.2003.08.003): D(y) = sum_i D(y_i) / d(y, y_i)^p over sum_i 1 / d(y, y_i)^p. In a
domain that bends, d may be the way inside it (Fryazinov, Sanchez, Pasko 2015,
doi:10.1016/j.cag.2014.09.026).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, as_spacing, check_finite
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.core.recipe import digest
from trabecula.fields.geodesic import interior_distance
from trabecula.fields.grid import as_field, as_region, as_sides, middles, of_image
from trabecula.numerics.transforms import fast_side

_HIGHEST = 4.0  # power up to which sums by transform hold every weight that counts


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
    """A field from its values at some points (equation 7).

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
        The domain. Distances are then ways inside it, and points have to lie in it. What no way
        reaches, and what lies outside, goes by straight lines.
    spacing, unit
        Of the grid.

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
    if domain is not None:  # an array cannot be made again from a recipe, which then says so
        settings["mask"] = digest(domain.view(np.uint8))
    return as_field(field, "interpolate", settings, spacing=edges, unit=unit)


def fill(field: Image, known: ArrayLike, *, power: float = 4.0) -> Image:
    """A field that is known in a region, everywhere: equation 7 with every known voxel as a point.

    Parameters
    ----------
    field : Image
        Grey; what it holds where it is not known does not matter.
    known : bool array, the field's shape
        Where it counts, and stays as it is.
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
    if not isinstance(field, Image) or field.kind != "grey":
        raise InputError("fill needs a field as a grey Image: give tb.Image(array, kind='grey')")
    region = as_region(known, field.shape, name="known")
    power = as_number(power, name="power", low=0.5, high=_HIGHEST)
    held = np.where(region, field.values.astype(np.float64), 0)
    middle = float(held[region].mean())  # what is near 0 loses the least in the transforms
    above = _sums(np.where(region, held - middle, 0), field.spacing, power)
    below = _sums(region.astype(np.float64), field.spacing, power)
    found = middle + above / np.maximum(below, 1e-300)
    filled = np.where(region, held, found.clip(held[region].min(), held[region].max()))
    return of_image(filled, "fill", {"power": power, "known": digest(region.view(np.uint8))}, field)


def _sums(values: np.ndarray, spacing: tuple[float, ...], power: float) -> np.ndarray:
    """Sum over all other voxels of their values over distance^power (in the shortest edge)."""
    sides = [fast_side(2 * side - 1) for side in values.shape]
    squares: np.ndarray | float = 0.0
    for axis, (side, full, edge) in enumerate(zip(values.shape, sides, spacing, strict=True)):
        offset = np.minimum(np.arange(full), full - np.arange(full)) * (edge / min(spacing))
        offset[side : full - side + 1] = np.inf  # no two voxels are so far apart
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
