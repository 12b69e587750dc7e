"""Variance of what a solver gives, by the octants of the image.

The classical subdivision takes octants as independent samples: variance of their mean s^2 / 8. Next
to each other they are alike, and they scatter around the mean of their own image alone. Both follow
from the covariance of the solid: with v the variance of a mean over the image and u over an octant,
the octants' s^2 is 8 / 7 (u - v) on average. The variance of the whole is s^2 times what makes that
v.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product

import numpy as np

from trabecula.core import progress
from trabecula.core.image import Image, with_values
from trabecula.measure.centre_crop import box_sides, centre
from trabecula.measure.mean_variance import SpatialCovariance
from trabecula.measure.mechanics import stiffness
from trabecula.measure.percolation import AXES
from trabecula.measure.transport import conductivity, diffusivity, permeability

PARTS = 8
LEAST_SIDE = 48
"""Of an image whose octants are worth a solver."""


def _along_axes(solve: Callable[[int], float]) -> dict[str, float]:
    return {name: solve(axis) for axis, name in enumerate(AXES)}


def _conductivity(image: Image, axis: int) -> float:
    carrying = {phase: float(phase != "void") for phase in image.phases}
    return conductivity(image, conductivities=carrying, axis=axis).value


_SOLVERS: dict[str, Callable[[Image], Mapping[str, float]]] = {
    "diffusivity": lambda image: _along_axes(lambda axis: diffusivity(image, axis=axis).value),
    "conductivity": lambda image: _along_axes(lambda axis: _conductivity(image, axis)),
    "permeability": lambda image: _along_axes(lambda axis: permeability(image, axis=axis).value),
    "stiffness": lambda image: stiffness(image).moduli,
}

SOLVED = tuple(
    f"{name}{axis}" for name in _SOLVERS for axis in ("", *(f"_{axis}" for axis in AXES))
)
"""Names of what is measured in parts: the mean of the axes, and along each."""


def solve_parts(image: Image, names: Sequence[str]) -> dict[str, tuple[float, np.ndarray]]:
    """Solve the image and its octants.

    Parameters
    ----------
    image : Image of labels, (Z, Y, X)
    names : sequence of str
        Of `SOLVED`.

    Returns
    -------
    found : dict
        The value of the whole and those of the octants, (8,), by name.
    """
    solvers = [name for name in _SOLVERS if any(one.startswith(name) for one in names)]
    found: dict[str, tuple[float, np.ndarray]] = {}
    images = [image, *(_part(image, place) for place in product((0, 1), repeat=3))]
    for solver in solvers:
        rows = [_SOLVERS[solver](one) for one in progress.track(images, f"{solver} of parts")]
        columns = {f"{solver}_{axis}": [row[axis] for row in rows] for axis in AXES}
        columns[solver] = [float(np.mean([row[axis] for axis in AXES])) for row in rows]
        found |= {name: (own, np.array(parts)) for name, (own, *parts) in columns.items()}
    return {name: found[name] for name in names}


def variance_share(known: SpatialCovariance) -> float:
    """Return the variance of the whole image over that of its octants' values, by the covariance of
    a local field; 1 / 8 where octants are independent.
    """
    whole = float(known.of_means(known.shape)[0, 0])
    octant = float(known.of_means([side // 2 for side in known.shape])[0, 0])
    if octant <= whole:
        return 1.0
    return min(whole * (PARTS - 1) / (PARTS * (octant - whole)), 1.0)


def crop_box(image: Image, box: int | None) -> Image:
    """Return the centre box of an image."""
    return with_values(image, centre(image.values, box_sides(box, image.shape)))


def _part(image: Image, place: tuple[int, ...]) -> Image:
    halves = [side // 2 for side in image.shape]
    corner = [at * (side - half) for at, side, half in zip(place, image.shape, halves, strict=True)]
    box = tuple(slice(at, at + half) for at, half in zip(corner, halves, strict=True))
    return with_values(image, np.ascontiguousarray(image.values[box]))
