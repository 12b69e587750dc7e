"""What goes through: whether, and how much of, a phase connects two opposite faces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image
from trabecula.measure.labelling import label_components
from trabecula.measure.phases import as_axis, as_periodic, masked_indicator

AXES = ("z", "y", "x")


def percolates(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    connectivity: int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> dict[str, bool]:
    """Whether one component of a phase (default "solid") touches both end faces, for every axis.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        Neighbours within the phase. Default: those that share a face.
    mask : bool array, the image's shape, optional
        Ways lead through the mask alone; its end faces are the first and the last layer that it has
        along the axis.
    periodic : bool or one per axis
        Ways may leave through the sides of such axes and come back at the opposite one; never
        through the end faces of the axis that is asked about.

    Returns
    -------
    percolates : dict
        `{"z": ..., "y": ..., "x": ...}`; without z in 2-D.

    Raises
    ------
    InputError
        A mask of another shape, not boolean or empty, another connectivity, or no such phase.
    """
    image, inside, region = masked_indicator(image, phase, mask)
    wraps = as_periodic(periodic, image.ndim)
    if any(wraps):
        found = [
            _spanning(_labels_along(inside, connectivity, wraps, axis), axis, region)
            for axis in range(image.ndim)
        ]
    else:
        labels = label_components(inside, connectivity=connectivity)[0]
        found = [_spanning(labels, axis, region) for axis in range(image.ndim)]
    return {
        name: len(labels) > 0 for name, labels in zip(AXES[3 - image.ndim :], found, strict=True)
    }


def percolating_fraction(
    image: Image | ArrayLike,
    *,
    axis: int,
    phase: str | int | None = None,
    connectivity: int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> float:
    """Share of a phase's voxels that lie in components which connect the two end faces of an axis,
    0..1.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    axis : int
        From the first to the last layer along this axis.
    phase, connectivity, mask, periodic
        As for `percolates`.

    Returns
    -------
    fraction : float
        0 where the phase is empty.

    Raises
    ------
    InputError
        As `percolates`, and no such axis.

    Examples
    --------
    >>> percolating_fraction(np.array([[1, 1, 1], [0, 0, 0], [1, 0, 0]]), axis=1)
    0.75
    """
    image, inside, region = masked_indicator(image, phase, mask)
    along = as_axis(axis, image.ndim)
    labels = _labels_along(inside, connectivity, as_periodic(periodic, image.ndim), along)
    total = int(np.count_nonzero(inside))
    return int(np.count_nonzero(spanning_voxels(labels, along, region))) / total if total else 0.0


def spanning_voxels(labels: np.ndarray, axis: int, region: np.ndarray | None = None) -> np.ndarray:
    """The voxels, True, of the components that touch both ends of an axis."""
    through = np.zeros(int(labels.max()) + 1, bool)
    through[_spanning(labels, axis, region)] = True
    return through[labels]


def _labels_along(
    inside: np.ndarray, connectivity: int | None, wraps: tuple[bool, ...], axis: int
) -> np.ndarray:
    """Components that do not pass the end faces of `axis`."""
    sideways = tuple(wrap and other != axis for other, wrap in enumerate(wraps))
    return label_components(inside, connectivity=connectivity, periodic=sideways)[0]


def _spanning(labels: np.ndarray, axis: int, region: np.ndarray | None) -> np.ndarray:
    """Labels that occur in the first and in the last layer of the image, or of the region that
    counts.
    """
    ends = (0, -1)
    if region is not None:
        layers = np.flatnonzero(
            region.any(axis=tuple(other for other in range(labels.ndim) if other != axis))
        )
        ends = (int(layers[0]), int(layers[-1]))
    near, far = (np.unique(labels.take(at, axis=axis)) for at in ends)
    both = np.intersect1d(near, far, assume_unique=True)
    return both[both > 0]
