"""How much: volume fractions, and the surface between phases."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image, as_image, check_labels
from trabecula.measure.minkowski import minkowski
from trabecula.measure.phases import indicator


def porosity(image: Image | ArrayLike, *, phase: str | int | None = None) -> float:
    """Fraction of the voxels in the void (or in the phase given), 0..1.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "void".

    Examples
    --------
    >>> porosity(np.array([[0, 1], [0, 0]]))
    0.75
    """
    _, inside = indicator(image, phase, default="void")
    return int(np.count_nonzero(inside)) / inside.size


def volume_fractions(image: Image | ArrayLike) -> dict[str, float]:
    """Fraction of every phase by its name, 0..1; they sum to 1."""
    image = as_image(image)
    check_labels(image)
    counts = np.bincount(image.values.ravel(), minlength=len(image.phases))
    return {name: int(count) / image.values.size for name, count in zip(image.phases, counts, strict=True)}


def specific_surface(image: Image | ArrayLike, *, phase: str | int | None = None) -> float:
    """Area of the interface between a phase and the rest, per volume of the image, 1 / length (2-D: length per area).

    Crofton's formula over 13 directions, 4 in 2-D, from 2x2x2 configurations, with any spacing (`measure.minkowski`,
    which see for its error). The faces of the image are no interface.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    """
    return minkowski(image, phase=phase).surface
