"""Texture of grey and colour images: histograms, their divergence, and autocorrelation.

What the papers on texture synthesis compare: ten bins (Zhang, Chen, Wang, Wang 2017, section
5.3.2), the Kullback-Leibler divergence between histograms and the autocorrelation over 32 x 32 lags
(Urs, Da Costa, Germain 2014, section VI).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.measure.phases import as_mask
from trabecula.numerics.transforms import sums_by_offset

_LUMINANCE = np.array([0.299, 0.587, 0.114], np.float32)  # of red, green, blue: ITU-R BT.601
_TEN = (*range(0, 226, 25), 256)


def histogram(
    image: Image | ArrayLike,
    *,
    bins: int | Sequence[float] | None = None,
    mask: ArrayLike | None = None,
) -> np.ndarray:
    """Return the share of the voxels in every bin of grey levels; of a colour image, per channel.

    Parameters
    ----------
    image : Image
        Grey or colour; of labels, the shares of the phases (no `bins`).
    bins : int or rising edges, optional
        Default: 256. A number of bins divides 0..256 where values are uint8, else the range of the
        image's own values (such histograms compare only where the ranges agree: give edges). What
        is beyond the edges falls into the first or last bin.
    mask : bool array, the image's shape, optional
        Only these voxels.

    Returns
    -------
    shares : float64 array, (bins,), or (3, bins) for colour
        Every row sums to 1.

    Raises
    ------
    InputError
        A mask that does not fit or is empty, bins that are not rising.
    """
    image = as_image(image)
    region = as_mask(mask, image.shape)
    values = image.values if region is None else image.values[region]
    if image.kind == "labels":
        if bins is not None:
            raise InputError(
                "bins are of grey levels and the image is labels: leave bins out for the shares "
                "of its phases"
            )
        return np.bincount(values.ravel(), minlength=len(image.phases)) / values.size
    edges = _edges(image.values, 256 if bins is None else bins)
    if image.kind == "grey":
        return _shares(values, edges)
    return np.stack([_shares(values[..., channel], edges) for channel in range(3)])


def ten_bins(image: Image | ArrayLike) -> np.ndarray:
    """Return the histogram of the 2017 paper (section 5.3.2): bins of 25 levels of 0..255, the
    tenth from 225 to 255.

    Parameters
    ----------
    image : Image
        Grey of 0..255, or colour, (Z, Y, X) or (Y, X).

    Returns
    -------
    shares : float64 array, (10,), or (3, 10) for colour

    Raises
    ------
    InputError
        Labels, or values outside 0..255.
    """
    image = as_image(image)
    if image.kind == "labels":
        raise InputError("ten_bins is of grey levels and the image is labels: use volume_fractions")
    low, high = image.values.min(), image.values.max()
    if low < 0 or high >= 256:
        raise InputError(
            f"ten_bins is of levels 0..255 and the image runs from {low:g} to {high:g}: rescale it"
        )
    return histogram(image, bins=_TEN)


def kullback_leibler(p: ArrayLike, q: ArrayLike, *, floor: float = 1e-6) -> float:
    """Return the Kullback-Leibler divergence of histogram `p` from `q`: sum of p ln(p / q), in
    nats.

    Kullback and Leibler 1951, doi:10.1214/aoms/1177729694. A bin that is empty in q alone would
    make it infinite, so `floor` is added to every bin of both, and both are normalised again; 0
    leaves them as they are.

    Parameters
    ----------
    p, q : arrays, (bins,) or (channels, bins)
        Not negative; each row is normalised. Of several channels the mean is taken.
    floor : float

    Returns
    -------
    divergence : float
        >= 0; 0 only where the two are equal. Not symmetric.

    Raises
    ------
    InputError
        Shapes that differ, negative or empty rows.

    Examples
    --------
    >>> round(kullback_leibler([1, 1], [3, 1]), 4)
    0.1438
    """
    first, second = (np.atleast_2d(np.asarray(values, np.float64)) for values in (p, q))
    if first.shape != second.shape:
        raise InputError(
            f"the histograms have shapes {np.shape(p)} and {np.shape(q)}: use equal bins for both"
        )
    if not floor >= 0:
        raise InputError(f"floor {floor} must be 0 or more")
    for values in (first, second):
        if (
            not (values >= 0).all()
            or not np.isfinite(values).all()
            or not (values.sum(axis=1) > 0).all()
        ):
            raise InputError(
                "a histogram has finite bins, none negative, and is not empty: give shares or "
                "counts"
            )
    first, second = (_normalise(_normalise(values) + floor) for values in (first, second))
    # bins empty in p count nothing, in q alone infinity
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = np.where(first > 0, first * np.log(first / second), 0.0)
    return max(0.0, float(terms.sum(axis=1).mean()))


def autocorrelation(image: Image | ArrayLike, *, lags: int = 32) -> np.ndarray:
    """Return the autocorrelation of the grey level for all offsets up to `lags` along every axis.

    rho(k) = mean of (g(x) - m)(g(x + k) - m) over the variance, over the pairs that fit into the
    image; m and the variance are those of the whole image. Colour counts by its luminance, labels
    of two phases as 0 and 1.

    Parameters
    ----------
    image : Image
        Grey, colour or labels of two phases, (Z, Y, X) or (Y, X).
    lags : int
        In voxels; lowered to the side less one where an axis is shorter.

    Returns
    -------
    rho : float64 array, (2 lags + 1, ...)
        Offset 0 in the middle, where it is 1; symmetric about it. All else 0 for a constant image.

    Raises
    ------
    InputError
        Lags that are no whole number from 1 on, or labels of more than two phases.
    """
    image = as_image(image)
    lags = int(as_number(lags, name="lags", low=1, high=2**62, whole=True))
    values = grey_values(image)
    reach = [min(lags, side - 1) for side in values.shape]
    rho = np.zeros([2 * far + 1 for far in reach])
    middle = tuple(reach)
    values = near_one(values)
    values = values - np.float32(values.mean(dtype=np.float64))
    variance = float(np.mean(np.square(values, dtype=np.float64)))
    if variance > 0:
        rho = sums_by_offset(values, middle).astype(np.float64)
        for axis, (far, side) in enumerate(zip(reach, values.shape, strict=True)):
            pairs = side - np.abs(np.arange(-far, far + 1))
            rho /= pairs.reshape([-1 if a == axis else 1 for a in range(values.ndim)])
        rho = (rho + np.flip(rho)) / (2 * variance)
    rho[middle] = 1.0
    return rho


def grey_values(image: Image) -> np.ndarray:
    """Return grey levels as float32: of colour its luminance, of labels of two phases 0 and 1."""
    if image.kind == "colour":
        # one product after another: a product of matrices rounds as each machine's library does
        red, green, blue = (
            image.values[..., c].astype(np.float32) * _LUMINANCE[c] for c in range(3)
        )
        return red + green + blue
    if image.kind == "labels" and len(image.phases) > 2:
        raise InputError(
            f"the image has {len(image.phases)} phases, and their numbers are no grey levels: "
            "make one phase an image of "
            "its own (values == label)"
        )
    return image.values.astype(np.float32)


def near_one(values: np.ndarray) -> np.ndarray:
    """Multiply values by the power of two that makes the largest less than 1: exact, and their
    squares fit into float32.
    """
    return np.ldexp(values, -int(np.frexp(np.abs(values).max())[1]))


def _edges(values: np.ndarray, bins: int | Sequence[float]) -> np.ndarray:
    if isinstance(bins, (int, np.integer)) and not isinstance(bins, bool):
        if bins < 1:
            raise InputError(f"bins {bins} must be at least 1")
        if values.dtype == np.uint8:
            return np.linspace(0, 256, bins + 1)
        low, high = float(values.min()), float(values.max())
        return np.linspace(low, high if high > low else low + 1, bins + 1)
    try:
        edges = np.asarray(bins, np.float64)
    except (TypeError, ValueError):
        edges = np.zeros(0)
    if edges.ndim != 1 or len(edges) < 2 or not (np.diff(edges) > 0).all():
        raise InputError(
            f"bins {quote(bins)} are neither a whole number nor rising edges: give at least two "
            "numbers, each larger than the "
            "one before"
        )
    return edges


def _shares(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    count = len(edges) - 1
    if values.dtype == np.uint8:  # by its 256 levels: no search per voxel
        levels = np.bincount(values.ravel(), minlength=256)
        place = np.clip(np.searchsorted(edges, np.arange(256), side="right") - 1, 0, count - 1)
        return np.bincount(place, weights=levels, minlength=count) / values.size
    place = np.clip(np.searchsorted(edges, values.ravel(), side="right") - 1, 0, count - 1)
    return np.bincount(place, minlength=count) / values.size


def _normalise(values: np.ndarray) -> np.ndarray:
    return values / values.sum(axis=1, keepdims=True)
