"""Every descriptor of an image at once, as plain values."""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.measure.amount import porosity, volume_fractions
from trabecula.measure.components import AXES, label_components, share_of_largest, spans
from trabecula.measure.correlation import lineal_path, two_point
from trabecula.measure.minkowski import euler, minkowski
from trabecula.measure.phases import indicator
from trabecula.measure.thickness import chord_length, pore_size, thickness


def describe(image: Image | ArrayLike, *, r_max: int = 50) -> dict[str, Any]:
    """Every descriptor of a material, as plain JSON values.

    Where one number is needed, it is that of the solid: every phase but "void". Neighbours share a face.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    r_max : int
        Largest distance of the curves, in voxels; lowered to half the smallest side.

    Returns
    -------
    descriptors : dict
        `porosity`, `fractions` (of every phase), `specific_surface`, `euler` (of the image as an object),
        `euler_density` and `mean_curvature` (per volume, without what the faces cut), `components`, `floating`,
        `floating_voxels`, `largest_fraction`, `percolates` (per axis), `two_point` (per axis and radial, r = 0 ..
        r_max voxels), `lineal_path`, `chord_length`, `pore_size`, `thickness`; and `shape`, `spacing`, `unit`,
        `r_max`. Lengths are in `unit`; the curves run in voxels. `None` where a value does not exist, such as the
        thickness of a phase that fills the image.

    Raises
    ------
    InputError
        Not labels, no phase named "void", a side of one voxel, r_max below 1.
    """
    image = as_image(image)
    if r_max < 1:
        raise InputError(f"r_max {r_max} must be at least 1 voxel")
    numbers = describe_numbers(image)
    return {**numbers, **describe_curves(image, r_max=max(1, min(r_max, min(image.shape) // 2)))}


def describe_numbers(image: Image) -> dict[str, Any]:
    """What `describe` tells, less the curves."""
    image, solid = indicator(image, None)
    shape = minkowski(image)
    labels, sizes = label_components(solid)
    return {
        "shape": list(image.shape),
        "spacing": list(image.spacing),
        "unit": image.unit,
        "porosity": porosity(image),
        "fractions": volume_fractions(image),
        "specific_surface": shape.surface,
        "euler": euler(image),
        "euler_density": shape.euler_density,
        "mean_curvature": shape.mean_curvature,
        "components": len(sizes),
        "floating": max(0, len(sizes) - 1),
        "floating_voxels": int(sizes.sum() - sizes.max(initial=0)),
        "largest_fraction": share_of_largest(sizes),
        "percolates": spans(labels),
        "chord_length": _finite(chord_length(image)),
        "pore_size": pore_size(image) if solid.any() else None,
        "thickness": None if solid.all() else thickness(image),
    }


def describe_curves(image: Image, *, r_max: int) -> dict[str, Any]:
    """The curves of `describe`, r = 0 .. r_max voxels; r_max has to fit every side."""
    curves = {name: two_point(image, r_max=r_max, axis=axis) for axis, name in enumerate(AXES[3 - image.ndim :])}
    curves["radial"] = two_point(image, r_max=r_max)
    return {
        "r_max": r_max,
        "two_point": {name: curve.tolist() for name, curve in curves.items()},
        "lineal_path": lineal_path(image, r_max=r_max).tolist(),
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
