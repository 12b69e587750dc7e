"""How far two materials are apart in what bubbles decide: sizes of pores and walls, direction,
porosity.

The measures are those of `measure`, and so of the certificate; distributions are compared as a
whole, not by their means.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.fabric import fabric
from trabecula.measure.thickness import local_thickness

_PARTS = 200
_DIGITS = 6
"""Of a distance: what machines may disagree about is beyond them."""

FARTHEST = 100.0
"""Distance of what cannot be compared: one phase alone, or settings that cannot be met."""


@dataclass(frozen=True)
class Look:
    """What is measured of a material.

    Attributes
    ----------
    porosity : float
    pores, walls : (200,) float64
        Local diameters of void and of solid, by voxels: the middles of equal parts of all voxels,
        rising.
    tensor, directions : (ndim, ndim) float64
        Of mean intercept lengths (`measure.fabric`).
    """

    porosity: float
    pores: np.ndarray
    walls: np.ndarray
    tensor: np.ndarray
    directions: np.ndarray

    def along(self, directions: np.ndarray) -> np.ndarray:
        """Mean intercept lengths along unit vectors, the rows of an array."""
        inverse = np.einsum("ki,ij,kj->k", directions, self.tensor, directions)
        return np.asarray(1 / np.sqrt(np.maximum(inverse, 1e-30)))


def look_of(image: Image) -> Look | None:
    """The look of an image of void and solid; None where one of them is all of it."""
    void = image.values == 0
    if void.all() or not void.any():
        return None
    pores, walls = (
        np.quantile(local_thickness(image, phase=phase)[inside], (np.arange(_PARTS) + 0.5) / _PARTS)
        for phase, inside in (("void", void), ("solid", ~void))
    )
    found = fabric(image)
    return Look(float(void.mean()), pores, walls, found.tensor, found.directions)


def apart(made: Look | None, wanted: Look) -> Mapping[str, float]:
    """Distances, by name; 0 where both are alike.

    `pore_size` and `thickness` are Wasserstein distances of the distributions (the mean difference
    of voxels in order of size) over the mean that is wanted; `anisotropy` is the mean logarithm, by
    size, of the ratio of intercept lengths along the principal directions of what is wanted;
    `porosity` the difference over the rarer phase's share.
    """
    if made is None:
        return dict.fromkeys(("pore_size", "thickness", "anisotropy", "porosity"), FARTHEST)
    rarer = min(wanted.porosity, 1 - wanted.porosity)
    found = {
        "pore_size": np.abs(made.pores - wanted.pores).mean() / wanted.pores.mean(),
        "thickness": np.abs(made.walls - wanted.walls).mean() / wanted.walls.mean(),
        "anisotropy": np.abs(
            np.log(made.along(wanted.directions) / wanted.along(wanted.directions))
        ).mean(),
        "porosity": abs(made.porosity - wanted.porosity) / rarer,
    }
    return {name: round(float(value), _DIGITS) for name, value in found.items()}
