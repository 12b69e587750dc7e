"""Minkowski functionals from 2x2x2 (2x2) configurations: volume, surface, mean curvature, Euler number.

One pass counts how often each of the 256 black-and-white cubes of eight voxels occurs; every functional is then a
sum over 256 entries of a table that is made here, not typed in.

- Surface: Crofton's formula over the 13 directions between the eight voxels, each weighted with its share of the
  sphere for the given spacing (Legland, Kieu, Devaux 2007, doi:10.5566/ias.v26.p83-92).
- Integral of mean curvature: Euler numbers of the plane sections across the three axes (the same paper; Ohser and
  Muecklich 2000, "Statistical Analysis of Microstructures in Materials Science", section 4.2).
- Euler number: vertices - edges + faces - cells of the complex of voxels: with 26 neighbours every cell that touches
  a voxel belongs to it, with 6 only those whose voxels are all inside.

Densities are taken over the cubes inside the image, so its faces are no surface. Numbers of an object are taken with
a margin of outside voxels, so its cut faces are surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.compile import kernel
from trabecula.engine.tiles import for_slabs
from trabecula.measure.phases import indicator

_CORNERS = np.array(list(product((0, 1), repeat=3)))  # corner i is bit i of a configuration: (dz, dy, dx)


@dataclass(frozen=True)
class Minkowski:
    """The functionals of a phase, in the image's unit of length.

    In 2-D `surface` is the boundary's length per area, and `mean_curvature` the integral of its curvature per area.
    """

    volume: float
    """Fraction of the phase, 0..1."""
    surface: float
    """Area of the interface per volume, 1 / length."""
    mean_curvature: float
    """Integral of the mean curvature over the interface per volume, 1 / length^2; positive for a convex phase."""
    euler_density: float
    """Euler number per volume, 1 / length^3."""


def minkowski(
    image: Image | ArrayLike, *, phase: str | int | None = None, connectivity: int | None = None
) -> Minkowski:
    """All Minkowski functionals of a phase as densities; the faces of the image are no surface.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    connectivity : {6, 26} in 3-D, {4, 8} in 2-D, optional
        Neighbours within the phase. Default: those that share a face.

    Raises
    ------
    InputError
        A side of one voxel, or another connectivity.

    Notes
    -----
    Surface is exact on average for isotropic structures and within some percent for curved ones; a flat interface
    along an axis comes out 8 % low (13 directions). Mean curvature is unbiased for isotropic structures.
    """
    image, inside = indicator(image, phase)
    _check_sides(image.shape)
    wide = _is_wide(connectivity, image.ndim)
    counts = _configurations(inside)
    weights = counts / counts.sum()
    cell = float(np.prod(image.spacing))
    volume = float(weights @ _bits().mean(axis=1)) if image.ndim == 3 else float(weights @ _bits()[:, :4].mean(axis=1))
    if image.ndim == 2:
        euler = float(weights @ _quad_euler(wide)[np.arange(256) & 15]) / cell
        return Minkowski(
            volume, float(weights @ _surface_table((1.0, *image.spacing), flat=True)), 2 * np.pi * euler, euler
        )
    surface = float(weights @ _surface_table(image.spacing, flat=False))
    euler = float(weights @ _cube_euler(wide)) / cell
    return Minkowski(volume, surface, float(weights @ _curvature_table(image.spacing, wide)), euler)


def mean_curvature(
    image: Image | ArrayLike, *, phase: str | int | None = None, connectivity: int | None = None
) -> float:
    """Integral of the mean curvature over the interface per volume, 1 / length^2; see `minkowski`."""
    return minkowski(image, phase=phase, connectivity=connectivity).mean_curvature


def euler(image: Image | ArrayLike, *, phase: str | int | None = None, connectivity: int | None = None) -> int:
    """Euler number of a phase: components - tunnels + cavities; what lies beyond the faces is outside.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    connectivity : {6, 26} in 3-D, {4, 8} in 2-D, optional
        Neighbours within the phase. Default: those that share a face.

    Examples
    --------
    >>> ring = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]])
    >>> euler(ring)
    0
    """
    image, inside = indicator(image, phase)
    wide = _is_wide(connectivity, image.ndim)
    counts = _configurations(np.pad(inside, 1))
    # Tables hold eighths, so the sum of whole counts is exact.
    return round(float(counts @ (_cube_euler(wide) if image.ndim == 3 else _quad_euler(wide)[np.arange(256) & 15])))


def euler_density(
    image: Image | ArrayLike, *, phase: str | int | None = None, connectivity: int | None = None
) -> float:
    """Euler number per volume, 1 / length^3, free of what the faces cut; see `minkowski`."""
    return minkowski(image, phase=phase, connectivity=connectivity).euler_density


def _check_sides(shape: tuple[int, ...]) -> None:
    if min(shape) < 2:
        raise InputError(
            f"an image of shape {shape} has no surface inside: at least 2 voxels along every axis are needed"
        )


def _is_wide(connectivity: int | None, ndim: int) -> bool:
    allowed = (4, 8) if ndim == 2 else (6, 26)
    if connectivity not in (None, *allowed):
        raise InputError(
            f"connectivity {connectivity} has no Euler number in {ndim}-D here: give {allowed[0]} or {allowed[1]}"
        )
    return connectivity == allowed[1]


def _configurations(inside: np.ndarray) -> np.ndarray:
    """How often each of the 256 cubes occurs. A 2-D image is two equal slices: its squares are the lower four bits."""
    solid = np.ascontiguousarray(inside if inside.ndim == 3 else np.stack([inside, inside]))
    parts: list[np.ndarray] = []
    for_slabs(lambda a, b: parts.append(_count_cubes(solid, a, b)), len(solid) - 1)
    return np.sum(parts, axis=0)


@kernel
def _count_cubes(inside, start, stop):
    _, height, width = inside.shape
    counts = np.zeros(256, np.int64)
    for z in range(start, stop):
        for y in range(height - 1):
            near = inside[z, y, 0] | inside[z, y + 1, 0] << 2 | inside[z + 1, y, 0] << 4 | inside[z + 1, y + 1, 0] << 6
            for x in range(1, width):
                far = (
                    inside[z, y, x] | inside[z, y + 1, x] << 2 | inside[z + 1, y, x] << 4 | inside[z + 1, y + 1, x] << 6
                )
                counts[near | far << 1] += 1
                near = far
    return counts


@lru_cache
def _bits() -> np.ndarray:
    """(256, 8): whether corner i is inside."""
    return (np.arange(256)[:, None] >> np.arange(8)) & 1


def _pairs() -> list[tuple[int, int]]:
    return [(i, j) for i in range(8) for j in range(i + 1, 8)]


@lru_cache
def _surface_table(spacing: tuple[float, ...], *, flat: bool) -> np.ndarray:
    """(256,): surface per volume (or boundary per area of the lower square) if every cube were this one.

    Of a direction's pairs of corners, the share with one end inside, over their distance, is the number of crossings
    per length; the surface is twice (the length pi / 2 times) its mean over all directions.
    """
    groups: dict[tuple[int, ...], list[tuple[int, int]]] = {}
    for i, j in _pairs():
        step = _CORNERS[j] - _CORNERS[i]
        if not (flat and (step[0] or i > 3)):
            groups.setdefault(tuple(step), []).append((i, j))
    steps = np.array(list(groups)) * np.array(spacing)
    lengths = np.linalg.norm(steps, axis=1)
    share = _direction_shares(steps / lengths[:, None], flat)
    bits = _bits()
    crossings = [np.mean([bits[:, i] != bits[:, j] for i, j in pairs], axis=0) for pairs in groups.values()]
    return (share / lengths) @ np.array(crossings) * (np.pi / 2 if flat else 2.0)


def _direction_shares(directions: np.ndarray, flat: bool) -> np.ndarray:
    """Share of the sphere (circle) that is nearer to each +-direction than to the others, by a regular sample of it."""
    turn = np.arange(100_000) + 0.5
    height = np.zeros_like(turn) if flat else turn / len(turn)  # directions have no sign: half a sphere is enough
    angle = np.pi * turn / len(turn) if flat else np.pi * (1 + 5**0.5) * turn
    around = np.sqrt(1 - height**2)
    sample = np.stack([height, around * np.sin(angle), around * np.cos(angle)], axis=1)
    nearest = np.argmax(np.abs(sample @ directions.T), axis=1)
    return np.bincount(nearest, minlength=len(directions)) / len(turn)


@lru_cache
def _quad_euler(wide: bool) -> np.ndarray:
    """(16,): share of a 2x2 square in the Euler number of a plane image; corners (0,0), (0,1), (1,0), (1,1)."""
    bits = (np.arange(16)[:, None] >> np.arange(4)) & 1
    edges = [(0, 1), (2, 3), (0, 2), (1, 3)]
    if wide:
        # Around the common vertex: the vertex, four half edges, four quarter faces.
        return bits.any(axis=1) - sum(bits[:, [i, j]].any(axis=1) for i, j in edges) / 2 + bits.sum(axis=1) / 4
    return bits.sum(axis=1) / 4 - sum(bits[:, [i, j]].all(axis=1) for i, j in edges) / 2 + bits.all(axis=1)


@lru_cache
def _cube_euler(wide: bool) -> np.ndarray:
    """(256,): share of a 2x2x2 cube in the Euler number."""
    bits = _bits()
    sides = [np.flatnonzero(_CORNERS[:, axis] == at) for axis in range(3) for at in (0, 1)]
    pairs = [pair for pair in _pairs() if np.abs(_CORNERS[pair[1]] - _CORNERS[pair[0]]).sum() == 1]
    if wide:
        # Around the common vertex: itself, six half edges (four voxels each), twelve quarter faces (two), eight
        # eighths of a voxel.
        half_edges = sum(bits[:, side].any(axis=1) for side in sides) / 2
        quarter_faces = sum(bits[:, pair].any(axis=1) for pair in pairs) / 4
        return bits.any(axis=1) - half_edges + quarter_faces - bits.sum(axis=1) / 8
    edges = sum(bits[:, pair].all(axis=1) for pair in pairs) / 4
    faces = sum(bits[:, side].all(axis=1) for side in sides) / 2
    return bits.sum(axis=1) / 8 - edges + faces - bits.all(axis=1)


def _curvature_table(spacing: tuple[float, ...], wide: bool) -> np.ndarray:
    """(256,): mean curvature per volume: 2 pi times the sections' Euler number per area, averaged over the axes."""
    bits, quad = _bits(), _quad_euler(wide)
    table = np.zeros(256)
    for axis in range(3):
        area = float(np.prod(spacing)) / spacing[axis]
        for at in (0, 1):
            side = np.flatnonzero(_CORNERS[:, axis] == at)
            table += quad[bits[:, side] @ (1 << np.arange(4))] / (2 * area)
    return 2 * np.pi * table / 3
