"""Fabric: orientation of an interface, by mean intercept lengths.

Whitehouse 1974 (doi:10.1111/j.1365-2818.1974.tb03878.x) counts how often lines of a direction cross
the interface. Lines through voxels cross a staircase too often where they graze it, so here the
count comes from the interface's normals: an element of area dS with normal n is crossed by |n . d|
dS lines of direction d per unit of area across d. Normals and areas are those of the gradient of
the smoothed indicator, gathered in bins of direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.brief import brief
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.phases import check_sides, indicator
from trabecula.measure.smooth import gaussian

_BINS = 32  # along both sides of the square that the octahedron of directions unfolds to
_DIRECTIONS = 500
_SIGMA = 1.0  # of the smoothing, in the largest voxel edge


@dataclass(frozen=True)
class Fabric:
    """Mean intercept lengths as an ellipsoid (an ellipse in 2-D), in the order of the axes."""

    tensor: np.ndarray
    """(ndim, ndim), 1 / length^2: d . tensor . d is 1 / MIL(d)^2 for a direction d = (z, y, x)."""
    lengths: np.ndarray
    """(ndim,): principal mean intercept lengths, longest first; infinite where no line crosses."""
    directions: np.ndarray
    """(ndim, ndim): row k is the unit vector (z, y, x) of length k."""
    anisotropy: float
    """1 - smallest / largest eigenvalue of the tensor: 0 for no preferred direction, 1 for layers
    or straight fibres.
    """

    __repr__ = brief


def fabric(image: Image | ArrayLike, *, phase: str | int | None = None) -> Fabric:
    """Measure the mean intercept lengths of a phase and the rest, and their ellipsoid.

    MIL(d) is the length of lines of direction d over the number of times they cross the interface.
    The ellipsoid is the least-squares fit of 1 / MIL^2 = d . M . d over 500 directions spread
    evenly (Harrigan and Mann 1984, doi:10.1007/BF00540446); it is exact for aligned ellipsoids,
    whose MIL are as their axes.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
        Any spacing; the interface is smoothed over one voxel (of the largest edge).
    phase : str or int, optional
        Default: "solid", which is every phase but "void".

    Returns
    -------
    fabric : Fabric
        Lengths in the image's unit.

    Raises
    ------
    InputError
        No interface within the image, or a side below 4 voxels.

    Examples
    --------
    >>> layers = np.zeros((20, 20, 20), np.uint8)
    >>> layers[::10] = layers[1::10] = layers[2::10] = 1
    >>> round(fabric(layers).anisotropy, 6)
    1.0
    """
    image, inside = indicator(image, phase)
    check_sides(image.shape, least=4, what="is too thin for a fabric")
    lifted = inside.reshape((1,) * (3 - image.ndim) + image.shape)
    edges = (max(image.spacing),) * (3 - image.ndim) + image.spacing
    areas, volume = _normals(lifted, edges)
    areas = areas[:, 3 - image.ndim :]
    if not areas.any():
        raise InputError(
            "the image holds no interface: one phase fills it; choose another image or phase"
        )
    towards = spread_directions(_DIRECTIONS, image.ndim)
    crossings = np.abs(towards @ areas.T).sum(axis=1) / volume
    return _ellipsoid(towards, crossings)


def anisotropy(image: Image | ArrayLike, *, phase: str | int | None = None) -> float:
    """Return the degree of anisotropy (DA), 0 isotropic .. 1.

    1 - smallest / largest eigenvalue of the MIL tensor (see `fabric`).

    Eigenvalues are of 1 / MIL^2, as in BoneJ: 1 - (shortest / longest principal MIL)^2 (Harrigan
    and Mann 1984, doi:10.1007/BF00540446). Few structures in a small image raise it: some tenths
    are noise where it holds only a handful.

    Parameters
    ----------
    image, phase
        As for `fabric`.

    Returns
    -------
    anisotropy : float
        0..1, no unit.

    Raises
    ------
    InputError
        As `fabric`.
    """
    return fabric(image, phase=phase).anisotropy


def _normals(inside: np.ndarray, edges: tuple[float, ...]) -> tuple[np.ndarray, float]:
    """Return the area vectors of the interface summed by direction, (bins, 3), and the volume that
    they are of.
    """
    sigma = _SIGMA * max(edges) / np.array(edges)
    smooth = gaussian(inside, sigma)
    # Near the faces the smoothing knows no neighbours and bends normals.
    margin = [
        0 if side == 1 else max(1, min(math.ceil(2 * width), side // 4))
        for side, width in zip(inside.shape, sigma, strict=True)
    ]
    depth = inside.shape[0] - 2 * margin[0]
    sums = np.zeros((depth, _BINS * _BINS, 3))
    half = np.array([0.5 / edge for edge in edges])
    for_slabs(lambda a, b: _gather_normals(smooth, half, np.array(margin), sums, a, b), depth)
    cell = math.prod(edges)
    count = math.prod(side - 2 * off for side, off in zip(inside.shape, margin, strict=True))
    return sums.sum(axis=0) * cell, count * cell


def spread_directions(count: int, ndim: int = 3) -> np.ndarray:
    """Return directions (count, ndim) spread evenly over half a circle, or half a sphere (a
    Fibonacci lattice).
    """
    turn = np.arange(count) + 0.5
    if ndim == 2:
        half = np.pi * turn / count
        return np.stack([np.sin(half), np.cos(half)], axis=1)
    height = turn / count
    angle = np.pi * (1 + 5**0.5) * turn
    around = np.sqrt(1 - height**2)
    return np.stack([height, around * np.sin(angle), around * np.cos(angle)], axis=1)


def _ellipsoid(towards: np.ndarray, crossings: np.ndarray) -> Fabric:
    ndim = towards.shape[1]
    rows, columns = np.triu_indices(ndim)
    terms = towards[:, rows] * towards[:, columns] * np.where(rows == columns, 1.0, 2.0)
    entries = np.linalg.lstsq(terms, crossings**2, rcond=None)[0]
    tensor = np.zeros((ndim, ndim))
    tensor[rows, columns] = tensor[columns, rows] = entries
    value: np.ndarray
    value, vector = np.linalg.eigh(tensor)
    # The fit may go below 0 by a little where no line crosses; rounding alone is no crossing.
    value = np.where(value > 1e-12 * value[-1], value, 0.0)
    with np.errstate(divide="ignore"):
        lengths = 1 / np.sqrt(value)
    return Fabric(tensor, lengths, vector.T.copy(), float(1 - value[0] / value[-1]))


@kernel
def _gather_normals(smooth, half, margin, sums, begin, end):
    """Add every gradient to sums[slice, bin], turned so that its first component other than 0 is
    positive.
    """
    _, height, width = smooth.shape
    for k in range(begin, end):
        z = k + margin[0]
        for y in range(margin[1], height - margin[1]):
            for x in range(margin[2], width - margin[2]):
                gz = 0.0
                if margin[0]:
                    gz = half[0] * (smooth[z + 1, y, x] - smooth[z - 1, y, x])
                gy = half[1] * (smooth[z, y + 1, x] - smooth[z, y - 1, x])
                gx = half[2] * (smooth[z, y, x + 1] - smooth[z, y, x - 1])
                total = abs(gz) + abs(gy) + abs(gx)
                if total == 0.0:
                    continue
                if gz < 0.0 or (gz == 0.0 and (gy < 0.0 or (gy == 0.0 and gx < 0.0))):
                    gz, gy, gx = -gz, -gy, -gx
                # The upper half of an octahedron, turned by 45 degrees into a square.
                u, v = (gy + gx) / total, (gy - gx) / total
                i = min(int((u + 1.0) * 0.5 * _BINS), _BINS - 1)
                j = min(int((v + 1.0) * 0.5 * _BINS), _BINS - 1)
                row = sums[k, i * _BINS + j]
                row[0] += gz
                row[1] += gy
                row[2] += gx
