"""Correlation length: the reach of what porosity alone does not explain."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.measure.correlation.pair_geometry import radial_limit
from trabecula.measure.correlation.two_point import two_point
from trabecula.measure.correlation.window import as_window
from trabecula.measure.phases import as_axis


def covariance_form(s2: ArrayLike) -> np.ndarray:
    """Return S2 without what porosity alone explains: (S2 - phi^2) / (phi - phi^2), with phi =
    S2(0).

    The autocovariance S2 - phi^2 of Torquato 2002, doi:10.1007/978-1-4757-6355-3, section 2.2, over
    its value at r = 0. `two_point` itself is in Torquato's normalisation, a probability that runs
    from phi to phi^2.

    Parameters
    ----------
    s2 : array, (R + 1,)
        Two-point probability, r = 0 .. R.

    Returns
    -------
    covariance : float64 array, (R + 1,)
        1 at r = 0, and 0 where the ends of a pair are independent; negative where the phase avoids
        itself. All 0 but the first where the phase is empty or alone.

    Raises
    ------
    InputError
        Not one curve of finite numbers.

    Examples
    --------
    >>> covariance_form([0.5, 0.375, 0.25, 0.0]).tolist()
    [1.0, 0.5, 0.0, -1.0]
    """
    values = _as_curve(s2)
    phi = values[0]
    if not 0 < phi < 1:
        return (np.arange(len(values)) == 0).astype(np.float64)
    return (values - phi**2) / (phi - phi**2)


def correlation_length(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    axis: int | None = None,
    r_max: int | None = None,
    periodic: bool | Sequence[bool] = False,
    mask: ArrayLike | None = None,
) -> float:
    """Return the distance from which the covariance of a phase stays below 1/e, in the image's
    unit.

    The covariance is `covariance_form` of `two_point`; its absolute value has to stay below 1/e up
    to `r_max`, so that a lattice, whose covariance swings back, is as long as its swings are
    strong. An image a few such lengths wide holds few independent parts, whatever its number of
    voxels.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    axis : int, optional
        Along this axis only. Default: radial.
    r_max : int, optional
        How far to look, in voxels (of the smallest edge). Default: half of the shortest extent (of
        `axis`).
    periodic, mask
        As in `two_point`.

    Returns
    -------
    length : float
        Interpolated linearly between voxels. Infinite where the covariance is still 1/e or more at
        `r_max`; 0 where the phase is empty or alone.

    Raises
    ------
    InputError
        As `two_point`.

    Examples
    --------
    >>> squares = np.kron(np.random.default_rng(1).integers(0, 2, (40, 40)), np.ones((8, 8), int))
    >>> round(correlation_length(squares, axis=1), 1)
    5.2
    """
    image = as_image(image)
    along = None if axis is None else as_axis(axis, image.ndim)
    edge = min(image.spacing) if along is None else image.spacing[along]
    if r_max is None:
        r_max = _half(image, along, radial_limit(image, as_window(image.shape, periodic, None)))
    s2 = two_point(image, r_max=r_max, phase=phase, axis=axis, periodic=periodic, mask=mask)
    return decay_length(s2) * edge


def decay_length(s2: ArrayLike) -> float:
    """Return the `correlation_length` of a curve that is there already, in steps of the curve."""
    curve = _as_curve(s2)
    if not 0 < curve[0] < 1:
        return 0.0
    return _last_crossing(np.abs(covariance_form(curve)), math.exp(-1))


def _as_curve(s2: ArrayLike) -> np.ndarray:
    try:
        values = np.asarray(s2, np.float64)
    except (TypeError, ValueError):
        values = np.zeros(0)
    if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
        raise InputError(
            "a two-point function is one row of finite numbers, S2(0) first: give what two_point "
            "returns"
        )
    return values


def _half(image: Image, axis: int | None, limit: int) -> int:
    """Return half of the shortest extent in units of the smallest edge, or half of one axis in its
    voxels.
    """
    if axis is not None:
        return image.shape[axis] // 2
    extents = [side * step for side, step in zip(image.shape, image.spacing, strict=True)]
    return min(int(min(extents) / min(image.spacing)) // 2, limit)


def _last_crossing(curve: np.ndarray, level: float) -> float:
    """Find where a curve falls below `level` for good, between its samples."""
    r = int(np.flatnonzero(curve >= level)[-1])
    if r == len(curve) - 1:
        return math.inf
    return float(r + (curve[r] - level) / (curve[r] - curve[r + 1]))
