"""Local orientation by the structure tensor: the direction in which grey levels change least.

The structure tensor is the product of the gradient with itself, averaged over a window (Bigun and
Granlund 1987; Jaehne 1993, "Spatio-Temporal Image Processing", doi:10.1007/3-540-57418-2). Its
eigenvector of the smallest eigenvalue is the local orientation: along a stripe or a fibre. Urs, Da
Costa and Germain 2014 (section VI) compare textures by the histogram of these.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.brief import brief
from trabecula.core.checks import as_number, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.grey import grey_values, near_one
from trabecula.measure.phases import check_sides
from trabecula.measure.smooth import gaussian


@dataclass(frozen=True)
class Orientation:
    """Histogram of local orientations."""

    shares: np.ndarray
    """(bins,) in 2-D, (rings, sectors) in 3-D; sums to 1, or is 0 where nothing has an orientation.
    """
    directions: np.ndarray
    """(..., ndim): unit vector in the middle of every bin, in the order of the axes, (y, x) or (z,
    y, x).
    """
    coherence: float
    """Mean weight of a voxel, 0..1: 0 no orientation anywhere, 1 perfect stripes or fibres."""

    __repr__ = brief


def structure_tensor(
    image: Image | ArrayLike, *, sigma: float = 1.0, window: float = 2.0
) -> np.ndarray:
    """Return gradient times gradient, averaged over a Gaussian window.

    Parameters
    ----------
    image : Image
        Grey, colour (its luminance) or labels of two phases, (Z, Y, X) or (Y, X).
    sigma, window : float
        Width of the Gaussian under the gradient, and of the window, in the largest voxel edge.

    Returns
    -------
    tensor : float32 array, (ndim, ndim, ...)
        In the order of the axes; grey levels squared per length squared, lengths in the image's
        unit.

    Raises
    ------
    InputError
        Sigma or window out of 0.3 .. 100, or an axis of one voxel.
    """
    image = _check_settings(image, sigma, window)
    return _tensor(grey_values(image), np.array(image.spacing), sigma, window)


def _tensor(values: np.ndarray, edges: np.ndarray, sigma: float, window: float) -> np.ndarray:
    per_axis = edges.max() / edges
    smooth = gaussian(values, sigma * per_axis)
    slopes = [np.gradient(smooth, edge, axis=axis) for axis, edge in enumerate(edges.tolist())]
    tensor = np.empty((values.ndim, values.ndim, *values.shape), np.float32)
    for i in range(values.ndim):
        for j in range(i + 1):
            tensor[i, j] = gaussian(slopes[i] * slopes[j], window * per_axis)
            tensor[j, i] = tensor[i, j]
    return tensor


def orientation(
    image: Image | ArrayLike,
    *,
    sigma: float = 1.0,
    window: float = 2.0,
    bins: int | tuple[int, int] | None = None,
) -> Orientation:
    """Return the histogram of the local orientation, the direction of least change.

    Every voxel counts by how clear its orientation is: in 2-D by the coherence (l1 - l2) / (l1 +
    l2) of the tensor's eigenvalues l1 >= l2, in 3-D by (l2 - l3) / l1, which is 0 in a plate, since
    a plate has no single direction.

    Parameters
    ----------
    image, sigma, window
        As for `structure_tensor`.
    bins : int or (rings, sectors), optional
        2-D: bins of the angle to the x axis, towards rising y, over 0 .. pi; default 36; bin 0 has
        its middle at 0. 3-D: bins of equal area over half the sphere about the z axis; default (6,
        12): ring 0 is next to the plane of y and x, sector 0 has its middle along x.

    Returns
    -------
    orientation : Orientation

    Raises
    ------
    InputError
        As for `structure_tensor`; bins below 1.
    """
    image = _check_settings(image, sigma, window)
    counts = _as_bins(bins, image.ndim)
    # Orientations know neither unit: with both near 1, squares of slopes fit into float32.
    tensor = _tensor(near_one(grey_values(image)), near_one(np.array(image.spacing)), sigma, window)
    sums = np.zeros((tensor.shape[2], *counts))
    if image.ndim == 2:
        for y in range(len(sums)):
            sums[y, 0] = _angles(tensor[:, :, y].astype(np.float64), counts[1])
    else:
        zz, yy, xx, zy, zx, yx = (
            tensor[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        )
        for_slabs(lambda a, b: _axes(zz, yy, xx, zy, zx, yx, sums, a, b), len(sums))
    total = sums.sum(axis=0)
    weight = float(total.sum())
    shares = total / weight if weight else total
    directions = _middles(*counts, image.ndim)
    if image.ndim == 2:
        shares, directions = shares[0], directions[0]
    return Orientation(shares, directions, weight / math.prod(image.shape))


def _check_settings(image: Image | ArrayLike, sigma: float, window: float) -> Image:
    image = as_image(image)
    as_number(sigma, name="sigma", low=0.3, high=100)
    as_number(window, name="window", low=0.3, high=100)
    check_sides(image.shape, what="has no gradient")
    return image


def _as_bins(bins: int | tuple[int, int] | None, ndim: int) -> tuple[int, int]:
    counts = np.ravel(bins if bins is not None else (36 if ndim == 2 else (6, 12)))
    if len(counts) != ndim - 1 or counts.dtype.kind not in "iu" or counts.min() < 1:
        raise InputError(
            f"bins {quote(bins)} do not fit: give "
            f"{'a number' if ndim == 2 else '(rings, sectors)'}, "
            "each at least 1"
        )
    return (1, int(counts[0])) if ndim == 2 else (int(counts[0]), int(counts[1]))


def _middles(rings: int, sectors: int, ndim: int) -> np.ndarray:
    """Return the directions in the middle of the bins, (rings, sectors, ndim)."""
    if ndim == 2:
        angle = np.pi * np.arange(sectors) / sectors
        return np.stack([np.sin(angle), np.cos(angle)], axis=-1)[None]
    height = (np.arange(rings)[:, None] + 0.5) / rings + np.zeros(sectors)
    angle = 2 * np.pi * np.arange(sectors) / sectors
    around = np.sqrt(1 - height**2)
    return np.stack([height, around * np.sin(angle), around * np.cos(angle)], axis=-1)


def _angles(tensor: np.ndarray, bins: int) -> np.ndarray:
    """Add the weights by angle of one row of pixels."""
    yy, yx, xx = tensor[0, 0], tensor[0, 1], tensor[1, 1]
    # The gradient's double angle is atan2(2 yx, xx - yy); least change is a quarter turn away.
    angle = 0.5 * np.arctan2(2 * yx, xx - yy) + np.pi / 2
    trace = xx + yy
    weight = np.hypot(xx - yy, 2 * yx) / np.where(trace > 0, trace, 1.0)
    place = np.floor(angle / np.pi * bins + 0.5).astype(np.int64) % bins
    return np.bincount(place, weights=weight, minlength=bins)


@inline
def _least(a, b, c, d, e, f):
    """Return (l2 - l3) / l1 and the unit eigenvector of l3 of [[a, d, e], [d, b, f], [e, f, c]], by
    the closed form; weight 0 where it has none.
    """
    mean = (a + b + c) / 3.0
    if mean <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    # Scaled to a trace of 3 and freed of it, so that the eigenvalues are 1 + 2 p cos(...).
    a, b, c = a / mean - 1.0, b / mean - 1.0, c / mean - 1.0
    d, e, f = d / mean, e / mean, f / mean
    p = np.sqrt((a * a + b * b + c * c + 2.0 * (d * d + e * e + f * f)) / 6.0)
    if p < 1e-6:
        return 0.0, 0.0, 0.0, 0.0
    det = a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)
    turn = np.arccos(min(1.0, max(-1.0, det / (2.0 * p * p * p)))) / 3.0
    low, high = 2.0 * p * np.cos(turn + 2.0 * np.pi / 3.0), 2.0 * p * np.cos(turn)
    # Rows of the matrix less `low` span the plane across the axis; the largest of their products is
    # safest.
    a, b, c = a - low, b - low, c - low
    nz, ny, nx = d * f - e * b, e * d - a * f, a * b - d * d
    best = nz * nz + ny * ny + nx * nx
    uz, uy, ux = d * c - e * f, e * e - a * c, a * f - d * e
    size = uz * uz + uy * uy + ux * ux
    if size > best:
        best, nz, ny, nx = size, uz, uy, ux
    uz, uy, ux = b * c - f * f, f * e - d * c, d * f - b * e
    size = uz * uz + uy * uy + ux * ux
    if size > best:
        best, nz, ny, nx = size, uz, uy, ux
    weight = (-high - low - low) / (1.0 + high)
    if weight <= 1e-6 or best == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    size = np.sqrt(best)
    return weight, nz / size, ny / size, nx / size


@kernel
def _axes(zz, yy, xx, zy, zx, yx, sums, begin, end):
    """Add the weight of every voxel to sums[slice, ring, sector] at its direction of least
    change.
    """
    _, rings, sectors = sums.shape
    _, height, width = zz.shape
    for z in range(begin, end):
        for y in range(height):
            for x in range(width):
                weight, nz, ny, nx = _least(
                    np.float64(zz[z, y, x]),
                    np.float64(yy[z, y, x]),
                    np.float64(xx[z, y, x]),
                    np.float64(zy[z, y, x]),
                    np.float64(zx[z, y, x]),
                    np.float64(yx[z, y, x]),
                )
                if weight == 0.0:
                    continue
                if nz < 0.0 or (nz == 0.0 and (ny < 0.0 or (ny == 0.0 and nx < 0.0))):
                    nz, ny, nx = -nz, -ny, -nx
                ring = min(int(nz * rings), rings - 1)
                sector = int(np.floor(np.arctan2(ny, nx) / (2.0 * np.pi) * sectors + 0.5)) % sectors
                sums[z, ring, sector] += weight
