"""Copies of exemplars, turned and scaled, and the local fabric of each: what a method chooses from
where a target gives directions or sizes.

A copy is interpolated from the signed distances of the phases, so that its interfaces stay smooth.
A turned box does not fill a box: of every copy the largest box is kept that lies within the
exemplar.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.target import Target
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.distance import signed_distance
from trabecula.measure.fabric import fabric
from trabecula.measure.orientation import structure_tensor
from trabecula.synth.shared.frames import TargetFrames

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Entries of a symmetric tensor, in the order of the axes."""

DIRECTIONS = 24
"""Directions that stand for all of half a sphere, about 21 degrees apart."""

_CLEAR = 0.1  # least anisotropy of an exemplar that can follow a direction
_SIGMA, _WINDOW = 1.0, 6.0  # voxels, of the gradient and of the window of a local fabric
_EVERY = 2  # voxels from one local fabric that is kept to the next


@dataclass(frozen=True, eq=False)
class TurnedExemplars:
    """Turned and scaled copies.

    Attributes
    ----------
    images : tuple of Image
        The copies, labels.
    sizes : (K,) float64
        Factor on the lengths of each.
    fabrics : tuple of (6, z, y, x) float32
        Local fabric of each, at every second voxel: the structure tensor over its trace, by
        `PAIRS`. None where directions do not matter.
    """

    images: tuple[Image, ...]
    sizes: np.ndarray
    fabrics: tuple[np.ndarray, ...]

    def fabric_at(self, number: int, places: Sequence[np.ndarray]) -> np.ndarray:
        """Return the fabric of a copy on a grid of voxels z, y, x, (nz, ny, nx, 6) float32."""
        values = self.fabrics[number]
        near = [
            np.minimum(at // _EVERY, side - 1)
            for at, side in zip(places, values.shape[1:], strict=True)
        ]
        return np.moveaxis(values[:, near[0]][:, :, near[1]][..., near[2]], 0, -1)


def turn_exemplars(
    exemplars: Sequence[Image], frames: TargetFrames, *, least: int
) -> TurnedExemplars:
    """Turn and scale exemplars of labels into the frames of a target.

    Parameters
    ----------
    exemplars : sequence of Image
        Labels, (Z, Y, X), voxels of equal edges.
    frames : TargetFrames
    least : int
        Voxels that every side of a copy is to have.

    Raises
    ------
    RequestError
        Voxels of unlike edges; an exemplar without a direction; a copy that is too small.
    """
    if len(set(exemplars[0].spacing)) > 1:
        raise RequestError(
            f"the exemplar's voxels have edges {exemplars[0].spacing}: material is turned and "
            "scaled in voxels of equal edges; resample the exemplar"
        )
    directed = len(frames.directions) > 0
    own = principal_direction(exemplars) if directed else np.array([1.0, 0, 0])
    images, sizes = [], []
    for number in range(frames.count):
        direction, size = frames.split(number)
        turn = np.eye(3) if direction is None else rotation_to(own, direction)
        for image in exemplars:
            copy = turned_copy(image, turn, size)
            if min(copy.shape) < least:
                raise RequestError(
                    f"turned to the target's directions and scaled by {size:.3g}, {copy.shape} "
                    f"voxels of the exemplar {image.shape} are left, and {least} a side are "
                    "needed: give a larger exemplar, or a larger size"
                )
            images.append(copy)
            sizes.append(size)
    fabrics = tuple(local_fabric(image) for image in images) if directed else ()
    return TurnedExemplars(tuple(images), np.array(sizes), fabrics)


def copied_voxels(exemplars: Sequence[Image], frames: TargetFrames) -> int:
    """Return the voxels of exemplars times the copies of each, at their sizes: what a forecast
    counts by; turned boxes hold less.
    """
    sizes = [frames.split(number)[1] for number in range(frames.count)]
    own = sum(int(np.prod(image.shape)) for image in exemplars)
    return round(own * sum(size**3 for size in sizes))


def principal_direction(exemplars: Sequence[Image]) -> np.ndarray:
    """Return the principal direction of the fabric of exemplars together, a unit vector.

    Raises
    ------
    RequestError
        The exemplars are as long along every axis.
    """
    found = [fabric(image) for image in exemplars]
    most = max(one.anisotropy for one in found)
    if most < _CLEAR:
        raise RequestError(
            f"the exemplar has no direction that an orientation could turn: its anisotropy is "
            f"{most:.2f}, and {_CLEAR} is needed; leave orientation out"
        )
    dyads = sum(one.anisotropy * np.outer(one.directions[0], one.directions[0]) for one in found)
    return np.asarray(np.linalg.eigh(dyads)[1][:, 2])


def rotation_to(own: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the least rotation, (3, 3), that brings one axis onto another; the sign of an axis
    does not matter.
    """
    sign = 1.0 if own @ direction >= 0 else -1.0
    to = direction * sign / np.linalg.norm(direction)
    cosine, axis = float(own @ to), np.cross(own, to)
    across = np.array(
        [[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]], np.float64
    )
    # Rodrigues' formula; the cosine is not negative, so nothing is divided by 0
    return np.asarray(np.eye(3) + across + across @ across / (1 + cosine))


def turned_copy(image: Image, turn: np.ndarray, size: float) -> Image:
    """Return labels turned by a rotation (3, 3) and scaled, in the largest box about the middle
    that lies within them.
    """
    if size == 1 and np.allclose(turn, np.eye(3)):
        return image
    sides = np.array(image.shape)
    half = _half_sides(turn, (sides - 1) / 2 * size)
    shape = tuple(int(2 * np.floor(h) + 1) for h in half)
    # from a voxel of the copy to its place in the exemplar
    back = turn.T / size
    first = (sides - 1) / 2 - back @ ((np.array(shape) - 1) / 2)
    best = np.full(shape, -np.inf, np.float32)
    labels = np.zeros(shape, image.values.dtype)
    for label in np.unique(image.values):
        distance = signed_distance(image.values == label, clip=16.0)
        found = np.empty(shape, np.float32)

        def work(start: int, stop: int, a: np.ndarray = distance, b: np.ndarray = found) -> None:
            _interpolate(a, back, first, b, start, stop)

        for_slabs(work, shape[0])
        nearer = found > best
        labels[nearer], best[nearer] = label, found[nearer]
    return Image(labels, "labels", image.spacing, image.unit, image.phases)


def _half_sides(turn: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return half the sides of a box that lies within -reach .. reach once it is turned back: a
    cube, each side then as long as the others leave it.
    """
    share = np.abs(turn.T)
    half = np.full(3, float((reach / share.sum(axis=1)).min()))
    for axis in range(3):
        counts = share[:, axis] > 1e-9
        others = share @ half - share[:, axis] * half[axis]
        half[axis] = float(((reach - others)[counts] / share[counts, axis]).min())
    return half


def local_fabric(image: Image) -> np.ndarray:
    """Return the structure tensor over its trace at every second voxel, (6, z, y, x) float32; a
    third of the unit tensor where nothing changes.
    """
    void = image.phases.index("void") if "void" in image.phases else 0
    solid = Image((image.values != void).astype(np.uint8), "labels")
    tensor = structure_tensor(solid, sigma=_SIGMA, window=_WINDOW)[
        ..., ::_EVERY, ::_EVERY, ::_EVERY
    ]
    trace = tensor[0, 0] + tensor[1, 1] + tensor[2, 2]
    some = trace > 1e-6
    return np.stack(
        [np.where(some, tensor[i, j] / np.where(some, trace, 1), (i == j) / 3) for i, j in PAIRS]
    ).astype(np.float32)


def wanted_fabric(directions: Target) -> np.ndarray:
    """Return the fabric (..., 6) of straight rods along directions (..., 3): nothing changes along
    them, and across them all alike.
    """
    ways = np.asarray(directions, np.float32)
    return np.stack(
        [((i == j) - ways[..., i] * ways[..., j]) / 2 for i, j in PAIRS], axis=-1
    ).astype(np.float32)


@kernel
def _interpolate(values, back, first, found, start, stop):
    """Interpolate planes of found (z, y, x) linearly at first + back @ (z, y, x)."""
    depth, height, width = values.shape
    for z in range(start, stop):
        for y in range(found.shape[1]):
            for x in range(found.shape[2]):
                a = first[0] + back[0, 0] * z + back[0, 1] * y + back[0, 2] * x
                b = first[1] + back[1, 0] * z + back[1, 1] * y + back[1, 2] * x
                c = first[2] + back[2, 0] * z + back[2, 1] * y + back[2, 2] * x
                a = min(max(a, 0.0), depth - 1.0)
                b = min(max(b, 0.0), height - 1.0)
                c = min(max(c, 0.0), width - 1.0)
                i = min(np.int64(a), max(depth - 2, 0))
                j = min(np.int64(b), max(height - 2, 0))
                k = min(np.int64(c), max(width - 2, 0))
                a, b, c = a - i, b - j, c - k
                total = 0.0
                for n in range(8):
                    u, v, w = n >> 2, (n >> 1) & 1, n & 1
                    part = (a if u else 1 - a) * (b if v else 1 - b) * (c if w else 1 - c)
                    if part > 0.0:
                        total += part * values[i + u, j + v, k + w]
                found[z, y, x] = total
