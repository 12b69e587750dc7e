"""Bodies of a known part that the joint with the free voxels cuts: completed beyond it.

A ball is fitted to the surface that is seen of a body, with a radius as the scan's bodies have it;
where nothing is seen the body is as its ellipsoid, which is drawn towards that ball.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.measure.partition import REACH, SMOOTHING
from trabecula.measure.partition.partition import partition
from trabecula.synth.packing.body_faces import BodyFaces
from trabecula.synth.packing.giving_way import give_way
from trabecula.synth.packing.radial_shapes import (
    FINE,
    SIZE,
    degree_for,
    fit_radii,
    table_directions,
)
from trabecula.synth.packing.scan_bodies import ScanBodies

_LEAST = 8  # faces that are seen of a body, at least
_HIDDEN = 0.3  # weight of a contact beside a face that is seen
_ERROR = 2.0  # standard error of the place of a face: faces beside each other err alike
_SPREAD = 0.05  # of the radius, that bodies differ by at least
_ROUNDS = 30


@dataclass(frozen=True, eq=False)
class Standing:
    """Bodies that stand; n bodies. Lengths are in the smallest voxel edge.

    Attributes
    ----------
    places : (n, 3) float64
        From the first corner of the box.
    radii : (n, radial_shapes.SIZE) float32
    """

    places: np.ndarray
    radii: np.ndarray


def find_standing(
    inside: np.ndarray,
    known: np.ndarray,
    steps: np.ndarray,
    wraps: Sequence[bool],
    bodies: ScanBodies,
    degree: int,
    separation: float = 1.0,
) -> Standing:
    """Complete the bodies of a known part that reach the free voxels.

    Parameters
    ----------
    inside, known : (Z, Y, X) bool
        Voxels of the bodies' phase among those that are known, and these.
    steps : (3,) float64
        Edges of a voxel in units of the smallest.
    wraps : three bool
        Axes that repeat.
    bodies : ScanBodies
        How large bodies are.
    degree : int
        Of the harmonics, at most.
    separation : float
        Distance of two bodies over the sum of their radii.
    """
    lines = lines_beside(known, wraps, 2 * float(bodies.radii.max()) / steps)
    box = np.ix_(*(line % side for line, side in zip(lines, known.shape, strict=True)))
    near, unseen = inside[box], ~known[box]
    places: list[np.ndarray] = [np.empty((0, 3))]
    radii: list[np.ndarray] = [np.empty((0, SIZE), np.float32)]
    if near.any() and not (near | unseen).all():
        regions = partition(
            near, steps, (False,) * 3, smoothing=SMOOTHING, reach=REACH, unseen=unseen
        )
        faces = BodyFaces.of(regions, unseen)
        sizes = _Sizes.of(bodies)
        for number in range(regions.count):
            own = faces.of_region(number)
            if faces.cut[own].any() and (~faces.contact[own]).sum() >= _LEAST:
                place, table = _complete(faces, own, sizes, degree, unseen, steps)
                places.append(place[None])
                radii.append(table[None])
    at, tables = np.concatenate(places), np.concatenate(radii)
    if len(at):
        tables = give_way(at, tables, unseen, steps, separation)
    at += (np.array([line[0] for line in lines]) + 0.5) * steps
    sides = np.array(known.shape) * steps
    once = (~np.array(wraps) | ((at >= 0) & (at < sides))).all(axis=1)
    return Standing(at[once], tables[once])


def lines_beside(known: np.ndarray, wraps: Sequence[bool], reach: np.ndarray) -> list[np.ndarray]:
    """Return the voxels along every axis that are within reach (3,) of those that are not known;
    of an axis that repeats all, and some before and behind them.
    """
    lines = []
    for axis, (side, wrap, far) in enumerate(zip(known.shape, wraps, reach, strict=True)):
        margin = int(np.ceil(far)) + 2
        if wrap:
            lines.append(np.arange(-margin, side + margin))
            continue
        others = tuple(other for other in range(3) if other != axis)
        free = np.flatnonzero(~known.all(axis=others))
        lines.append(np.arange(max(free[0] - margin, 0), min(free[-1] + margin + 1, side)))
    return lines


@dataclass(frozen=True)
class _Sizes:
    """Radii of the bodies that a plane cuts: the larger the more often.

    Attributes
    ----------
    mean, spread : float
        Of their mean radii.
    most : float
        The largest mean radius of a body.
    largest : float
        The largest radius of a body.
    """

    mean: float
    spread: float
    most: float
    largest: float

    @classmethod
    def of(cls, bodies: ScanBodies) -> _Sizes:
        size = bodies.radii.mean(axis=1).astype(np.float64)
        weights = bodies.weights * size
        mean = float(np.average(size, weights=weights))
        spread = float(np.sqrt(np.average((size - mean) ** 2, weights=weights)))
        largest = float(bodies.radii.max())
        return cls(mean, max(spread, _SPREAD * mean), float(size.max()), largest)


def _complete(
    faces: BodyFaces,
    own: slice,
    sizes: _Sizes,
    degree: int,
    unseen: np.ndarray,
    steps: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the place of a body, edges, and its radii."""
    places, contact, cut = faces.places[own], faces.contact[own], faces.cut[own]
    ways = faces.ways[own].astype(np.float64)
    weight = np.where(contact, _HIDDEN, 1.0) * ~cut
    centre, radius = _fit_ball(places, ways, weight, sizes)
    # a body reaches as far as the joint where this is beyond its place
    keep = ~cut | (((places - centre) * ways).sum(axis=1) > 0)
    ball = radius * table_directions()
    hidden = ball[_is_unseen(centre + ball, unseen, steps)]
    terms = degree_for(int((~contact).sum()), degree)
    radii, _ = fit_radii(places[keep] - centre, contact[keep], terms, hidden)
    return centre, np.minimum(radii, np.float32(sizes.largest))


def _is_unseen(places: np.ndarray, unseen: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return which places are in voxels that are not seen, or beyond the array."""
    at = np.rint(places / steps).astype(np.int64)
    last = np.array(unseen.shape) - 1
    beyond = ((at < 0) | (at > last)).any(axis=1)
    return np.asarray(beyond | unseen[tuple(np.clip(at, 0, last).T)])


def _fit_ball(
    places: np.ndarray, ways: np.ndarray, weight: np.ndarray, sizes: _Sizes
) -> tuple[np.ndarray, float]:
    """Return the centre and the radius of the ball whose surface is nearest to places (n, 3), its
    radius as likely as bodies have it: Gauss and Newton's method.
    """
    share, mean = weight / weight.sum(), sizes.mean
    # the mean of the ways of the faces of voxels is two thirds of that of a ball's surface
    centre, radius = share @ places - 1.5 * mean * (share @ ways), mean
    sure = np.diag([0, 0, 0, 1 / sizes.spread**2])
    for _ in range(_ROUNDS):
        off = places - centre
        length = np.maximum(np.linalg.norm(off, axis=1), 1e-6)
        slopes = np.concatenate([-off / length[:, None], -np.ones((len(off), 1))], axis=1)
        weighted = slopes.T * (weight / _ERROR**2)
        normal = weighted @ slopes + sure + 1e-3 * np.eye(4)
        right = -weighted @ (length - radius) + sure[3] * (mean - radius)
        step = np.linalg.solve(normal, right)
        step *= min(1, 0.3 * radius / max(float(np.linalg.norm(step)), 1e-12))
        centre = centre + step[:3]
        radius = min(max(radius + float(step[3]), 0.2 * mean), sizes.most)
    return np.rint(centre * FINE) / FINE, round(radius * FINE) / FINE
