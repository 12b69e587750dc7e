"""Fields of directions: read, drawn by formulas, continued, smoothed, resampled; and the local
fabric of an image, to compare with one.

A direction is known up to its sign, so fields are averaged as dyads d d^T: the principal axis of
the mean dyad is the direction that fits best.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, as_path_text, as_spacing
from trabecula.core.directions import Directions, as_directions
from trabecula.core.errors import InputError
from trabecula.core.expression import Expression
from trabecula.core.image import Image, as_image
from trabecula.core.recipe import Recipe
from trabecula.fields.grid import as_sides, middles, resample_array
from trabecula.io.guard import check_there, report_damage
from trabecula.measure.fabric import fabric
from trabecula.measure.smooth import gaussian

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def read_directions(path: str | os.PathLike[str]) -> Directions:
    """Read a field of directions: an array (Z, Y, X, 3) in a .npy file, components z, y, x.

    Raises
    ------
    FileError
        No file, or a damaged one.
    InputError
        Another shape, NaN.
    """
    name = as_path_text(path)
    check_there(Path(name))
    with report_damage(Path(name), "a field of directions"):
        values = np.load(name, allow_pickle=False)
    found = as_directions(values, None, name=name)
    return Directions(found, Recipe().then("read_directions", found, source=name))


def direction_formula(
    shape: int | Sequence[int],
    formulas: Sequence[str],
    *,
    spacing: float | Sequence[float] | None = None,
) -> Directions:
    """Draw a field of directions by formulas of its components z, y, x, as those of `formula`.

    Parameters
    ----------
    shape : int or three ints
    formulas : three str
        In the positions z, y, x of the voxels' middles and the sides Z, Y, X of the whole. Only the
        direction of the vector matters.
    spacing : float or three floats, optional
        Voxel edges; default 1.

    Raises
    ------
    InputError
        Not three formulas, or one that is none.

    Examples
    --------
    >>> turning = direction_formula((3, 3, 3), ("cos(z)", "sin(z)", "0"))
    >>> turning.values[0, 0, 0].round(2).tolist()
    [0.88, 0.48, 0.0]
    """
    sides = as_sides(shape)
    if len(sides) != 3 or isinstance(formulas, str) or len(formulas) != 3:
        raise InputError("directions are of a volume: give three sides and three formulas, z y x")
    edges = as_spacing(spacing, ndim=3)
    values = dict(zip("zyx", middles(sides, edges), strict=True))
    names = dict(zip("ZYX", np.array(sides) * edges, strict=True))
    parts = [Expression(text, tuple("zyxZYX"))(**values, **names) for text in formulas]
    return Directions(np.stack([np.broadcast_to(one, sides) for one in parts], axis=-1))


def continue_directions(directions: Directions | ArrayLike) -> Directions:
    """Continue a field to where it has no direction, from the voxels beside, layer by layer.

    Raises
    ------
    InputError
        No direction anywhere.
    """
    values = _values(directions).copy()
    if not values.any():
        raise InputError("the field has no direction anywhere: there is nothing to continue")
    while not (known := values.any(axis=-1)).all():
        sums = np.zeros((6, *values.shape[:-1]), np.float32)
        dyads = _dyads(values)
        for axis in range(1, 4):
            first = (slice(None),) * axis
            sums[(*first, slice(1, None))] += dyads[(*first, slice(None, -1))]
            sums[(*first, slice(None, -1))] += dyads[(*first, slice(1, None))]
        fresh = ~known & (sums[:3].sum(axis=0) > 0)
        values[fresh] = _principal(sums[:, None, fresh])[0]
    return Directions(values)


def smooth_directions(
    directions: Directions | ArrayLike,
    *,
    sigma: float,
    weights: ArrayLike | None = None,
) -> Directions:
    """Smooth a field: the principal axis of the dyads averaged over a Gaussian window.

    Parameters
    ----------
    directions : Directions or (Z, Y, X, 3) array
        Where it is 0 it takes what is around it.
    sigma : float
        Width of the window in voxels, 0.3 .. 100.
    weights : (Z, Y, X) array, optional
        How much each voxel counts, such as its stress.

    Raises
    ------
    InputError
        A width out of range, weights of another shape or below 0.
    """
    values = _values(directions)
    width = as_number(sigma, name="sigma", low=0.3, high=100)
    dyads = _dyads(values)
    if weights is not None:
        counts = np.asarray(weights, np.float32)
        if counts.shape != values.shape[:-1] or not (counts >= 0).all():
            raise InputError(
                f"weights have shape {counts.shape}: give numbers of at least 0 of shape "
                f"{values.shape[:-1]}"
            )
        dyads *= counts
    mean = np.stack([gaussian(one, np.full(3, width)) for one in dyads])
    return Directions(_principal(mean))


def resample_directions(
    directions: Directions | ArrayLike, shape: int | Sequence[int]
) -> Directions:
    """Resample a field to another grid of the same volume: dyads are interpolated linearly."""
    sides = as_sides(shape)
    dyads = _dyads(_values(directions))
    return Directions(_principal(np.stack([resample_array(one, sides) for one in dyads])))


def fabric_directions(
    image: Image | ArrayLike, *, size: int, phase: str | int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Measure the principal fabric direction of windows that lie side by side.

    The longest mean intercept of every window (see `measure.fabric`).

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
    size : int
        Side of the windows in voxels, at least 8.
    phase : str or int, optional
        Default: "solid".

    Returns
    -------
    directions : (nz, ny, nx, 3) float32
        Unit vectors; 0 where a window holds no interface.
    anisotropy : (nz, ny, nx) float32
        Of the windows, 0 .. 1.

    Raises
    ------
    InputError
        Not a volume, or a window that does not fit.
    """
    image = as_image(image)
    width = int(as_number(size, name="size", low=8, high=1 << 20, whole=True))
    if image.ndim != 3 or width > min(image.shape):
        raise InputError(f"a window of {width}^3 voxels does not fit into {image.shape}")
    counts = tuple(side // width for side in image.shape)
    found = np.zeros((*counts, 3), np.float32)
    degree = np.zeros(counts, np.float32)
    for place in product(*map(range, counts)):
        part = image[tuple(slice(k * width, (k + 1) * width) for k in place)]
        try:
            measured = fabric(part, phase=phase)
        except InputError:
            continue
        found[place], degree[place] = measured.directions[0], measured.anisotropy
    return found, degree


def direction_errors(
    image: Image | ArrayLike,
    orientation: Directions | ArrayLike,
    *,
    size: int,
    phase: str | int | None = None,
    inside: ArrayLike | None = None,
) -> np.ndarray:
    """Measure the angle between the local fabric of an image and a field of directions.

    Parameters
    ----------
    image, size, phase
        As of `fabric_directions`.
    orientation : Directions, (Z, Y, X, 3) array or three numbers
        What it is to have; a window is to have the principal axis of its mean dyad.
    inside : (Z, Y, X) bool array, optional
        Windows that are not wholly inside do not count.

    Returns
    -------
    degrees : (nz, ny, nx) float64
        0 .. 90; NaN for windows that do not count.
    """
    have, _ = fabric_directions(image, size=size, phase=phase)
    shape = as_image(image).shape
    given = orientation.values if isinstance(orientation, Directions) else orientation
    wanted = np.broadcast_to(as_directions(given, shape, name="the orientation"), (*shape, 3))
    dyads = np.stack([window_means(one, size) for one in _dyads(wanted)])
    cosine = np.abs(np.einsum("...i,...i->...", have, _principal(dyads)))
    angles = np.degrees(np.arccos(np.clip(cosine, 0, 1)))
    counts = have.any(axis=-1)
    if inside is not None:
        counts &= window_means(np.asarray(inside, np.float32), size) > 1 - 1e-6
    return np.where(counts, angles, np.nan)


def window_means(values: np.ndarray, size: int) -> np.ndarray:
    """Return the means of windows of `size` voxels a side that lie side by side, float64."""
    counts = [side // size for side in values.shape]
    part = values[tuple(slice(0, n * size) for n in counts)]
    pairs: list[int] = [k for n in counts for k in (n, size)]
    return np.asarray(part.reshape(pairs).mean(axis=(1, 3, 5), dtype=np.float64))


def _values(directions: Any) -> np.ndarray:
    if isinstance(directions, Directions):
        return directions.values
    return as_directions(directions, None, name="directions")


def _dyads(values: np.ndarray) -> np.ndarray:
    """Return the six entries of d d^T, (6, Z, Y, X) float32."""
    return np.stack([values[..., i] * values[..., j] for i, j in _PAIRS]).astype(np.float32)


def _principal(dyads: np.ndarray) -> np.ndarray:
    """Return the eigenvectors of the largest eigenvalue, (..., 3) float32; 0 where there is none.

    Plane by plane, since eigenvectors in float64 take many times the memory of a field.
    """
    found = np.zeros((*dyads.shape[1:], 3), np.float32)
    for k in range(dyads.shape[1]):
        tensor = np.zeros((*dyads.shape[2:], 3, 3))
        for entry, (i, j) in zip(dyads[:, k], _PAIRS, strict=True):
            tensor[..., i, j] = tensor[..., j, i] = entry
        vectors = np.linalg.eigh(tensor)[1][..., 2]
        some = dyads[:3, k].sum(axis=0) > 0
        found[k] = np.where(some[..., None], vectors, 0)
    return found
