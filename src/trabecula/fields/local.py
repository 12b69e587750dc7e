"""Local descriptors of an image as fields: volume fractions, Minkowski functionals, correlations,
apparent properties, orientation.

Every voxel, and every cube of 2x2x2 voxels, adds a number from a table (`measure.configurations`).
The sum over a window follows from the one beside it: a layer enters, a layer leaves. The tables are
converted to whole numbers first, so the sums are exact in any order, and the cost of a window does
not depend on its size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, as_spacing, check_name
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, phase_index
from trabecula.core.target import APPARENT, TWO_POINT, is_apparent
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.fields.apparent import WIDEST, apparent_windows
from trabecula.fields.grid import of_image
from trabecula.measure.configurations import (
    cube_euler,
    curvature_table,
    square_euler,
    surface_table,
)
from trabecula.measure.orientation import structure_tensor
from trabecula.measure.phases import as_connectivity, indicator

FUNCTIONALS = {2: ("perimeter", "euler"), 3: ("surface", "mean_curvature", "euler")}
"""Names of the Minkowski functionals beside the volume fraction, by dimension."""

_UNIT = 1 << 24  # the whole number that stands for 1 in a table


def windowed(
    values: Image | ArrayLike,
    *,
    size: int,
    names: str | Sequence[str] = ("volume_fraction",),
    phase: str | int | None = None,
    connectivity: int | None = None,
    spacing: float | Sequence[float] | None = None,
) -> dict[str, np.ndarray]:
    """Measure descriptors of every window of `size` voxels a side that is wholly inside.

    Parameters
    ----------
    values : Image or array of labels, (Z, Y, X) or (Y, X)
    size : int
        Side s of the windows in voxels, from 2 to the shortest side.
    names : str or sequence of str
        "volume_fraction" (of `phase`), "porosity" (of the phase void), "volume_fraction:PHASE" (of
        that phase), "two_point:R" (of `phase`, at R voxels, 1 .. s - 1, averaged over the axes),
        and in 3-D "surface", "mean_curvature", "euler", in 2-D "perimeter", "euler" (of `phase`).
        In 3-D also "apparent_conductivity" and "apparent_stiffness" (of `phase`, relative to its
        own; Poisson's ratio .3) and "apparent_diffusivity" (of the phase void), each the mean over
        the axes or along one, as in "apparent_stiffness:z": of a window by itself, as a cell of
        the periodic medium that mirrors of it build (`measure.conductivity`, `measure.stiffness`).
        Of windows of 64 voxels at most.
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        Neighbours within the phase. Default: those that share a face.
    spacing : float or one per axis, optional
        Voxel edges. Default: 1, so that densities are per voxel and the image's spacing is ignored;
        for apparent properties the image's.

    Returns
    -------
    fields : dict of str to (Z - s + 1, Y - s + 1, X - s + 1) float32
        Element (z, y, x) belongs to the window with first voxel (z, y, x). Fractions are of the s^3
        voxels, two-point functions of the pairs with both ends inside; functionals are densities
        over the (s - 1)^3 cubes of 2x2x2 voxels inside it, as those of `measure.minkowski` of the
        window. Conductivity and diffusivity are solved in windows at every eighth of s, stiffness
        at every half; between them they are interpolated (linearly, the quotient by the volume
        fraction, or of stiffness by conductivity).

    Raises
    ------
    InputError
        Not labels, or a window that does not fit.
    UnknownNameError
        No such descriptor in this dimension, or no such phase.

    Examples
    --------
    >>> bar = np.zeros((4, 5), np.uint8)
    >>> bar[:, 2:] = 1
    >>> windowed(bar, size=2, names=["volume_fraction"])["volume_fraction"][0]
    array([0. , 0.5, 1. , 1. ], dtype=float32)
    """
    image, inside = indicator(values, phase)
    width = int(as_number(size, name="size", low=2, high=1 << 20, whole=True))
    if width > min(image.shape):
        raise InputError(
            f"a window of {width} voxels does not fit into {image.shape}: give a smaller size"
        )
    names = [names] if isinstance(names, str) else [str(name) for name in names]
    for name in names:
        _check_descriptor(name, image)
        if is_apparent(name) and width > WIDEST:
            raise InputError(
                f"{name} is of windows of {WIDEST} voxels at most, asked for {width}: give a "
                "smaller size, or measure the property of a larger volume as a whole "
                "(tb.measure.conductivity, diffusivity, stiffness)"
            )
    edges = as_spacing(spacing, ndim=image.ndim)
    neighbours = as_connectivity(connectivity, image.ndim)
    codes = _codes(inside) if set(names) & set(FUNCTIONALS[image.ndim]) else None
    fields = {}
    for name in names:
        if name.startswith(TWO_POINT):
            fields[name] = _two_point(inside, _lag(name, width), width)
        elif is_apparent(name):
            void = name.startswith("apparent_diffusivity")
            carries = image.values == _label("porosity", image) if void else inside
            own = image.spacing if spacing is None else edges
            fields[name] = apparent_windows(
                carries, _fractions(carries, width), name, width=width, edges=own
            )
        elif codes is not None and name in FUNCTIONALS[image.ndim]:
            fields[name] = _mean_of(
                codes, _functional_table(name, edges, neighbours), [width - 1] * image.ndim
            )
        else:
            which = inside if name == "volume_fraction" else image.values == _label(name, image)
            fields[name] = _fractions(which, width)
    return fields


def measure(
    image: Image | ArrayLike,
    name: str = "volume_fraction",
    *,
    size: int,
    phase: str | int | None = None,
    connectivity: int | None = None,
) -> Image:
    """Measure a descriptor of the window around every voxel, on the image's grid.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    name : str
        As for `windowed`: "volume_fraction", "porosity", "volume_fraction:PHASE", "two_point:R",
        "surface" ("perimeter" in 2-D), "mean_curvature" (3-D), "euler", "apparent_stiffness:z".
    size : int
        Side of the windows in voxels.
    phase, connectivity
        As for `windowed`.

    Returns
    -------
    field : Image
        Grey, float32, the image's shape. Densities are per voxel. Windows are wholly inside: within
        half a window of a face the nearest such window counts.

    Raises
    ------
    InputError, UnknownNameError
        As `windowed`.

    Examples
    --------
    >>> steps = np.repeat([[0, 0, 0, 1, 1, 1]], 3, axis=0)
    >>> measure(steps, size=3).values[1].round(2)
    array([0.  , 0.  , 0.33, 0.67, 1.  , 1.  ], dtype=float32)
    """
    source = as_image(image)
    width = int(as_number(size, name="size", low=2, high=1 << 20, whole=True))
    options: dict[str, Any] = {"phase": phase, "connectivity": connectivity}
    windows = windowed(source, size=width, names=[name], **options)[name]
    # On the voxel in the middle of its window; the outermost values continue to the faces.
    field = np.pad(windows, [((width - 1) // 2, width // 2)] * windows.ndim, mode="edge")
    return of_image(field, "measure", {"name": name, "size": width, **options}, source)


def directions(
    image: Image | ArrayLike, *, sigma: float = 1.0, window: float = 4.0
) -> tuple[np.ndarray, np.ndarray]:
    """Measure the local orientation: the direction in which values change least, and its clarity.

    The eigenvector of the structure tensor's smallest eigenvalue (see `measure.orientation`).

    Parameters
    ----------
    image, sigma, window
        As for `measure.structure_tensor`.

    Returns
    -------
    vectors : (ndim, ...) float32
        Unit vectors in the order of the axes, the last component that is not 0 positive. 0 where
        nothing changes.
    clarity : (...) float32
        0 .. 1: in 2-D (l1 - l2) / (l1 + l2) of the eigenvalues l1 >= l2, in 3-D (l2 - l3) / l1.

    Raises
    ------
    InputError
        As `measure.structure_tensor`.
    """
    tensor = structure_tensor(image, sigma=sigma, window=window)
    ndim = len(tensor)
    vectors = np.empty((ndim, *tensor.shape[2:]), np.float32)
    clarity = np.empty(tensor.shape[2:], np.float32)
    # Slice by slice: eigenvectors in float64 take 24 times the memory of a field.
    for k in range(tensor.shape[2]):
        values, axes = np.linalg.eigh(
            np.moveaxis(tensor[:, :, k].astype(np.float64), (0, 1), (-2, -1))
        )
        most = values[..., -1] + (values[..., 0] if ndim == 2 else 0)
        apart = values[..., 1] - values[..., 0]
        clarity[k] = np.where(most > 0, apart / np.where(most > 0, most, 1), 0)
        least = np.moveaxis(axes[..., 0], -1, 0)
        sign = np.sign(least[0])
        for component in least[1:]:
            sign = np.where(component == 0, sign, np.sign(component))
        vectors[:, k] = np.where(most > 0, least * sign, 0)
    return vectors, clarity


def _check_descriptor(name: str, image: Image) -> None:
    """Raise where an image has no such descriptor."""
    head, sign, _ = name.partition(":")
    of_volumes = APPARENT if image.ndim == 3 else ()
    known = ("porosity", "volume_fraction", *FUNCTIONALS[image.ndim], *of_volumes)
    if head == "volume_fraction" and sign:
        _label(name, image)
        return
    if name.startswith(TWO_POINT) or (of_volumes and is_apparent(name)):
        return
    check_name(name, known, name=f"descriptor of {image.ndim}-D windows")


def _lag(name: str, width: int) -> int:
    """Return the distance in the name of a two-point function."""
    lag = name[len(TWO_POINT) :]
    if not lag.isascii() or not lag.isdigit() or not 1 <= int(lag) < width:
        raise InputError(
            f"the descriptor {name!r} should be two_point:R with R from 1 to {width - 1} voxels, "
            f"in windows of {width}"
        )
    return int(lag)


def _fractions(inside: np.ndarray, width: int) -> np.ndarray:
    """Return the share of every window that is inside, float32."""
    return _mean_of(inside.view(np.uint8), np.arange(256) == 1, [width] * inside.ndim)


def _two_point(inside: np.ndarray, lag: int, width: int) -> np.ndarray:
    """Return the share of pairs `lag` apart along the axes that are both inside, of every window,
    float32.
    """
    total = np.zeros([side - width + 1 for side in inside.shape], np.float32)
    for axis in range(inside.ndim):
        ends = [(slice(None),) * axis + (part,) for part in (slice(lag, None), slice(None, -lag))]
        pairs = inside[ends[0]] & inside[ends[1]]
        sides = [width - lag * (other == axis) for other in range(inside.ndim)]
        total += _mean_of(pairs.view(np.uint8), np.arange(256) == 1, sides)
    return total / np.float32(inside.ndim)


def _label(name: str, image: Image) -> int:
    """Return the label of the phase in the name of a fraction."""
    return phase_index(
        image, None if name == "porosity" else name.partition(":")[2], default="void"
    )


def _codes(inside: np.ndarray) -> np.ndarray:
    """Return the configuration of every cube (of every square in 2-D), uint8.

    Of shape (Z - 1, Y - 1, X - 1); 0..255 in 3-D, 0..15 in 2-D.
    """
    shape = tuple(side - 1 for side in inside.shape)
    codes = np.zeros(shape, np.uint8)
    for bit, corner in enumerate(np.ndindex((2,) * inside.ndim)):
        part = inside[tuple(slice(at, at + side) for at, side in zip(corner, shape, strict=True))]
        codes |= part.view(np.uint8) << np.uint8(bit)
    return codes


def _functional_table(name: str, spacing: tuple[float, ...], connectivity: int) -> np.ndarray:
    """Return the contribution (256,) of each configuration to a density; of squares, below 16."""
    flat = len(spacing) == 2
    if name in ("surface", "perimeter"):
        return surface_table((1.0, *spacing) if flat else spacing, flat=flat)
    if name == "mean_curvature":
        return curvature_table(spacing, connectivity)
    share = square_euler(connectivity)[np.arange(256) & 15] if flat else cube_euler(connectivity)
    return np.asarray(share / np.prod(spacing))


def _mean_of(codes: np.ndarray, table: np.ndarray, sides: Sequence[int]) -> np.ndarray:
    """Return the table's mean over every window of so many codes along the axes, float32."""
    deep = np.ascontiguousarray(codes if codes.ndim == 3 else codes[None])
    window = (1, 1, *sides)[-3:]
    largest = max(1.0, float(np.abs(table).max()))
    unit = _UNIT / largest  # voxels finer than the unit of length make large densities
    whole = np.rint(np.asarray(table, np.float64) * unit).astype(np.int64)
    places = [side - width + 1 for side, width in zip(deep.shape, window, strict=True)]
    means = np.empty(places, np.float32)
    scale = 1.0 / (unit * math.prod(window))
    for_slabs(
        lambda start, stop: _slide(deep, whole, window, scale, means, start, stop), len(means)
    )
    return means if codes.ndim == 3 else means[0]


@kernel
def _slide(codes, table, window, scale, means, start, stop):
    """Sum windows of codes: columns along z, rows of them, then windows."""
    depth, rows, width = window
    _, height, length = codes.shape
    columns = np.zeros((height, length), np.int64)
    band = np.zeros(length, np.int64)
    for z in range(start, start + depth - 1):
        for y in range(height):
            for x in range(length):
                columns[y, x] += table[codes[z, y, x]]
    for z in range(start, stop):
        for y in range(height):
            for x in range(length):
                columns[y, x] += table[codes[z + depth - 1, y, x]]
        band[:] = 0
        for y in range(height):
            for x in range(length):
                band[x] += columns[y, x]
            row = y - rows + 1
            if row < 0:
                continue
            total = np.int64(0)
            for x in range(length):
                total += band[x]
                if x >= width - 1:
                    means[z, row, x - width + 1] = total * scale
                    total -= band[x - width + 1]
            for x in range(length):
                band[x] -= columns[row, x]
        for y in range(height):
            for x in range(length):
                columns[y, x] -= table[codes[z, y, x]]
