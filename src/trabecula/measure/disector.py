"""The Euler number in space from parallel plane sections: the disector.

Between two near sections a body is taken to go on as a cylinder where both hold it. By the Euler
number of a union, a layer of thickness h between the sections S and T then has
(chi(S) + chi(T)) / 2 - chi(S and T), plane Euler numbers per area, over h: what begins, ends, joins
or parts between the sections (Sterio 1984, Journal of Microscopy 134; of serial sections Vogel
1997, European Journal of Soil Science 48). No isotropy is assumed. What is smaller
than h is missed, so h is a third of the thinnest bodies at most.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.measure.minkowski import euler_density
from trabecula.measure.phases import as_axis, indicator

GAP = 1000
"""Largest distance between sections, pixels."""

_SQUARE = 1e-6  # by which the edges of a pixel may differ, relative


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
    images = check_sections(sections, gap)
    inside = np.stack([indicator(image, phase)[1] for image in images])
    return _density(inside[:-1], inside[1:], gap * images[0].spacing[0], images[0].spacing)


def disector_along(
    image: Image | ArrayLike, *, gap: int, axis: int = 0, phase: str | int | None = None
) -> float:
    """Estimate the Euler number per volume of a volume from all pairs of its slices across an axis.

    What two sections of a material say is to be held against this, since both miss what is smaller
    than the gap.

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
    across = as_axis(axis, image.ndim)
    gap = int(as_number(gap, name="gap", low=1, high=GAP, whole=True))
    if image.ndim != 3 or image.shape[across] <= gap:
        raise InputError(
            f"a gap of {gap} needs a volume of more than {gap} slices, got {image.shape}: give a "
            "smaller gap"
        )
    slices = np.moveaxis(inside, across, 0)
    edges = tuple(edge for n, edge in enumerate(image.spacing) if n != across)
    return _density(slices[:-gap], slices[gap:], gap * image.spacing[across], edges)


def check_sections(sections: Sequence[Image | ArrayLike], gap: int) -> list[Image]:
    """Return parallel sections as images.

    Raises
    ------
    InputError
        Fewer than two; volumes; shapes or spacings that differ; pixels that are no squares; no
        whole gap of 1 or more, or one as long as a side.
    """
    as_number(gap, name="gap", low=1, high=GAP, whole=True)
    images = [as_image(section) for section in sections]
    if len(images) < 2:
        raise InputError(
            f"a gap lies between parallel sections, got {len(images)}: give two or more pictures, "
            "in their order, or gap=0"
        )
    first = images[0]
    for image in images:
        if image.ndim != 2 or image.shape != first.shape or image.spacing != first.spacing:
            raise InputError(
                f"parallel sections are pictures of one shape and spacing, got {first.shape} and "
                f"{image.shape}: register and crop them first"
            )
    if gap >= min(first.shape):
        raise InputError(
            f"a gap of {gap} pixels is as long as a side of sections of {first.shape}: give larger "
            "ones, nearer to each other"
        )
    if max(first.spacing) > min(first.spacing) * (1 + _SQUARE):
        raise InputError(
            f"the gap is in pixels, so they have to be squares, not {first.spacing}: resample the "
            "sections"
        )
    return images


def _density(lower: np.ndarray, upper: np.ndarray, height: float, edges: Sequence[float]) -> float:
    """Return the density from pairs of sections, (N, Y, X) bool each."""
    total = 0.0
    for one, other in zip(lower, upper, strict=True):
        mean = (_plane(one, edges) + _plane(other, edges)) / 2
        total += mean - _plane(one & other, edges)
    return total / (len(lower) * height)


def _plane(inside: np.ndarray, edges: Sequence[float]) -> float:
    """Return the Euler number per area of a section, neighbours share an edge."""
    return euler_density(Image(inside.astype(np.uint8), "labels", tuple(edges)), phase=1)
