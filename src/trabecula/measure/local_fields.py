"""Local fields whose spatial means are descriptors.

Volume fraction, surface, curvature and Euler number per volume are means of what every voxel, or
every cube of 2x2x2 voxels, adds. Mean chord, thickness and pore size are ratios of two such means;
the error of a ratio q = a / b is that of the mean of (a(x) - q b(x)) / mean(b), to first order (the
delta method). So the variance of one mean (`measure.mean_variance`) gives that of each descriptor.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.configurations import cube_codes
from trabecula.measure.minkowski import densities
from trabecula.measure.phases import as_connectivity, check_sides, indicator
from trabecula.measure.thickness import chord_length, sphere_diameters


@dataclass(frozen=True)
class LocalField:
    """A descriptor's value in an image, and the field whose mean has its errors."""

    value: float
    field: np.ndarray
    """(Z, Y, X) or (Y, X); up to one voxel shorter than the image along every axis."""


def fraction_field(image: Image, *, phase: str | int | None = None) -> LocalField:
    """Return the local field of a phase's fraction (default "void"): 1 in the phase, 0 elsewhere.

    Parameters
    ----------
    image : Image of labels
    phase : str or int, optional
    """
    inside = indicator(image, phase, default="void")[1]
    return LocalField(float(inside.mean()), inside)


def surface_field(image: Image, *, phase: str | int | None = None) -> LocalField:
    """Return the local field of `specific_surface`, as `fraction_field` (default "solid")."""
    return _minkowski_field(image, phase, "surface")


def curvature_field(image: Image, *, phase: str | int | None = None) -> LocalField:
    """Return the local field of `mean_curvature`, as `fraction_field` (default "solid")."""
    return _minkowski_field(image, phase, "mean_curvature")


def euler_field(image: Image, *, phase: str | int | None = None) -> LocalField:
    """Return the local field of `euler_density`, as `fraction_field` (default "solid")."""
    return _minkowski_field(image, phase, "euler_density")


def chord_field(image: Image, *, phase: str | int | None = None) -> LocalField:
    """Return the local field of `chord_length`, as `fraction_field` (default "solid")."""
    inside = indicator(image, phase)[1]
    value = chord_length(image, phase=phase)
    inner = tuple(slice(0, side - 1) for side in image.shape)
    rate = np.zeros([side - 1 for side in image.shape], np.float32)
    for axis, edge in enumerate(image.spacing):
        ahead = tuple(slice(int(n == axis), int(n == axis) + s) for n, s in enumerate(rate.shape))
        rate += (inside[inner] != inside[ahead]) / np.float32(2 * image.ndim * edge)
    return _ratio(value, inside[inner].astype(np.float32), rate)


def thickness_field(image: Image, *, phase: str | int | None = None) -> LocalField:
    """Return the local field of `thickness`, as `fraction_field` (default "solid")."""
    return _diameter_field(image, phase, "solid")


def pore_size_field(image: Image, *, phase: str | int | None = None) -> LocalField:
    """Return the local field of `pore_size`, as `fraction_field` (default "void")."""
    return _diameter_field(image, phase, "void")


def _minkowski_field(image: Image, phase: str | int | None, name: str) -> LocalField:
    inside = indicator(image, phase)[1]
    check_sides(image.shape, what="has no surface inside")
    neighbours = as_connectivity(None, image.ndim)
    codes = cube_codes(inside)
    counts = np.bincount(codes.ravel(), minlength=256)
    value = float(getattr(densities(counts, image.spacing, neighbours), name))
    return LocalField(value, _cube_values(name, image.spacing, neighbours)[codes])


@lru_cache
def _cube_values(name: str, spacing: tuple[float, ...], neighbours: int) -> np.ndarray:
    """Return what every cube adds: the density of an image of that cube alone, (256,)."""
    found = [getattr(densities(cube, spacing, neighbours), name) for cube in np.eye(256)]
    return np.array(found, np.float32)


def _diameter_field(image: Image, phase: str | int | None, default: str) -> LocalField:
    """Return the local field of a mean diameter, whose value is freed from what the faces cut.

    A sphere that a face cuts is not seen whole, which moves the mean in proportion to 1 / side. The
    image cut in halves along every axis has twice the faces: what that changes is taken off once.
    """
    inside = indicator(image, phase, default=default)[1]
    voxels = int(np.count_nonzero(inside))
    diameter = _diameters(image, inside)
    whole = float(diameter.sum(dtype=np.float64)) / voxels
    parts = [(slice(0, side // 2), slice(side // 2, side)) for side in image.shape]
    pieces = [inside[part] for part in product(*parts)]
    value = whole
    if not any(piece.all() for piece in pieces):
        cut = sum(float(_diameters(image, one).sum(dtype=np.float64)) for one in pieces) / voxels
        value = 2 * whole - cut
    return LocalField(value, _ratio(whole, diameter, inside.astype(np.float32)).field)


def _diameters(image: Image, inside: np.ndarray) -> np.ndarray:
    return sphere_diameters(inside, None, image.spacing, (False,) * image.ndim, what="phase")


def _ratio(value: float, above: np.ndarray, below: np.ndarray) -> LocalField:
    """Return the linearised field of a ratio of means; `above` is overwritten."""
    above -= np.float32(value) * below
    above /= np.float32(below.mean(dtype=np.float64))
    return LocalField(value, above)
