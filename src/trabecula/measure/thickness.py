"""Thickness: largest inscribed spheres, and chords.

Local thickness (Hildebrand and Ruegsegger 1997, doi:10.1046/j.1365-2818.1997.1340694.x): at a
point, the diameter of the largest sphere that fits into the phase and holds the point. Three steps:

1. the distance of every voxel of the phase to the rest;
2. the ridge: voxels whose sphere is not inside a neighbour's;
3. the ridge's spheres are painted from the largest down; a voxel once painted keeps its value
   (`measure.spheres`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.measure.distance import distance_transform
from trabecula.measure.phases import as_axis, as_periodic, indicator_in_mask
from trabecula.measure.spheres import paint_largest


def local_thickness(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> np.ndarray:
    """Return the diameter of the largest sphere in the phase that holds the voxel.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    mask : bool array, the image's shape, optional
        Voxels beyond it are neither phase: they bound no sphere, as if a face were there, and none
        is centred on one.
    periodic : bool or one per axis
        Distances and spheres wrap around the faces.

    Returns
    -------
    diameter : float32 array, the image's shape
        In the image's unit; 0 outside the phase and the mask. The faces of the image bound nothing,
        so what they cut may look thicker.

    Raises
    ------
    InputError
        The phase fills the whole image (or mask), so that nothing bounds it.

    Notes
    -----
    Centres of spheres are voxels and the distance ends at a voxel's centre, so 2 d overshoots a
    plate of an odd number of voxels by 1 and meets one of an even number; 2 d less half a voxel is
    off by half a voxel in either case, and right on average.
    """
    image, inside, region = indicator_in_mask(image, phase, mask)
    return sphere_diameters(
        inside, region, image.spacing, as_periodic(periodic, image.ndim), what="phase"
    )


def thickness(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> float:
    """Return the mean local thickness over the voxels of a phase (default "solid"), in the image's
    unit; 0 where the phase is empty.

    See `local_thickness` for the definition (Hildebrand and Ruegsegger 1997,
    doi:10.1046/j.1365-2818.1997.1340694.x) and its error of half a voxel.

    Parameters
    ----------
    image, phase, mask, periodic
        As for `local_thickness`; the mean is over the phase's voxels in the mask.

    Returns
    -------
    thickness : float

    Raises
    ------
    InputError
        As `local_thickness`.
    """
    return _mean_diameter(image, phase, "solid", mask, periodic)


def pore_size(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> float:
    """Return the mean local thickness over the voxels of the void (or of the phase given), in the
    image's unit; 0 where it is empty.

    Parameters
    ----------
    image, phase, mask, periodic
        As for `thickness`, but the phase is by default "void".

    Returns
    -------
    size : float

    Raises
    ------
    InputError
        As `local_thickness`.
    """
    return _mean_diameter(image, phase, "void", mask, periodic)


def chord_length(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    axis: int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> float:
    """Return the mean length of the chords that a line cuts out of a phase, in the image's unit.

    Torquato 2002 (doi:10.1007/978-1-4757-6355-3), section 2.2.4: fraction of the phase over half
    the crossings of its interface per length. No chord is measured, so those that the faces cut
    bias nothing.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    axis : int, optional
        Lines along this axis. Default: the mean crossings over all axes.
    mask : bool array, the image's shape, optional
        Only voxels, and steps between two voxels, inside it count.
    periodic : bool or one per axis
        Lines wrap around the faces.

    Returns
    -------
    length : float
        Infinite where no line crosses the interface; 0 where the phase is empty.

    Raises
    ------
    InputError
        No such phase or axis; a mask of another shape, not boolean or empty.
    """
    image, inside, region = indicator_in_mask(image, phase, mask)
    wraps = as_periodic(periodic, image.ndim)
    rates = []
    for along in range(image.ndim) if axis is None else (as_axis(axis, image.ndim),):
        crossed, steps = crossings(inside, region, along, wraps[along])
        if steps:
            rates.append(crossed / steps / image.spacing[along])
    fraction = int(np.count_nonzero(inside)) / (
        inside.size if region is None else int(np.count_nonzero(region))
    )
    return mean_chord(fraction, rates)


def mean_chord(fraction: float, rates: Sequence[float]) -> float:
    """Return the mean chord of a phase from its fraction and, along every axis, the crossings of
    its interface per length.
    """
    rate = float(np.mean(rates)) if len(rates) else 0.0
    if fraction == 0:
        return 0.0
    return 2 * fraction / rate if rate else float("inf")


def sphere_diameters(
    inside: np.ndarray,
    region: np.ndarray | None,
    spacing: tuple[float, ...],
    wraps: tuple[bool, ...],
    *,
    what: str,
) -> np.ndarray:
    """Return the `local_thickness` of a boolean array within `region`; `what` names it in the
    message.
    """
    free = inside if region is None else inside | ~region
    if free.all():
        where = "image" if region is None else "mask"
        raise InputError(
            f"the {what} fills the whole {where}: its thickness has no bound; choose another phase"
        )
    # In units of the smallest edge: squares of what is large or small in the image's unit might not
    # fit float32.
    scale = min(spacing)
    steps = tuple(edge / scale for edge in spacing)
    radius = distance_transform(free, spacing=steps, periodic=wraps)
    if region is not None:
        radius[~inside] = 0
    # A slice of a 2-D image is as thick as its pixels are wide: the tables of spheres stay small.
    lift = 3 - inside.ndim
    edges = np.array((max(steps),) * lift + steps)
    lifted = radius.reshape((1,) * lift + radius.shape)
    diameter = paint_largest(lifted, edges, (False,) * lift + wraps).reshape(inside.shape)
    # Spheres reach over voxels beyond the mask, which are of no phase.
    diameter -= np.float32(0.5)
    diameter *= inside
    return diameter if scale == 1.0 else diameter * np.float32(scale)


def _mean_diameter(
    image: Image | ArrayLike,
    phase: str | int | None,
    default: str,
    mask: ArrayLike | None,
    periodic: bool | Sequence[bool],
) -> float:
    image, inside, region = indicator_in_mask(image, phase, mask, default=default)
    wraps = as_periodic(periodic, image.ndim)
    if not inside.any():
        return 0.0
    diameter = sphere_diameters(inside, region, image.spacing, wraps, what="phase")
    return float(diameter.sum(dtype=np.float64)) / int(np.count_nonzero(inside))


def crossings(
    inside: np.ndarray, region: np.ndarray | None, axis: int, wraps: bool
) -> tuple[int, int]:
    """Count the steps between neighbours along an axis that leave or enter the phase, and all
    steps.
    """
    lines = np.moveaxis(inside, axis, 0)
    changes = [lines[1:] != lines[:-1], (lines[:1] != lines[-1:])[: int(wraps)]]
    if region is None:
        return sum(int(np.count_nonzero(change)) for change in changes), sum(
            change.size for change in changes
        )
    marked = np.moveaxis(region, axis, 0)
    both = [marked[1:] & marked[:-1], (marked[:1] & marked[-1:])[: int(wraps)]]
    crossed = sum(
        int(np.count_nonzero(change & pair)) for change, pair in zip(changes, both, strict=True)
    )
    return crossed, sum(int(np.count_nonzero(pair)) for pair in both)
