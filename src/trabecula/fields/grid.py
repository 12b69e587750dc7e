"""A field as an Image on its grid, with its recipe; and fields that are drawn on one: ramps, balls
and cylinders, formulas, pictures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, as_shape, as_spacing, check_finite, quote
from trabecula.core.errors import InputError
from trabecula.core.expression import Expression
from trabecula.core.image import Image
from trabecula.core.recipe import Recipe

AXES = {2: "yx", 3: "zyx"}

_FAR = 1e6  # no descriptor has a larger value


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


def part_region(mask: Image | ArrayLike | None, shape: tuple[int, ...]) -> np.ndarray:
    """Return the elements of a part, bool of `shape`: all where there is no mask, of an Image of
    labels all but the phase "void".
    """
    if mask is None:
        return np.ones(shape, bool)
    if isinstance(mask, Image) and mask.kind == "labels":
        mask = mask.values != (mask.phases.index("void") if "void" in mask.phases else 0)
    return as_region(mask, shape, name="the mask")


def as_marks(
    marks: Mapping[str, ArrayLike] | None, shape: tuple[int, ...]
) -> dict[str, np.ndarray]:
    """Return the elements that painted meshes go through by name, bool of `shape`, checked."""
    return {
        name: as_region(one, shape, name=f"mark {name!r}") for name, one in (marks or {}).items()
    }


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


def resample_array(values: np.ndarray, shape: Sequence[int]) -> np.ndarray:
    """Interpolate linearly between the voxels' middles, one axis after another, in float64."""
    found = np.asarray(values, np.float64)
    for axis, side in enumerate(shape):
        old = found.shape[axis]
        if old == side:
            continue
        at = np.clip((np.arange(side) + 0.5) * old / side - 0.5, 0, old - 1)
        found = take_between(found, at, axis)
    return found


def take_between(values: np.ndarray, at: np.ndarray, axis: int) -> np.ndarray:
    """Take places along an axis, 0 .. side - 1, between whole numbers by linear interpolation."""
    side = values.shape[axis]
    lower = np.minimum(at.astype(np.int64), max(side - 2, 0))
    upper = np.minimum(lower + 1, side - 1)
    share = (at - lower).reshape([-1 if k == axis else 1 for k in range(values.ndim)])
    return np.asarray(values.take(lower, axis) * (1 - share) + values.take(upper, axis) * share)


def ramp(
    shape: int | Sequence[int],
    *,
    axis: str | int = "z",
    start: float,
    end: float,
    spacing: float | Sequence[float] | None = None,
    unit: str = "voxel",
) -> Image:
    """Return a field that changes linearly from one face to the opposite one.

    Parameters
    ----------
    shape : int or two or three ints
        Voxels along (z, y, x), or (y, x); one number means a cube.
    axis : {"z", "y", "x"} or int
        Axis of the change.
    start, end : float
        Values of the first and the last voxel along it.
    spacing, unit
        Spacing and unit of the grid.

    Returns
    -------
    field : Image
        Grey, float32.

    Raises
    ------
    InputError
        No valid shape, axis or value.

    Examples
    --------
    >>> ramp((5, 1), axis="y", start=0.2, end=0.6).values.ravel()
    array([0.2, 0.3, 0.4, 0.5, 0.6], dtype=float32)
    """
    sides = as_sides(shape)
    along = as_axis(axis, len(sides))
    ends = _as_values(start=start, end=end)
    line = np.linspace(ends[0], ends[1], sides[along]).reshape(
        [-1 if k == along else 1 for k in range(len(sides))]
    )
    settings = {"shape": sides, "axis": AXES[len(sides)][along], "start": ends[0], "end": ends[1]}
    return _grid_field(np.broadcast_to(line, sides), "ramp", settings, spacing, unit)


def radial(
    shape: int | Sequence[int],
    *,
    inside: float,
    outside: float,
    radius: float | None = None,
    centre: Sequence[float] | None = None,
    axis: str | int | None = None,
    spacing: float | Sequence[float] | None = None,
    unit: str = "voxel",
) -> Image:
    """Return a field that changes linearly from a centre to a radius, and is constant beyond.

    Parameters
    ----------
    shape, spacing, unit
        As for `ramp`.
    inside, outside : float
        Values at the centre, and from the radius outwards.
    radius : float, optional
        In the unit of the spacing. Default: half the shortest side across the axis.
    centre : one float per axis, optional
        In the unit of the spacing, from the first voxel's corner. Default: the middle.
    axis : {"z", "y", "x"} or int, optional
        Measure the distance from the line along this axis (a cylinder). Default: from the point (a
        ball).

    Returns
    -------
    field : Image

    Raises
    ------
    InputError
        A radius that is not positive, or another invalid argument.

    Examples
    --------
    >>> radial((1, 5), inside=0, outside=1, radius=2, centre=(0.5, 2.5)).values
    array([[1. , 0.5, 0. , 0.5, 1. ]], dtype=float32)
    """
    sides = as_sides(shape)
    edges = as_spacing(spacing, ndim=len(sides))
    extent = [side * edge for side, edge in zip(sides, edges, strict=True)]
    line = None if axis is None else as_axis(axis, len(sides))
    counted = [k for k in range(len(sides)) if k != line]
    reach = min(extent[k] for k in counted) / 2 if radius is None else radius
    reach = as_number(reach, name="radius", low=1e-9 * max(extent), high=1e9 * max(extent))
    middle = _centre(centre, extent)
    squares = [(at - middle[k]) ** 2 for k, at in enumerate(middles(sides, edges)) if k != line]
    share = np.minimum(np.sqrt(sum(squares)) / reach, 1)
    ends = _as_values(inside=inside, outside=outside)
    settings = {
        "shape": sides,
        "inside": ends[0],
        "outside": ends[1],
        "radius": reach,
        "centre": middle,
        "axis": None if line is None else AXES[len(sides)][line],
    }
    return _grid_field(
        np.broadcast_to(ends[0] + (ends[1] - ends[0]) * share, sides),
        "radial",
        settings,
        spacing,
        unit,
    )


