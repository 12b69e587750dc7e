"""The Euler number in space from parallel plane sections: the disector.

Between two near sections a body is taken to continue as a cylinder where both hold it. By the Euler
number of a union, a layer of thickness h between the sections S and T then has
(chi(S) + chi(T)) / 2 - chi(S and T), plane Euler numbers per area, over h: what begins, ends, joins
or parts between the sections (Gundersen, Boyce, Nyengaard, Odgaard 1993, Bone 14, 217-222; of
serial sections Vogel 1997, European Journal of Soil Science 48). No isotropy is assumed. What is
thinner than h is missed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.measure.configurations import count_cubes
from trabecula.measure.minkowski import densities
from trabecula.measure.phases import as_axis, indicator

GAP = 1000
"""Largest distance between sections, pixels."""

_SAME = 1e-6  # by which edges of pixels that count as equal may differ, relative


def disector_euler_density(
    sections: Sequence[Image | ArrayLike], *, gap: int, phase: str | int | None = None
) -> float:
    """Estimate the Euler number per volume from parallel plane sections.

    Parameters
    ----------
    sections : two or more Images or arrays of labels, (Y, X)
        Of one shape, each above the one before.
    gap : int
        Distance of a section to the next, pixels, 1 or more.
    phase : str or int, optional
        Default: "solid", which is every phase but "void".

    Returns
    -------
    density : float
        1 / length^3; neighbours share a face, as in `euler_density`.

    Raises
    ------
    InputError
        Sections that do not fit each other, or no such phase.

    Examples
    --------
    A hole that is in one section alone ends between the two: half a cavity.

    >>> empty, body = np.ones((2, 6, 6), np.uint8)
    >>> body[2:4, 2:4] = 0
    >>> round(disector_euler_density([empty, body], gap=1) * 25, 6)
    0.5
    """
    images, gap = check_sections(sections, gap)
    inside = np.stack([indicator(image, phase)[1] for image in images])
    return density_between(inside, images[0].spacing, height=gap * images[0].spacing[0])


def disector_along(
    image: Image | ArrayLike, *, gap: int, axis: int = 0, phase: str | int | None = None
) -> float:
    """Estimate the Euler number per volume of a volume from all pairs of its slices across an axis.

    What two sections of a material say is to be held against this, since both miss what is thinner
    than the gap. With a gap of 1 it is `euler_density`.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
    gap : int
        Distance of the slices of a pair, voxels, 1 or more.
    axis : int
    phase : str or int, optional
        Default: "solid".

    Returns
    -------
    density : float
        1 / length^3.

    Raises
    ------
    InputError
        Fewer slices than the gap needs, or no such phase.
    """
    image, inside = indicator(image, phase)
    across, gap = as_axis(axis, image.ndim), _as_gap(gap)
    if image.ndim != 3 or image.shape[across] <= gap:
        raise InputError(
            f"a gap of {gap} needs a volume of more than {gap} slices, got {image.shape}: give a "
            "smaller gap"
        )
    edges = tuple(edge for n, edge in enumerate(image.spacing) if n != across)
    slices, height = np.moveaxis(inside, across, 0), gap * image.spacing[across]
    return density_between(slices, edges, height=height, step=gap)


def density_between(
    slices: np.ndarray, edges: Sequence[float], *, height: float, step: int = 1
) -> float:
    """Return the Euler number per volume of the layers between slices and the `step`-th after them.

    Parameters
    ----------
    slices : (N, Y, X) bool
    edges : two floats
        Of a pixel.
    height : float
        Of a layer.
    step : int
    """
    pairs = zip(slices[:-step], slices[step:], strict=True)
    return float(np.mean([layer_euler(lower, upper, edges) for lower, upper in pairs]) / height)


def layer_euler(
    lower: np.ndarray, upper: np.ndarray, edges: Sequence[float], valid: np.ndarray | None = None
) -> float:
    """Return the Euler number per area of the layer between two slices.

    Parameters
    ----------
    lower, upper : (Y, X) bool
    edges : two floats
        Of a pixel.
    valid : (Y, X) bool, optional
        Pixels that count. NaN where four of them share no corner. Default: all.
    """
    counts = [count_cubes(inside, valid) for inside in (lower, upper, lower & upper)]
    if not counts[0].any():
        return math.nan
    # of a plane, whose neighbours share an edge
    ends = [densities(each, tuple(edges), 4).euler_density for each in counts]
    return (ends[0] + ends[1]) / 2 - ends[2]


def check_sections(sections: Sequence[Image | ArrayLike], gap: int) -> tuple[list[Image], int]:
    """Return parallel sections as images, and their gap as a whole number.

    Raises
    ------
    InputError
        Fewer than two; volumes; shapes, spacings or units that differ; pixels that are no squares;
        no whole gap of 1 or more, or one as long as a side.
    """
    gap = _as_gap(gap)
    images = [as_image(section) for section in sections]
    if len(images) < 2:
        raise InputError(
            f"a gap lies between parallel sections, got {len(images)}: give two or more pictures, "
            "in their order, or gap=0"
        )
    first = images[0]
    for image in images:
        if image.ndim != 2:
            raise InputError(
                f"parallel sections are pictures, got a volume of {image.shape}: give slices of it"
            )
        if image.shape != first.shape:
            raise InputError(
                f"parallel sections are of one shape, got {first.shape} and {image.shape}: "
                "register and crop them first"
            )
        if image.unit != first.unit or not np.allclose(
            image.spacing, first.spacing, rtol=_SAME, atol=0
        ):
            raise InputError(
                f"parallel sections have one spacing, got {first.spacing} {first.unit} and "
                f"{image.spacing} {image.unit}: give both their spacing, or resample one"
            )
    if gap >= min(first.shape):
        raise InputError(
            f"a gap of {gap} pixels is as long as a side of sections of {first.shape}: give larger "
            "ones, nearer to each other"
        )
    if max(first.spacing) > min(first.spacing) * (1 + _SAME):
        raise InputError(
            f"the gap is in pixels, so they have to be squares, not {first.spacing}: resample the "
            "sections"
        )
    return images, gap


def _as_gap(gap: int) -> int:
    return int(as_number(gap, name="gap", low=1, high=GAP, whole=True))
