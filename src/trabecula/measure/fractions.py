"""Amounts: volume fractions, and the surface between phases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image, as_image, check_labels
from trabecula.measure.minkowski import minkowski
from trabecula.measure.phases import as_mask, indicator_in_mask


def porosity(
    image: Image | ArrayLike, *, phase: str | int | None = None, mask: ArrayLike | None = None
) -> float:
    """Return the fraction of the voxels in the void (or in the phase given), 0..1.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "void".
    mask : bool array, the image's shape, optional
        Of the voxels in the mask only.

    Returns
    -------
    porosity : float

    Raises
    ------
    InputError
        No such phase; a mask of another shape, not boolean or empty.

    Examples
    --------
    >>> porosity(np.array([[0, 1], [0, 0]]))
    0.75
    """
    _, inside, region = indicator_in_mask(image, phase, mask, default="void")
    return int(np.count_nonzero(inside)) / (
        inside.size if region is None else int(np.count_nonzero(region))
    )


def volume_fractions(
    image: Image | ArrayLike, *, mask: ArrayLike | None = None
) -> dict[str, float]:
    """Return the fraction of the voxels in every phase.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    mask : bool array, the image's shape, optional
        Of the voxels in the mask only.

    Returns
    -------
    fractions : dict
        Name of the phase -> 0..1; they sum to 1.

    Raises
    ------
    InputError
        Not labels; a mask of another shape, not boolean or empty.
    """
    image = as_image(image)
    check_labels(image)
    region = as_mask(mask, image.shape)
    values = image.values.ravel() if region is None else image.values[region]
    counts = np.bincount(values, minlength=len(image.phases))
    return {
        name: int(count) / values.size for name, count in zip(image.phases, counts, strict=True)
    }


def specific_surface(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> float:
    """Return the area of the interface between a phase and the rest, per volume of the image, 1 /
    length (2-D: length per area).

    Crofton's formula over 13 directions, 4 in 2-D, from 2x2x2 configurations, with any spacing
    (`measure.minkowski`, which see for its error). The faces of the image and the rim of the mask
    are no interface.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    mask : bool array, the image's shape, optional
        Only configurations wholly inside it count.
    periodic : bool or one per axis
        Configurations wrap around the faces.

    Returns
    -------
    surface : float
        1 / length, 0 where the phase is empty or alone.

    Raises
    ------
    InputError
        As `minkowski`.
    """
    return minkowski(image, phase=phase, mask=mask, periodic=periodic).surface
