"""Makers of fakes: samples that are wrong in one way each, from a real part of a scan."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import trabecula as tb
from trabecula.measure import distance_transform, signed_distance
from trabecula.measure.evenness import depth_of

AMOUNT = 1.5
"""How far the interface of an uneven fake is moved between its densest and its sparsest place, in
thirds of the local thickness.
"""
STRETCH = 1.1
CUTS = 0.3
"""Share of the branches of a skeleton that are cut through, the thinnest ones."""
WALL = 2
"""Voxels by which a cut parts a branch."""
BETWEEN_JOINTS = 2
"""Kind of a branch from joint to joint."""


def cut(scan: tb.Image, corner: tuple[int, ...], shape: tuple[int, ...]) -> tb.Image:
    """Return a box of a scan."""
    box = tuple(slice(a, a + side) for a, side in zip(corner, shape, strict=True))
    return with_values(scan, scan.values[box])


def with_values(image: tb.Image, values: np.ndarray) -> tb.Image:
    """Return an image like another, of other labels."""
    return tb.Image(
        np.ascontiguousarray(values, np.uint8),
        "labels",
        spacing=image.spacing,
        unit=image.unit,
        phases=image.phases,
    )


def gaussian(exemplar: tb.Image, part: tb.Image, seed: int) -> tb.Image:
    """Make a thresholded Gaussian field of the exemplar's fraction and covariance."""
    model = tb.method("noise", kind="gaussian").fit(exemplar)
    return with_values(part, model.generate(part.shape, seed=seed).values)


def verbatim(exemplar: tb.Image, part: tb.Image, seed: int) -> tb.Image:
    """Copy the part as it is."""
    return part


def rolled(exemplar: tb.Image, part: tb.Image, seed: int) -> tb.Image:
    """Copy the part shifted by 5, 9 and 14 voxels; what leaves at one face enters at the other."""
    return with_values(part, np.roll(part.values, (5, 9, 14), (0, 1, 2)))


def trimmed(exemplar: tb.Image, part: tb.Image, seed: int) -> tb.Image:
    """Copy the part without its first three planes along every axis."""
    return with_values(part, part.values[3:, 3:, 3:])


def mirrored(exemplar: tb.Image, part: tb.Image, seed: int) -> tb.Image:
    """Copy the part mirrored along one axis."""
    return with_values(part, np.flip(part.values, seed % 3))


def turned(exemplar: tb.Image, part: tb.Image, seed: int) -> tb.Image:
    """Copy the part turned by 90 degrees about one axis."""
    return with_values(part, np.rot90(part.values, 1, [(1, 2), (0, 2), (0, 1)][seed % 3]))


def mirrored_and_turned(exemplar: tb.Image, part: tb.Image, seed: int) -> tb.Image:
    """Copy the part mirrored along z and turned by 90 degrees about one axis."""
    return turned(exemplar, with_values(part, part.values[::-1]), seed)


def half_copied(exemplar: tb.Image, part: tb.Image, other: tb.Image) -> tb.Image:
    """Join half of a part of the exemplar and half of a part that the exemplar does not hold."""
    half = part.shape[0] // 2
    return with_values(part, np.concatenate([part.values[:half], other.values[half:]]))


def half_turned(exemplar: tb.Image, part: tb.Image, other: tb.Image) -> tb.Image:
    """Do the same, where the half that is copied is mirrored and turned."""
    return half_copied(exemplar, mirrored_and_turned(exemplar, part, 1), other)


def blurred(exemplar: tb.Image, part: tb.Image, seed: int) -> tb.Image:
    """Blur another part by a Gaussian kernel of 1.5 voxels, and cut it at the same fraction."""
    solid = (part.values != _void(part)).astype(np.float64)
    kernel = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    for axis in range(solid.ndim):
        padded = np.pad(solid, [(5, 5) if a == axis else (0, 0) for a in range(3)], mode="reflect")
        windows = np.lib.stride_tricks.sliding_window_view(padded, len(kernel), axis)
        solid = windows @ (kernel / kernel.sum())
    return _cut_at_fraction(part, solid)


def broken_struts(exemplar: tb.Image, part: tb.Image, seed: int) -> tb.Image:
    """Cut through the thinnest three in ten of the solid's branches."""
    return _break(part, of_solid=True)


def closed_throats(exemplar: tb.Image, part: tb.Image, seed: int) -> tb.Image:
    """Close the narrowest three in ten of the void's branches."""
    return _break(part, of_solid=False)


def rods(exemplar: tb.Image, part: tb.Image, seed: int) -> tb.Image:
    """Lay straight rods of the solid's thickness in any direction, up to the part's fraction."""
    solid = part.values != _void(part)
    width = max(3.0, float(tb.measure.thickness(solid.astype(np.uint8))))
    rng = np.random.default_rng(seed)
    places = np.stack(np.indices(part.shape), -1) + 0.5
    nearest = np.full(part.shape, np.inf)
    for _ in range(2000):
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        away = places - rng.uniform(0, part.shape)
        nearest = np.minimum(nearest, np.linalg.norm(np.cross(away, way), axis=-1))
        if np.mean(nearest < width / 2) >= solid.mean():
            break
    return _cut_at_fraction(part, -nearest)


