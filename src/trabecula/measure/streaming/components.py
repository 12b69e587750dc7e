"""Connected components, plane after plane.

1. Number the components of a slab, and join those that meet the last plane of the slab before
   (union-find).
2. A component without a voxel in the slab's last plane cannot grow any more: of it only its size
   and the faces that it touches are kept, and how many are alike. So memory is that of a plane,
   whatever the number of components.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from trabecula.measure.labelling import pairs_across
from trabecula.measure.phases import as_inside
from trabecula.measure.runs import INSIDE, Runs, merge_labels, runs_of

_FIRST, _LAST = (1, 4, 16), (2, 8, 32)
"""Bits of the end faces of z, y, x."""


@dataclass(frozen=True)
class ComponentSizes:
    """The components of a volume: how many there are of each size that touch the same end faces.

    Attributes
    ----------
    size : int64 array, (n,)
        Voxels.
    faces : int64 array, (n,)
        The end faces that they touch, as bits.
    count : int64 array, (n,)
    """

    size: np.ndarray
    faces: np.ndarray
    count: np.ndarray

    @property
    def components(self) -> int:
        """Return the number of components."""
        return int(self.count.sum())

    @property
    def voxels(self) -> int:
        """Return the voxels of all components."""
        return int(self.size @ self.count)

    @property
    def largest(self) -> int:
        """Return the voxels of the largest component, 0 where there is none."""
        return int(self.size.max(initial=0))

    def sizes(self) -> np.ndarray:
        """Return the voxels of every component, largest first, as `component_sizes` gives them."""
        return np.sort(np.repeat(self.size, self.count))[::-1]

    def through(self, axis: int) -> int:
        """Return the voxels of the components that touch both ends of an axis (0 z, 1 y, 2 x)."""
        both = _FIRST[axis] | _LAST[axis]
        spans = self.faces & both == both
        return int(self.size[spans] @ self.count[spans])

    def spans(self, axes: Iterable[int]) -> np.ndarray:
        """Return whether components of each row touch both ends of one of the axes (0 z, 1 y, 2 x),
        (n,) bool.
        """
        found = np.zeros(len(self.faces), bool)
        for axis in axes:
            both = _FIRST[axis] | _LAST[axis]
            found |= self.faces & both == both
        return found


def component_table(runs: Runs) -> ComponentSizes:
    """Return the components of a whole volume, one a row, in the order of their labels."""
    faces = _lateral_faces(runs)
    for at, bits in ((0, _FIRST), (-1, _LAST)):
        faces[_layer(runs, 0, at)] |= bits[0]
    return ComponentSizes(runs.sizes, faces[1:], np.ones(len(runs.sizes), np.int64))


class ComponentTally:
    """Connected components of a phase, given plane after plane.

    Parameters
    ----------
    connectivity : {6, 18, 26}
        Neighbours of a voxel. Default: those that share a face.
    """

    def __init__(self, connectivity: int = 6) -> None:
        self._connectivity = connectivity
        # (Y, X): the number of an open component in the last plane, from 1 on; or 0
        self._front: np.ndarray | None = None
        self._sizes = np.zeros(0, np.int64)
        self._faces = np.zeros(0, np.int64)
        self._closed: Counter[tuple[int, int]] = Counter()

    def add(self, inside: np.ndarray) -> None:
        """Take the next planes: a bool array, (planes, Y, X)."""
        runs = runs_of(as_inside(inside).view(np.uint8), INSIDE, self._connectivity)
        first, last = _layer(runs, 0, 0), _layer(runs, 0, -1)
        faces = _lateral_faces(runs)
        if self._front is None:
            faces[first] |= _FIRST[0]
            pairs = np.empty((0, 2), np.int64)
        else:
            pairs = pairs_across(self._front, first, self._connectivity, (False, False))
        opened = len(self._sizes)
        pairs[:, 1] += opened
        number, merged = merge_labels(np.concatenate([self._sizes, runs.sizes]), pairs)
        touched = np.zeros(len(merged), np.int64)
        np.bitwise_or.at(touched, number - 1, np.concatenate([self._faces, faces[1:]]))
        self._carry(np.concatenate([[0], number[opened:]])[last], merged, touched)

    def _carry(self, front: np.ndarray, sizes: np.ndarray, faces: np.ndarray) -> None:
        """Carry on the components that the front touches, numbered anew, and close the others."""
        is_open = np.zeros(len(sizes) + 1, bool)
        is_open[front] = True
        is_open[0] = False
        self._front = np.cumsum(is_open)[front] * (front > 0)
        self._close(sizes[~is_open[1:]], faces[~is_open[1:]])
        self._sizes, self._faces = sizes[is_open[1:]], faces[is_open[1:]]

    def _close(self, sizes: np.ndarray, faces: np.ndarray) -> None:
        keys, counts = np.unique(sizes << 6 | faces, return_counts=True)
        for key, count in zip(keys.tolist(), counts.tolist(), strict=True):
            self._closed[key >> 6, key & 63] += count

    def result(self) -> ComponentSizes:
        """Return the components of all planes that were given."""
        found = self._closed.copy()
        for size, faces in zip(self._sizes.tolist(), self._faces.tolist(), strict=True):
            found[size, faces | _LAST[0]] += 1
        rows = np.array([(*key, count) for key, count in found.items()], np.int64).reshape(-1, 3)
        return ComponentSizes(*rows.T)


def _lateral_faces(runs: Runs) -> np.ndarray:
    """Return the ends of y and x that every label touches, as bits, (n + 1,)."""
    faces = np.zeros(len(runs.sizes) + 1, np.int64)
    for axis in (1, 2):
        for at, bits in ((0, _FIRST), (-1, _LAST)):
            faces[_layer(runs, axis, at)] |= bits[axis]
    return faces


def _layer(runs: Runs, axis: int, at: int) -> np.ndarray:
    """Return the labels of one layer across an axis."""
    at %= runs.shape[axis]
    box = tuple(
        (at, at + 1) if other == axis else (0, side) for other, side in enumerate(runs.shape)
    )
    return runs.labels(box).squeeze(axis)
