"""Preference of a material for the axes of its grid: lines along the axes beside lines along the
diagonals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.measure.correlation.length import covariance_form
from trabecula.measure.correlation.two_point import two_point


def axis_preference(
    image: Image | ArrayLike, *, r_max: int = 30, phase: str | int | None = None
) -> float:
    """Return the difference of the covariance along the axes from that along the face diagonals; 0
    of an isotropic material.

    The covariance is `covariance_form` of `two_point`; the two are compared at the lengths that
    diagonals have, k sqrt(2), and the difference is an l2 norm over that of the mean of the two.
    Rods that grow along the axes of a grid raise it, which neither the radial two-point function
    nor those along the axes distinguish from a long-ranged material.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
        Of equal voxel edges.
    r_max : int
        Largest distance, voxels; 2 and more, lowered to half of the smallest side.
    phase : str or int, optional
        Default: "solid", which is every phase but "void".

    Returns
    -------
    preference : float
        0 and more. A finite image of an isotropic material has a little by chance: compare with
        another of its size.

    Raises
    ------
    InputError
        Edges that differ, sides below 4 voxels, r_max below 2.

    Examples
    --------
    >>> y, x = np.indices((64, 64))
    >>> bars, disks = (y // 8 + x // 8) % 2, (np.hypot(y % 16 - 8, x % 16 - 8) < 6).astype(int)
    >>> axis_preference(bars) > axis_preference(disks)
    True
    """
    image = as_image(image)
    if max(image.spacing) > min(image.spacing) * (1 + 1e-4):
        raise InputError(
            f"voxel edges {image.spacing} differ, so diagonals are of no one length: resample the "
            "image"
        )
    r_max = int(as_number(r_max, name="r_max", low=2, high=2**62, whole=True))
    reach = min(r_max, min(image.shape) // 2)
    if reach < 2:
        raise InputError(f"the image is {image.shape}: sides of at least 4 voxels are needed")
    axial = np.mean(
        [two_point(image, r_max=reach, phase=phase, axis=axis) for axis in range(image.ndim)],
        axis=0,
    )
    return preference(axial, two_point_diagonal(image, r_max=reach, phase=phase))


def two_point_diagonal(
    image: Image | ArrayLike, *, r_max: int, phase: str | int | None = None
) -> np.ndarray:
    """Return S2 along the face diagonals, mean over all of them.

    Sample k is k voxels along either axis away, k sqrt(2) <= r_max.
    """
    image = as_image(image)
    far = int(r_max / math.sqrt(2))
    return np.mean(
        [
            two_point(image, r_max=far, phase=phase, direction=way)
            for way in face_diagonals(image.ndim)
        ],
        axis=0,
    )


def face_diagonals(ndim: int) -> Sequence[tuple[int, ...]]:
    """Return the 2 diagonals of a square, the 6 of a cube's faces."""
    ways = []
    for first, second in combinations(range(ndim), 2):
        for sign in (1, -1):
            way = [0] * ndim
            way[first], way[second] = 1, sign
            ways.append(tuple(way))
    return ways


def preference(axial: ArrayLike, diagonal: ArrayLike) -> float:
    """Return the `axis_preference` of S2 that is there already: along the axes, r = 0 .. R, and
    along diagonals, k sqrt(2) <= R.
    """
    return preference_of(covariance_form(axial), covariance_form(diagonal))


def preference_of(axial: ArrayLike, diagonal: ArrayLike) -> float:
    """Return the `preference` of curves that are covariances, or autocorrelations: 1 at 0."""
    along, across = np.asarray(axial, np.float64), np.asarray(diagonal, np.float64)
    there = np.interp(np.sqrt(2) * np.arange(len(across)), np.arange(len(along)), along)
    size = float(np.linalg.norm((there + across)[1:] / 2))
    return float(np.linalg.norm((there - across)[1:])) / size if size > 0 else 0.0
