"""Properties of a material as one number each, so that a result can be asked to have one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import check_name
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, check_labels
from trabecula.measure.fractions import specific_surface
from trabecula.measure.mechanics import stiffness
from trabecula.measure.percolation import AXES
from trabecula.measure.thickness import pore_size, thickness
from trabecula.measure.transport import conductivity, diffusivity, permeability

_TOLERANCE = 1e-3
"""Of the solvers: a fraction of what results of one target differ by."""


@dataclass(frozen=True)
class Property:
    """A property that is one number, or one along each axis.

    Attributes
    ----------
    power : int
        Power of the image's unit of length that it has.
    whole : callable, optional
        Image -> value without direction.
    along : callable, optional
        Image, axes -> values along them.
    """

    power: int
    whole: Callable[[Image], float] | None = None
    along: Callable[[Image, list[int]], list[float]] | None = None


def _diffusivity(image: Image, axes: list[int]) -> list[float]:
    return [diffusivity(image, axis=axis, tolerance=_TOLERANCE).value for axis in axes]


def _permeability(image: Image, axes: list[int]) -> list[float]:
    return [permeability(image, axis=axis, tolerance=_TOLERANCE).value for axis in axes]


def _conductivity(image: Image, axes: list[int]) -> list[float]:
    solid = {phase: float(phase != "void") for phase in image.phases}
    found = (
        conductivity(image, conductivities=solid, axis=axis, tolerance=_TOLERANCE) for axis in axes
    )
    return [one.value for one in found]


def _stiffness(image: Image, axes: list[int]) -> list[float]:
    moduli = stiffness(image, tolerance=10 * _TOLERANCE).moduli  # errs by the square of it
    return [moduli[AXES[axis]] for axis in axes]


PROPERTIES = {
    "diffusivity": Property(0, along=_diffusivity),
    "permeability": Property(2, along=_permeability),
    "conductivity": Property(0, along=_conductivity),
    "stiffness": Property(0, along=_stiffness),
    "specific_surface": Property(-1, whole=lambda image: float(specific_surface(image))),
    "pore_size": Property(1, whole=lambda image: float(pore_size(image))),
    "thickness": Property(1, whole=lambda image: float(thickness(image))),
}
"""By name: those of the certificate, with the same definitions."""


def is_property(name: str) -> bool:
    """Return whether a name is that of a property, with or without an axis."""
    return name.partition(":")[0] in PROPERTIES


def measure_property(image: Image | ArrayLike, name: str) -> float:
    """Measure a property of a volume as one number.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
    name : str
        "diffusivity" of the void and "conductivity" of the solid (relative to the free ones),
        "permeability" (unit^2), "stiffness" (Young's modulus over the solid's), each the mean over
        the axes, or along one as in "permeability:z"; "specific_surface" (1 / unit), "pore_size"
        and "thickness" (unit), which have no direction. As the functions of these names in
        `tb.measure`.

    Returns
    -------
    value : float
        0.0 where nothing spans the image.

    Raises
    ------
    UnknownNameError, InputError
        No such property or axis; an image that is no volume of labels.
    """
    word, colon, axis = str(name).partition(":")
    check_name(word, PROPERTIES, name="property")
    image = as_image(image)
    check_labels(image)
    if image.ndim != 3:
        raise InputError(f"{word} is a property of a volume, the image is 2-D: give a volume")
    found = PROPERTIES[word]
    if found.whole is not None:
        if colon:
            raise InputError(f"{word} has no direction: leave :{axis} out")
        return found.whole(image)
    if colon:
        check_name(axis, AXES, name="axis")
    assert found.along is not None
    axes = [AXES.index(axis)] if colon else [0, 1, 2]
    return float(np.mean(found.along(image, axes)))