def _centre(centre: Sequence[float] | None, extent: list[float]) -> list[float]:
    """Return the centre, one number an axis; the middle for None."""
    if centre is None:
        return [length / 2 for length in extent]
    found = [
        as_number(at, name="centre", low=-1e9, high=1e9)
        for at in np.atleast_1d(np.asarray(centre, object))
    ]
    if len(found) != len(extent):
        raise InputError(f"centre has {len(found)} numbers: give {len(extent)}, slowest axis first")
    return found


def formula(
    shape: int | Sequence[int],
    text: str,
    *,
    spacing: float | Sequence[float] | None = None,
    unit: str = "voxel",
) -> Image:
    """Return a field by a formula of the position.

    Parameters
    ----------
    shape, spacing, unit
        As for `ramp`.
    text : str
        A formula in z, y, x (position of a voxel's middle, in the unit of the spacing, from the
        first face) and Z, Y, X (the sides of the grid in that unit), parsed by
        `core.expression.Expression`: "0.3 + 0.2 * z / Z".

    Returns
    -------
    field : Image

    Raises
    ------
    InputError
        A formula that cannot be parsed, or without a finite value somewhere.
    UnknownNameError
        An unknown name or function.

    Examples
    --------
    >>> formula((2, 4), "0.2 if x < X / 2 else y").values
    array([[0.2, 0.2, 0.5, 0.5],
           [0.2, 0.2, 1.5, 1.5]], dtype=float32)
    """
    sides = as_sides(shape)
    edges = as_spacing(spacing, ndim=len(sides))
    letters = AXES[len(sides)]
    parsed = Expression(text, (*letters, *letters.upper()))
    values = dict(zip(letters, middles(sides, edges), strict=True))
    extent = {
        letter.upper(): side * edge
        for letter, side, edge in zip(letters, sides, edges, strict=True)
    }
    found = np.broadcast_to(parsed(**values, **extent), sides)
    if not np.isfinite(found).all():
        bad = tuple(int(i) for i in np.argwhere(~np.isfinite(found))[0])
        raise InputError(
            f"the formula {text!r} has no finite value at voxel {bad}: give one that has"
        )
    return _grid_field(found, "formula", {"shape": sides, "text": text}, spacing, unit)


def picture(
    image: Image | ArrayLike,
    shape: int | Sequence[int],
    *,
    low: float,
    high: float,
    axis: str | int = "z",
    spacing: float | Sequence[float] | None = None,
    unit: str = "voxel",
) -> Image:
    """Return a field from a picture: black is `low`, white is `high`, the same at every depth.

    Parameters
    ----------
    image : Image or array, (Y, X) or colour
        Stretched over the faces across `axis`; colour is averaged over its channels. 0 and 255 are
        black and white of uint8, else the picture's least and greatest values.
    shape : int or two or three ints
        Shape of the field; with two numbers the picture is the field.
    low, high : float
        Values of black and white.
    axis : {"z", "y", "x"} or int
        The direction of view.
    spacing, unit
        Spacing and unit of the grid.

    Returns
    -------
    field : Image

    Raises
    ------
    InputError
        Not a picture, or no valid shape.
    """
    source = image if isinstance(image, Image) else Image(np.asarray(image), "grey")
    if source.ndim != 2:
        raise InputError(
            f"a field is drawn by a picture, got a volume of shape {source.shape}: give one slice "
            "of it"
        )
    sides = as_sides(shape)
    ends = _as_values(low=low, high=high)
    grey = source.values.astype(np.float64)
    grey = grey.mean(axis=-1) if source.kind == "colour" else grey
    black, white = (
        (0.0, 255.0)
        if source.values.dtype == np.uint8 and source.kind != "labels"
        else (grey.min(), grey.max())
    )
    share = (grey - black) / max(white - black, 1e-300)
    flat = len(sides) == 2
    along = 0 if flat else as_axis(axis, 3)
    face = sides if flat else tuple(side for k, side in enumerate(sides) if k != along)
    drawn = ends[0] + (ends[1] - ends[0]) * resample_array(share, face)
    deep = drawn if flat else np.broadcast_to(np.expand_dims(drawn, along), sides)
    edges = as_spacing(spacing, ndim=len(sides))
    settings = {
        "shape": sides,
        "low": ends[0],
        "high": ends[1],
        "axis": AXES[3][along],
        "spacing": edges,
        "unit": unit,
    }
    return as_field(deep, "picture", settings, spacing=edges, unit=unit, before=history_of(source))


def _as_values(**values: float) -> list[float]:
    """Return the values, each checked under its name."""
    return [as_number(value, name=name, low=-_FAR, high=_FAR) for name, value in values.items()]


def _grid_field(
    values: np.ndarray,
    make: str,
    settings: dict,
    spacing: float | Sequence[float] | None,
    unit: str,
) -> Image:
    edges = as_spacing(spacing, ndim=values.ndim)
    return as_field(
        values, make, {**settings, "spacing": edges, "unit": unit}, spacing=edges, unit=unit
    )
