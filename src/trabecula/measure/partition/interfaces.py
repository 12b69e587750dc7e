"""The faces of voxels between regions, and between regions and the faces of the image.

An interface of two regions is the set of voxel faces between them:

- Area: the norm of the sum of the faces as vectors. It depends on the rim alone, so it is exact for
  a flat section in any direction, where counting faces gives up to 1.7 times too much.
- Perimeter: the rim is a closed path of edges of voxels; its corners are smoothed once, and its
  length is taken across the section alone. Circles come out 0 to 7 % too long, squares of n voxels
  42 / n % too short.
- Radius: the largest distance to the wall of the two voxels that a face has on its sides; the lower
  of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.measure.partition.partition import Partition

_ROUNDS = 1  # of smoothing a rim
_SHIFTS = 5  # a pair of regions may meet across -2 .. 2 periods


@dataclass(frozen=True, eq=False)
class Interfaces:
    """Where regions meet; T interfaces, sorted by regions. Units are the smallest voxel edge."""

    first: np.ndarray
    """(T,) int64 region, from 0; the lower of the two numbers."""
    second: np.ndarray
    """(T,) int64 region; -1 - (2 axis + side) for a face of the image."""
    shift: np.ndarray
    """(T, 3) int64: the periods from the box of the first region to where the second is met."""
    centre: np.ndarray
    """(T, 3) mean of the faces, with voxel centres at whole numbers of steps, in the first region's
    frame (without wrapping)."""
    area: np.ndarray
    """(T,)"""
    normal: np.ndarray
    """(T, 3) unit vector of the summed faces, from the first to the second; 0 where they cancel."""
    perimeter: np.ndarray
    """(T,)"""
    radius: np.ndarray
    """(T,) distance, as in the map."""
    start: np.ndarray
    """(T, 2) int64 flat voxels at either side of the widest face; -1 beyond the image."""


def find_interfaces(cut: Partition) -> Interfaces:
    """Find the interfaces of all regions, and with the faces of the image where nothing repeats."""
    faces = _Faces.of(cut)
    n = cut.count + 6
    ends = np.stack([faces.own, faces.other], axis=1)
    turned = (ends[:, 0] > ends[:, 1]) | ((ends[:, 0] == ends[:, 1]) & (_sign(faces.shift) < 0))
    low, high = ends.min(axis=1), ends.max(axis=1)
    shift = np.where(turned[:, None], -faces.shift, faces.shift)
    code = ((shift[:, 0] + 2) * _SHIFTS + shift[:, 1] + 2) * _SHIFTS + shift[:, 2] + 2
    keys, group = np.unique((low * n + high) * _SHIFTS**3 + code, return_inverse=True)
    count = len(keys)
    pair, code = keys // _SHIFTS**3, keys % _SHIFTS**3
    first, second = pair // n, pair % n
    second = np.where(second >= cut.count, cut.count - 1 - second, second)
    shifts = np.stack([code // _SHIFTS**2, code // _SHIFTS % _SHIFTS, code % _SHIFTS], 1) - 2

    edges = cut.steps
    area = np.prod(edges) / edges
    sign = np.where(turned, -1.0, 1.0) * faces.way
    vector = np.stack(
        [
            np.bincount(group, np.where(faces.axis == a, sign * area[a], 0.0), count)
            for a in range(3)
        ],
        axis=1,
    )
    sizes = np.bincount(group, minlength=count)
    # in the frame of the region that comes first
    frame = np.where(turned[:, None], faces.place - faces.shift * faces.sides, faces.place)
    centre = np.stack([np.bincount(group, frame[:, a], count) for a in range(3)], axis=1)
    width = np.linalg.norm(vector, axis=1)
    normal = vector / np.maximum(width, 1e-12)[:, None]
    order = np.lexsort((np.arange(len(group)), -faces.radius, group))
    widest = order[np.searchsorted(group[order], np.arange(count))]
    start = np.where(
        turned[widest][:, None],
        faces.voxels[widest][:, ::-1],
        faces.voxels[widest],
    )
    return Interfaces(
        first=first,
        second=second,
        shift=shifts,
        centre=centre / sizes[:, None] * edges,
        area=width,
        normal=normal,
        perimeter=_perimeters(faces, group, normal, edges),
        radius=faces.radius[widest].astype(np.float64),
        start=start,
    )


def _sign(shift: np.ndarray) -> np.ndarray:
    """Return -1, 0 or 1: the order of a shift and its opposite."""
    code = (shift[:, 0] * _SHIFTS + shift[:, 1]) * _SHIFTS + shift[:, 2]
    return np.sign(code)


@dataclass(frozen=True, eq=False)
class _Faces:
    """Faces of voxels between regions; M faces."""

    axis: np.ndarray  # (M,) int8
    way: np.ndarray  # (M,) 1.0, or -1.0 where the own region lies behind the face
    own: np.ndarray  # (M,) int64 region
    other: np.ndarray  # (M,) int64 region; from N on faces of the image
    voxels: np.ndarray  # (M, 2) int64 flat voxels of own and other, -1 beyond the image
    shift: np.ndarray  # (M, 3) int64
    place: np.ndarray  # (M, 3) middle of the face in voxels, in the frame of the own region
    corner: np.ndarray  # (M, 3) int64 lowest corner of the face on the grid of corners
    radius: np.ndarray  # (M,) float32
    sides: np.ndarray  # (3,) of the image
    wraps: tuple[bool, ...]

    @classmethod
    def of(cls, cut: Partition) -> _Faces:
        labels, sides = cut.labels, np.array(cut.labels.shape)
        found: list[dict[str, np.ndarray]] = []
        for axis in range(3):
            found.append(_between(cut, axis))
            if cut.wraps[axis]:
                found.append(_across(cut, axis))
            else:
                found += [_at_face(cut, axis, side) for side in (0, 1)]
        whole = {name: np.concatenate([part[name] for part in found]) for name in found[0]}
        flat = whole["voxels"]
        distance = cut.distance.ravel()
        near, far = (np.where(v >= 0, distance[v], np.inf) for v in flat.T)
        inner = flat[:, 1] >= 0
        own = labels.ravel()[flat[:, 0]].astype(np.int64) - 1
        other = np.where(inner, labels.ravel()[flat[:, 1]].astype(np.int64) - 1, whole["face"])
        periods = cut.periods(flat[:, 0])
        shift = np.where(inner[:, None], periods + whole["step"] - cut.periods(flat[:, 1]), 0)
        at = np.stack(np.unravel_index(flat[:, 0], labels.shape), axis=1)
        half = np.zeros(at.shape)
        half[np.arange(len(at)), whole["axis"]] = 0.5 * whole["way"]
        corner = at.copy()
        corner[np.arange(len(at)), whole["axis"]] += whole["way"] > 0
        return cls(
            axis=whole["axis"],
            way=whole["way"],
            own=own,
            other=other,
            voxels=flat,
            shift=np.clip(shift, -2, 2),
            place=at + half + periods * sides,
            corner=corner,
            radius=np.minimum(near, far).astype(np.float32),
            sides=sides,
            wraps=cut.wraps,
        ).without_own(cut.count)

    def without_own(self, count: int) -> _Faces:
        """Leave out faces inside a region that were looked at because they lie at a period."""
        real = (self.own != self.other) | (self.shift != 0).any(axis=1)
        kept = {
            name: value[real] if isinstance(value, np.ndarray) and name != "sides" else value
            for name, value in vars(self).items()
        }
        return _Faces(**kept)


def _part(
    first: np.ndarray,
    second: np.ndarray,
    *,
    axis: int,
    face: int = 0,
    way: float = 1.0,
    step: int = 0,
) -> dict[str, np.ndarray]:
    count = len(first)
    steps = np.zeros((count, 3), np.int64)
    steps[:, axis] = step
    return {
        "axis": np.full(count, axis, np.int64),
        "way": np.full(count, way),
        "voxels": np.stack([first, second], axis=1),
        "face": np.full(count, face, np.int64),
        "step": steps,
    }


def _between(cut: Partition, axis: int) -> dict[str, np.ndarray]:
    """Return the faces between neighbours inside the image."""
    labels = cut.labels
    low = [slice(None)] * 3
    high = [slice(None)] * 3
    low[axis], high[axis] = slice(None, -1), slice(1, None)
    a, b = labels[tuple(low)], labels[tuple(high)]
    differ = a != b
    if cut.crossed.size > 1:  # a region may meet itself from the other side of a period
        differ |= cut.crossed[tuple(low)] != cut.crossed[tuple(high)]
    differ &= a > 0
    differ &= b > 0
    at = np.stack(np.nonzero(differ))
    stride = int(np.prod(labels.shape[axis + 1 :], dtype=np.int64))
    first = np.ravel_multi_index(tuple(at), labels.shape).astype(np.int64)
    return _part(first, first + stride, axis=axis)


def _across(cut: Partition, axis: int) -> dict[str, np.ndarray]:
    """Return the faces between the last layer and the first of an axis that repeats."""
    number = np.arange(cut.labels.size).reshape(cut.labels.shape)
    first, second = number.take(-1, axis=axis).ravel(), number.take(0, axis=axis).ravel()
    flat = cut.labels.ravel()
    both = (flat[first] > 0) & (flat[second] > 0)
    return _part(first[both], second[both], axis=axis, step=1)


def _at_face(cut: Partition, axis: int, side: int) -> dict[str, np.ndarray]:
    """Return the faces of regions at a face of the image."""
    layer = cut.labels.take(-side, axis=axis)
    at = list(np.nonzero(layer))
    at.insert(axis, np.full(len(at[0]), (cut.labels.shape[axis] - 1) * side))
    first = np.ravel_multi_index(tuple(at), cut.labels.shape).astype(np.int64)
    return _part(
        first,
        np.full(len(first), -1),
        axis=axis,
        face=cut.count + 2 * axis + side,
        way=1.0 if side else -1.0,
    )


def _perimeters(
    faces: _Faces, group: np.ndarray, normal: np.ndarray, edges: np.ndarray
) -> np.ndarray:
    """Return the length of every interface's rim."""
    grid, count = faces.sides + 1, len(normal)
    size = int(np.prod(grid))

    def number(corner: np.ndarray) -> np.ndarray:
        """Return a corner's number; where an axis repeats its last corners are the first."""
        turned = np.where(faces.wraps, corner % faces.sides, corner)
        return (turned[:, 0] * grid[1] + turned[:, 1]) * grid[2] + turned[:, 2]

    keys = []
    for axis in range(3):
        own = faces.axis == axis
        corner, base = faces.corner[own], group[own].astype(np.int64) * (3 * size)
        for along, aside in ((a, b) for a in range(3) for b in range(3) if len({a, b, axis}) == 3):
            for step in (0, 1):
                moved = corner.copy()
                moved[:, aside] += step
                keys.append(base + along * size + number(moved))
    found, times = np.unique(np.concatenate(keys), return_counts=True)
    # edges with a face on either side are inside
    rim = found[times % 2 == 1]
    where, along, low = rim // (3 * size), rim // size % 3, rim % size
    stride = np.array([grid[1] * grid[2], grid[2], 1])
    corner = np.stack([low // stride[0], low // grid[2] % grid[1], low % grid[2]], axis=1)
    corner[np.arange(len(corner)), along] += 1
    ends = np.concatenate([where * size + low, where * size + number(corner)])
    node, member = np.unique(ends, return_inverse=True)
    joined = member.reshape(2, -1)
    ahead = np.zeros((len(along), 3))
    ahead[np.arange(len(along)), along] = edges[along]
    # Every corner moves to (a + 2 b + c) / 4, where a and c are those beside it: kept as a shift of
    # the corner, since a rim may lie across a face that repeats.
    moved = np.zeros((len(node), 3))
    for _ in range(_ROUNDS):
        apart = ahead + moved[joined[1]] - moved[joined[0]]
        pull = np.stack(
            [
                np.bincount(joined[0], apart[:, a], len(node))
                - np.bincount(joined[1], apart[:, a], len(node))
                for a in range(3)
            ],
            axis=1,
        )
        moved += pull / (2 * np.bincount(member, minlength=len(node)))[:, None]
    apart = ahead + moved[joined[1]] - moved[joined[0]]
    # across the section alone: a rim wanders along a wall where distances tie
    apart -= (apart * normal[where]).sum(axis=1)[:, None] * normal[where]
    return np.bincount(where, np.linalg.norm(apart, axis=1), count)
