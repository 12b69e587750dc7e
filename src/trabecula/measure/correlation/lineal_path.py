"""Whole segments in a phase."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image
from trabecula.measure.correlation.lagged_counts import (
    count_segments_ending,
    pack_lines,
    prepend_wrapped,
)
from trabecula.measure.correlation.window import as_window, check_pairs, check_range
from trabecula.measure.phases import as_axis, indicator


def lineal_path(
    image: Image | ArrayLike,
    *,
    r_max: int,
    phase: str | int | None = None,
    axis: int | None = None,
    periodic: bool | Sequence[bool] = False,
    mask: ArrayLike | None = None,
) -> np.ndarray:
    """Return the lineal path function L(r), r = 0 .. r_max: the probability that a segment of
    length r is wholly in the phase.

    Lu and Torquato 1992, doi:10.1103/PhysRevA.45.922. A segment of length r is r + 1 voxels in a
    row, r in voxels of its axis; the share is of the segments that fit into the image and its mask.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    r_max : int
        Largest length in voxels, below the side of every axis that is measured.
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    axis : int, optional
        Segments along this axis only. Default: along every axis, all segments taken together.
    periodic : bool or one per axis
        Segments wrap around the faces.
    mask : bool array, the image's shape, optional
        Only segments wholly in the mask count.

    Returns
    -------
    path : float64 array, (r_max + 1,)
        0 .. 1. L(0) is the fraction of the phase. Where all segments fit (periodic, no mask) L
        never rises.

    Raises
    ------
    InputError
        r_max that does not fit, or a length of which the mask holds no segment.

    Examples
    --------
    >>> lineal_path(np.array([[1, 1, 0, 1]]), r_max=1, axis=1).tolist()
    [0.75, 0.3333333333333333]
    """
    image, inside = indicator(image, phase)
    window = as_window(image.shape, periodic, mask)
    solid = window.within(inside)
    axes = (
        range(3 - image.ndim, 3) if axis is None else (as_axis(axis, image.ndim) + 3 - image.ndim,)
    )
    for along in axes:
        side = window.shape[along]
        check_range(r_max, side - 1, why=f"a side of {side} voxels (below it)")
    hits, fits = np.zeros(r_max + 1), np.zeros(r_max + 1)
    for along in axes:
        wrap = window.wraps[along]
        hits += _segments(solid, r_max, along, wrap)
        if window.where is not None:
            fits += _segments(window.where, r_max, along, wrap)
        else:
            fits += segments_that_fit(window.shape, r_max, along, wrap)
    check_pairs(fits, masked=mask is not None, what="segment with ends")
    return hits / fits


def _segments(inside: np.ndarray, r_max: int, axis: int, wrap: bool) -> np.ndarray:
    """Count the segments of r + 1 True voxels along an axis, r = 0 .. r_max."""
    before = r_max if wrap else 0
    return count_segments_ending(
        prepend_wrapped(pack_lines(inside, axis), before), r_max, before=before
    )


def segments_that_fit(shape: tuple[int, ...], r_max: int, axis: int, wrap: bool) -> np.ndarray:
    """Count the segments of r + 1 voxels along an axis that fit into an image of `shape`, r = 0 ..
    r_max.
    """
    side = shape[axis]
    return np.asarray(math.prod(shape) // side * (side - np.arange(r_max + 1) * (not wrap)))
