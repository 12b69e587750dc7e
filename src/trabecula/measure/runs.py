"""Connected components as runs of voxels along x: some bytes a run, where a label for every voxel takes four a voxel.

Runs are joined by union-find, root = the run that comes first, so that components are numbered by their first voxel in
raster order. What needs labels as an array paints those of a box.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.cuts import Box
from trabecula.measure.union import join, root_of

# Rows before the present one that can hold neighbours, as (dz, dy, how far x may differ).
_ROWS = {
    6: [(0, -1, 0), (-1, 0, 0)],
    18: [(0, -1, 1), (-1, 0, 1), (-1, -1, 0), (-1, 1, 0)],
    26: [(0, -1, 1), (-1, 0, 1), (-1, -1, 1), (-1, 1, 1)],
}
_ROWS[4], _ROWS[8] = _ROWS[6], _ROWS[26]


@dataclass(frozen=True)
class Runs:
    """The components of an array, (Z, Y, X), numbered 1 .. n in the order of their first voxels.

    Attributes
    ----------
    shape : three ints
    first : int64 array, (Z * Y + 1,)
        Number of the first run of every row z * Y + y, and at the end of all runs.
    begin, end, label : int32 array, (runs,)
        Run k covers begin[k] <= x < end[k] of its row and belongs to component label[k].
    sizes : int64 array, (n,)
        Voxels of component k at `sizes[k - 1]`.
    """

    shape: tuple[int, int, int]
    first: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    label: np.ndarray
    sizes: np.ndarray

    def labels(self, box: Box | None = None) -> np.ndarray:
        """The labels of a box, or of everything: int32, 0 where no component is."""
        sides = box or tuple((0, side) for side in self.shape)
        low, high = (np.array(ends, np.int64) for ends in zip(*sides, strict=True))
        labels = np.zeros(tuple(high - low), np.int32)
        _paint(self.first, self.begin, self.end, self.label, self.shape[1], low, labels)
        return labels

    def boxes(self) -> np.ndarray:
        """(n + 1, 6): first voxel and one past the last along z, y, x of every label; label 0 has none."""
        boxes = np.zeros((len(self.sizes) + 1, 6), np.int64)
        boxes[:, :3] = max(self.shape)
        _bound(self.first, self.begin, self.end, self.label, self.shape[1], boxes)
        return boxes

    def write(self, values: np.ndarray, chosen: np.ndarray, value: int) -> None:
        """Write `value` into the voxels of the components k for which `chosen[k - 1]` holds: into `values` itself."""
        _write(self.first, self.begin, self.end, self.label, chosen, values.reshape(self.shape), value)


def runs_of(values: np.ndarray, member: np.ndarray, connectivity: int) -> Runs:
    """The components of the voxels whose label is a member.

    Parameters
    ----------
    values : uint8 array, (Z, Y, X), C-contiguous
    member : bool array, (256,)
        Whether voxels of a label belong to the phase.
    connectivity : {6, 18, 26}; {4, 8} of one slice
        Neighbours of a voxel.
    """
    depth, height, width = values.shape
    first = _count_runs(values, member)
    begin, end = _find_runs(values, member, first)
    parent = np.arange(len(begin), dtype=np.int32 if len(begin) < 2**31 else np.int64)
    _join(begin, end, first, np.array(_ROWS[connectivity], np.int64), height, parent)
    label, sizes = _number(begin, end, parent)
    return Runs((depth, height, width), first, begin, end, label, sizes)


RUN_BYTES = 24
"""Of a run while it is numbered: two ends, its parent, its label, and its size where it is a component of its own."""

INSIDE = np.arange(256) > 0
"""The members of a boolean array."""


def merged_pieces(sizes: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Labels 1 .. n joined by pairs of them: the new label of each, numbered by the first of its labels, and new sizes."""
    # A label is a run of its own size here, and its root again the one that comes first.
    parent = _join_pairs(len(sizes), pairs - 1)
    ends = np.cumsum(sizes)
    return _number(ends - sizes, ends, parent)


@kernel
def _count_runs(values, member):
    depth, height, width = values.shape
    first = np.zeros(depth * height + 1, np.int64)
    for z in range(depth):
        for y in range(height):
            count = 0
            before = False
            for x in range(width):
                now = member[values[z, y, x]]
                count += now and not before
                before = now
            first[z * height + y + 1] = first[z * height + y] + count
    return first


@kernel
def _find_runs(values, member, first):
    depth, height, width = values.shape
    begin = np.empty(first[-1], np.int32)
    end = np.empty(first[-1], np.int32)
    k = 0
    for z in range(depth):
        for y in range(height):
            before = False
            for x in range(width):
                now = member[values[z, y, x]]
                if now and not before:
                    begin[k] = x
                elif before and not now:
                    end[k] = x
                    k += 1
                before = now
            if before:
                end[k] = width
                k += 1
    return begin, end


@kernel
def _join(begin, end, first, rows, height, parent):
    """Union of the runs that touch a run in one of the `rows` before theirs; the root is the smallest run."""
    for row in range(len(first) - 1):
        z, y = row // height, row % height
        for n in range(len(rows)):
            dz, dy, slack = rows[n]
            if z + dz < 0 or y + dy < 0 or y + dy >= height:
                continue
            other = (z + dz) * height + y + dy
            a, b = first[row], first[other]
            while a < first[row + 1] and b < first[other + 1]:
                if end[a] + slack <= begin[b]:
                    a += 1
                elif end[b] + slack <= begin[a]:
                    b += 1
                else:
                    join(parent, a, b)
                    if end[a] < end[b]:
                        a += 1
                    else:
                        b += 1


@kernel
def _join_pairs(count, pairs):
    parent = np.arange(count)
    for n in range(len(pairs)):
        join(parent, pairs[n, 0], pairs[n, 1])
    return parent


@kernel
def _number(begin, end, parent):
    """Label of every run and size of every label. A root comes before all runs of its tree."""
    label = np.empty(len(parent), np.int32)
    count = 0
    for k in range(len(parent)):
        root = root_of(parent, k)
        if root == k:
            count += 1
            label[k] = count
        else:
            label[k] = label[root]
    sizes = np.zeros(count, np.int64)
    for k in range(len(parent)):
        sizes[label[k] - 1] += end[k] - begin[k]
    return label, sizes


@kernel
def _paint(first, begin, end, label, height, low, labels):
    depth, rows, width = labels.shape
    for z in range(depth):
        for y in range(rows):
            row = (low[0] + z) * height + low[1] + y
            for k in range(first[row], first[row + 1]):
                left, right = max(begin[k] - low[2], 0), min(end[k] - low[2], width)
                if left >= width:
                    break
                if left < right:
                    labels[z, y, left:right] = label[k]


@kernel
def _bound(first, begin, end, label, height, boxes):
    for row in range(len(first) - 1):
        z, y = row // height, row % height
        for k in range(first[row], first[row + 1]):
            box = boxes[label[k]]
            box[0], box[3] = min(box[0], z), max(box[3], z + 1)
            box[1], box[4] = min(box[1], y), max(box[4], y + 1)
            box[2], box[5] = min(box[2], begin[k]), max(box[5], end[k])


@kernel
def _write(first, begin, end, label, chosen, values, value):
    height = values.shape[1]
    for row in range(len(first) - 1):
        for k in range(first[row], first[row + 1]):
            if chosen[label[k] - 1]:
                values[row // height, row % height, begin[k] : end[k]] = value
