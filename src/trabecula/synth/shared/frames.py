"""Directions and sizes that a target asks for, as a few that stand for all.

A method that turns and scales its material makes it in these frames alone, and between them mixes
or chooses. Where a target has few different directions they are taken as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.target import Target
from trabecula.engine.compile import kernel
from trabecula.measure.distance import distance_transform
from trabecula.measure.fabric import spread_directions

_FEW = 12  # different directions that are taken as they are
_STEP = 1.25  # from one size to the next


@dataclass(frozen=True, eq=False)
class TargetFrames:
    """TargetFrames of a target, and how much each of them counts at a place.

    Attributes
    ----------
    directions : (D, 3) float64
        Unit vectors; none where no orientation is asked for.
    sizes : (S,) float64
        Factors, rising; one, 1, where no size is asked for.
    reach : float
        Square of the cosine of the angle at which a direction counts no more.
    """

    directions: np.ndarray
    sizes: np.ndarray
    reach: float

    @property
    def count(self) -> int:
        """Return the number of frames: directions times sizes, directions first."""
        return max(1, len(self.directions)) * len(self.sizes)

    def split(self, number: int) -> tuple[np.ndarray | None, float]:
        """Return direction and size of a frame."""
        which, size = divmod(number, len(self.sizes))
        direction = self.directions[which] if len(self.directions) else None
        return direction, float(self.sizes[size])

    def weights(self, number: int, ways: np.ndarray | None, sizes: np.ndarray | None) -> np.ndarray:
        """Return how much a frame counts at places with directions (..., 3) and sizes (...)."""
        which, size = divmod(number, len(self.sizes))
        found: np.ndarray = np.ones(1)
        if ways is not None:
            a, b, c = (float(part) for part in self.directions[which])
            cosine = ways[..., 0] * a + ways[..., 1] * b + ways[..., 2] * c
            found = np.maximum(cosine * cosine - self.reach, 0.0) ** 2
        if sizes is not None and len(self.sizes) > 1:
            places = np.log(self.sizes)
            far = np.abs(np.log(sizes) - places[size]) / (places[1] - places[0])
            found = found * np.maximum(1 - far, 0.0)
        return np.asarray(found)


def frames_of(target: Mapping[str, Target], count: int) -> TargetFrames:
    """Return the frames of a target's "orientation" and "size".

    Parameters
    ----------
    target : mapping
        Of a `Request`.
    count : int
        Directions that stand for all of half a sphere.
    """
    directions, reach = _directions_of(target.get("orientation"), count)
    return TargetFrames(directions, _sizes_of(target.get("size")), reach)


def _directions_of(given: Target | None, count: int) -> tuple[np.ndarray, float]:
    """Return the directions that stand for those of a field, and their reach."""
    if given is None:
        return np.empty((0, 3)), 0.0
    ways: np.ndarray = np.asarray(given, np.float64).reshape(-1, 3)
    ways = ways[ways.any(axis=1)]
    lead = np.take_along_axis(ways, (np.abs(ways) > 1e-6).argmax(axis=1)[:, None], axis=1)
    several = np.unique(np.round(ways * np.sign(lead), 4), axis=0)
    if len(several) <= _FEW and _least_apart(several) > 20:
        # narrow enough that none reaches the next
        return several / np.linalg.norm(several, axis=1, keepdims=True), np.cos(np.deg2rad(9)) ** 2
    spread = spread_directions(count)
    # the mean angle between neighbours, of which a direction has some within half as much again
    apart = np.sqrt(2 * np.pi / count)
    reach = float(np.cos(1.5 * apart) ** 2)
    near = np.zeros(count, bool)
    for start in range(0, len(ways), 1 << 16):
        near |= ((ways[start : start + (1 << 16)] @ spread.T) ** 2 > reach).any(axis=0)
    return spread[near], reach


def _least_apart(several: np.ndarray) -> float:
    """Return the least angle between directions, in degrees; 90 of one alone."""
    cosine = np.abs(several @ several.T)
    np.fill_diagonal(cosine, 0)
    return float(np.degrees(np.arccos(min(1.0, cosine.max()))))


def _sizes_of(given: Target | None) -> np.ndarray:
    if given is None:
        return np.ones(1)
    low, high = float(np.min(given)), float(np.max(given))
    steps = int(np.ceil(np.log(high / low) / np.log(_STEP) - 1e-9)) if high > low else 0
    return np.geomspace(low, high, steps + 1)


def check_room(mask: np.ndarray | None, least: float, *, what: str) -> None:
    """Raise where a form is nowhere as thick as what is to fill it.

    Parameters
    ----------
    mask : (Z, Y, X) bool array, optional
    least : float
        Size of the smallest unit that is to fit, in voxels.
    what : str
        Its name.

    Raises
    ------
    RequestError
    """
    if mask is None or mask.all():
        return
    widest = 2 * float(distance_transform(mask, spacing=(1.0,) * mask.ndim).max())
    if widest < least:
        raise RequestError(
            f"the form is too thin: it is {widest:.1f} voxels thick at most, and the smallest "
            f"{what} is {least:.1f}; ask for a smaller size, or make the form of more voxels"
        )


def turn_onto(start: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) that takes the axis `start` to `direction` the shortest way.

    Signs are free, so it turns by 90 degrees at most.
    """
    end = direction if start @ direction >= 0 else -direction
    # half a turn about `start`'s normal plane and half a turn about the middle
    axis = start + end
    half = 2 * np.outer(axis, axis) / (axis @ axis) - np.eye(3)
    return np.asarray(half @ (2 * np.outer(start, start) - np.eye(3)))


@kernel
def turn_values(values, back, found):
    """Fill `found` with `values` turned about their middles, by linear interpolation.

    The value at p from the middle is that of `back` (3, 3) times p; 0 beyond the values.
    """
    depth, height, width = values.shape
    for z in range(found.shape[0]):
        for y in range(found.shape[1]):
            for x in range(found.shape[2]):
                a, b, c = z - found.shape[0] // 2, y - found.shape[1] // 2, x - found.shape[2] // 2
                p = back[0, 0] * a + back[0, 1] * b + back[0, 2] * c + depth // 2
                q = back[1, 0] * a + back[1, 1] * b + back[1, 2] * c + height // 2
                r = back[2, 0] * a + back[2, 1] * b + back[2, 2] * c + width // 2
                i, j, k = int(np.floor(p)), int(np.floor(q)), int(np.floor(r))
                total = 0.0
                for di in range(2):
                    for dj in range(2):
                        for dk in range(2):
                            u, v, w = i + di, j + dj, k + dk
                            if 0 <= u < depth and 0 <= v < height and 0 <= w < width:
                                near = (1 - abs(p - u)) * (1 - abs(q - v)) * (1 - abs(r - w))
                                total += near * values[u, v, w]
                found[z, y, x] = total
