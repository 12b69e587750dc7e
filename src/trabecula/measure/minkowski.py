"""Minkowski functionals from 2x2x2 (2x2) configurations: volume, surface, mean curvature, Euler
number.

One pass counts how often each of the 256 black-and-white cubes of eight voxels occurs; every
functional is then a sum over 256 entries of a table (`measure.cubes`).

- Surface: Crofton's formula over the 13 directions between the eight voxels, each weighted with its
  share of the sphere for the given spacing (Legland, Kieu, Devaux 2007,
  doi:10.5566/ias.v26.p83-92).
- Integral of mean curvature: Euler numbers of the plane sections across the three axes (the same
  paper; Ohser and Muecklich 2000, "Statistical Analysis of Microstructures in Materials Science",
  section 4.2).
- Euler number: vertices - edges + faces - cells of the complex of voxels: with 26 neighbours every
  cell that touches a voxel belongs to it, with 6 only those whose voxels are all inside. With 18 it
  is the complex of 26 in which two voxels that meet in nothing but a vertex are cut apart there, so
  that vertex counts twice; the void's neighbours are then 6, as with 26 (the pair (18, 6) of
  digital topology; Kong and Rosenfeld 1989, doi:10.1016/0734-189X(89)90147-3).

Densities are taken over the cubes inside the image (or its mask), so its faces are no surface.
Numbers of an object are taken with a margin of outside voxels, so its cut faces are surface. A
periodic image has neither: beyond its last voxel comes its first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.measure.configurations import (
    bits,
    count_cubes,
    cube_euler,
    curvature_table,
    square_euler,
    surface_table,
)
from trabecula.measure.phases import as_connectivity, as_periodic, check_sides, indicator_in_mask


@dataclass(frozen=True)
class Minkowski:
    """The functionals of a phase, in the image's unit of length.

    In 2-D `surface` is the boundary's length per area, and `mean_curvature` the integral of its
    curvature per area.
    """

    volume: float
    """Fraction of the phase, 0..1, over the cubes counted: voxels at the faces count less
    (`porosity` is exact).
    """
    surface: float
    """Area of the interface per volume, 1 / length."""
    mean_curvature: float
    """Integral of the mean curvature over the interface per volume, 1 / length^2; positive for a
    convex phase.
    """
    euler_density: float
    """Euler number per volume, 1 / length^3."""


def minkowski(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    connectivity: int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> Minkowski:
    """Measure all Minkowski functionals of a phase as densities; the faces of the image are no
    surface.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        Neighbours within the phase. Default: those that share a face.
    mask : bool array, the image's shape, optional
        Only configurations wholly inside it count, so its rim is no surface.
    periodic : bool or one per axis
        Configurations wrap around the faces.

    Returns
    -------
    functionals : Minkowski

    Raises
    ------
    InputError
        A side of one voxel, a mask that no configuration fits into, or another connectivity.

    Notes
    -----
    Surface is exact on average for isotropic structures and within some percent for curved ones; a
    flat interface along an axis comes out 8 % low (13 directions). Mean curvature is unbiased for
    isotropic structures.
    """
    image, inside, region = indicator_in_mask(image, phase, mask)
    neighbours = as_connectivity(connectivity, image.ndim)
    wraps = as_periodic(periodic, image.ndim)
    check_sides(image.shape, what="has no surface inside")
    counts = count_cubes(
        append_wrapped(inside, wraps), None if region is None else append_wrapped(region, wraps)
    )
    if not counts.any():
        raise InputError(
            "no 2x2x2 block of voxels (2x2 in 2-D) is wholly in the mask: give a thicker one"
        )
    return densities(counts, image.spacing, neighbours)


def densities(counts: np.ndarray, spacing: tuple[float, ...], connectivity: int) -> Minkowski:
    """Return the functionals from the counts of the 256 cubes inside an image of as many axes as
    `spacing` has.
    """
    weights = counts / counts.sum()
    cell = float(np.prod(spacing))
    volume = float(weights @ bits()[:, : 2 ** len(spacing)].mean(axis=1))
    density = float(weights @ _euler_table(connectivity)) / cell
    if len(spacing) == 2:
        length = float(weights @ surface_table((1.0, *spacing), flat=True))
        return Minkowski(volume, length, 2 * np.pi * density, density)
    surface = float(weights @ surface_table(spacing, flat=False))
    return Minkowski(
        volume, surface, float(weights @ curvature_table(spacing, connectivity)), density
    )


def euler_of(counts: np.ndarray, connectivity: int) -> int:
    """Return the Euler number of an object from the counts of the 256 cubes in it and a margin
    around it.
    """
    # Tables hold eighths, so the sum of whole counts is exact.
    return round(float(counts @ _euler_table(connectivity)))


def mean_curvature(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    connectivity: int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> float:
    """Return the integral of the mean curvature over the interface per volume, from plane sections
    (see the note on `minkowski`).

    Legland, Kieu, Devaux 2007 (doi:10.5566/ias.v26.p83-92).

    Parameters
    ----------
    image, phase, connectivity, mask, periodic
        As for `minkowski`.

    Returns
    -------
    curvature : float
        1 / length^2; positive for a convex phase. In 2-D the integral of the boundary's curvature
        per area.

    Raises
    ------
    InputError
        As `minkowski`.
    """
    return minkowski(
        image, phase=phase, connectivity=connectivity, mask=mask, periodic=periodic
    ).mean_curvature


def euler(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    connectivity: int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> int:
    """Return the Euler number of a phase: components - tunnels + cavities; what is beyond the faces
    is outside.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        Neighbours within the phase. Default: those that share a face.
    mask : bool array, the image's shape, optional
        Of the phase inside the mask, taken as an object: what is beyond the mask is outside too.
    periodic : bool or one per axis
        Along these axes the last voxel is followed by the first, and no face is cut.

    Returns
    -------
    euler : int

    Raises
    ------
    InputError
        A mask of another shape, not boolean or empty, another connectivity, or no such phase.

    Examples
    --------
    >>> ring = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]])
    >>> euler(ring)
    0
    """
    image, inside, _ = indicator_in_mask(image, phase, mask)
    neighbours = as_connectivity(connectivity, image.ndim)
    wraps = as_periodic(periodic, image.ndim)
    margin = [(0, 0) if wrap else (1, 1) for wrap in wraps]
    counts = count_cubes(append_wrapped(np.pad(inside, margin), wraps), None)
    return euler_of(counts, neighbours)


def euler_density(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    connectivity: int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> float:
    """Return the Euler number of a phase per volume, free of what the faces cut (`euler` is of the
    image as an object).

    Legland, Kieu, Devaux 2007 (doi:10.5566/ias.v26.p83-92), from 2x2x2 configurations wholly inside
    the image.

    Parameters
    ----------
    image, phase, connectivity, mask, periodic
        As for `minkowski`.

    Returns
    -------
    density : float
        1 / length^3 (2-D: 1 / length^2).

    Raises
    ------
    InputError
        As `minkowski`.
    """
    return minkowski(
        image, phase=phase, connectivity=connectivity, mask=mask, periodic=periodic
    ).euler_density


def append_wrapped(values: np.ndarray, wraps: tuple[bool, ...]) -> np.ndarray:
    """Repeat the first layer behind the last one along every periodic axis."""
    if not any(wraps):
        return values
    return np.pad(values, [(0, int(wrap)) for wrap in wraps], mode="wrap")


def _euler_table(connectivity: int) -> np.ndarray:
    """Return the share of every cube, or of its lower square for 4 and 8 neighbours, (256,)."""
    return (
        cube_euler(connectivity)
        if connectivity in (6, 18, 26)
        else square_euler(connectivity)[np.arange(256) & 15]
    )