def stretched(exemplar: tb.Image, part: tb.Image, seed: int) -> tb.Image:
    """Stretch the part by a tenth along one axis."""
    axis = seed % 3
    side = part.shape[axis]
    taken = np.minimum((np.arange(side) / STRETCH).round().astype(int), side - 1)
    return with_values(part, part.values.take(taken, axis))


def hollow(exemplar: tb.Image, part: tb.Image, seed: int) -> tb.Image:
    """Make the inside sparser than the outside."""
    return _uneven(part, 1 - np.minimum(2 * depth_of(part.shape), 1))


def graded(exemplar: tb.Image, part: tb.Image, seed: int) -> tb.Image:
    """Make the material denser from the first plane to the last."""
    return _uneven(part, np.indices(part.shape)[0] / part.shape[0])


def two_halves(exemplar: tb.Image, part: tb.Image, seed: int) -> tb.Image:
    """Make one half denser than the other."""
    return _uneven(part, (np.indices(part.shape)[0] >= part.shape[0] / 2) * 1.0)


COPIES: dict[str, Callable[[tb.Image, tb.Image, int], tb.Image]] = {
    "copied, three planes cut off": trimmed,
    "copied": verbatim,
    "copied, rolled": rolled,
    "copied, mirrored": mirrored,
    "copied, turned": turned,
    "copied, mirrored and turned": mirrored_and_turned,
}
"""Of a part of the exemplar."""

MOSAICS: dict[str, Callable[[tb.Image, tb.Image, tb.Image], tb.Image]] = {
    "half copied": half_copied,
    "half mirrored and turned": half_turned,
}
"""Of a part of the exemplar and one that it does not hold."""

CHANGES: dict[str, Callable[[tb.Image, tb.Image, int], tb.Image]] = {
    "Gaussian field": gaussian,
    "blurred, cut again": blurred,
    "broken struts": broken_struts,
    "closed throats": closed_throats,
    "rods for the solid": rods,
    "stretched by 10 %": stretched,
    "hollow": hollow,
    "graded": graded,
    "two halves": two_halves,
}
"""Of a part that the exemplar does not hold, so that nothing but the change can be found."""


def _void(image: tb.Image) -> int:
    return image.phases.index("void")


def _cut_at_fraction(part: tb.Image, field: np.ndarray) -> tb.Image:
    """Call the highest values of a field solid, as many as the part has."""
    solid = part.values != _void(part)
    level = np.quantile(field, 1 - solid.mean())
    return with_values(part, np.where(field > level, np.where(solid, part.values, 1), _void(part)))


def _uneven(part: tb.Image, profile: np.ndarray) -> tb.Image:
    """Thicken the solid where the profile is high; its fraction stays, but for ties."""
    solid = part.values != _void(part)
    step = AMOUNT * tb.measure.thickness(solid.astype(np.uint8)) / 3
    return _cut_at_fraction(part, signed_distance(solid) + step * profile)


def _break(part: tb.Image, *, of_solid: bool) -> tb.Image:
    """Cut the thinnest branches of a phase's skeleton, at their thinnest voxel, by a wall of the
    other phase across the branch.
    """
    solid = part.values != _void(part)
    phase = solid if of_solid else ~solid
    graph = tb.measure.skeleton_graph(phase.astype(np.uint8), phase=1)
    depth = np.where(phase, distance_transform(phase), 0)
    paths = [graph.path(int(n)) for n in np.flatnonzero(graph.kind == BETWEEN_JOINTS)]
    paths = [path for path in paths if len(path) > 4]
    radii = [depth[tuple(path[2:-2].T)].min() for path in paths]
    values = part.values.copy()
    other = _void(part) if of_solid else int(np.bincount(part.values[solid]).argmax())
    places = np.stack(np.indices(part.shape), -1)
    for n in np.argsort(radii, kind="stable")[: round(CUTS * len(paths))]:
        path = paths[n]
        at = 2 + int(np.argmin(depth[tuple(path[2:-2].T)]))
        way = (path[at + 2] - path[at - 2]) / np.linalg.norm(path[at + 2] - path[at - 2])
        reach = int(2 * radii[n]) + 3
        box = tuple(slice(max(a - reach, 0), a + reach + 1) for a in path[at])
        away = places[box] - path[at]
        wall = (np.abs(away @ way) <= WALL / 2) & (
            np.linalg.norm(away, axis=-1) <= 2 * radii[n] + 2
        )
        values[box][wall & phase[box]] = other
    return with_values(part, values)
