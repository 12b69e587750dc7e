"""Connected components as runs of voxels along x: some bytes a run, where a label for every voxel
takes four a voxel.

Runs are joined by union-find, root = the run that comes first, so that components are numbered by
their first voxel in raster order. What needs labels as an array paints those of a box.

All passes go by slabs along z, and the arrays may be memory-mapped files (`engine.memmap`): then
neither the voxels nor their runs have to fit into memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import prod

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.chunking import Box
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs, in_order
from trabecula.measure.union_find import join, root_of

# Rows before the present one that can hold neighbours, as (dz, dy, how far x may differ).
_ROWS = {
    6: [(0, -1, 0), (-1, 0, 0)],
    18: [(0, -1, 1), (-1, 0, 1), (-1, -1, 0), (-1, 1, 0)],
    26: [(0, -1, 1), (-1, 0, 1), (-1, -1, 1), (-1, 1, 1)],
}
_ROWS[4], _ROWS[8] = _ROWS[6], _ROWS[26]


_MANY = 1 << 20
"""Voxels from which on threads are started: that takes longer than to visit fewer."""


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
        """Return the labels of a box, or of everything: int32, 0 where no component is."""
        sides = box or tuple((0, side) for side in self.shape)
        low, high = (np.array(ends, np.int64) for ends in zip(*sides, strict=True))
        labels = np.zeros(tuple(high - low), np.int32)
        _paint(self.first, self.begin, self.end, self.label, self.shape[1], low, labels)
        return labels

    def boxes(self, chosen: np.ndarray | None = None) -> np.ndarray:
        """Return the bounding boxes of the components k for which `chosen[k - 1]` holds, or of all,
        in their order.

        (m, 6): first voxel and one past the last along z, y, x.
        """
        chosen = np.ones(len(self.sizes), np.bool_) if chosen is None else chosen
        place = np.cumsum(chosen, dtype=np.int32)
        boxes = np.zeros((int(place[-1]) if len(place) else 0, 6), np.int64)
        boxes[:, :3] = max(self.shape)
        parts = (self.first, self.begin, self.end, self.label, self.shape[1], chosen, place, boxes)
        in_order(lambda start, stop: _bound(*parts, start, stop), self.shape[0])
        return boxes

    def at_faces(self, axes: tuple[int, ...] = (0, 1, 2)) -> np.ndarray:
        """Return whether component k + 1 reaches a face of the array across one of the axes, (n,)
        bool.
        """
        found = np.zeros(len(self.sizes), np.bool_)
        across = np.isin(np.arange(3), axes)
        parts = (self.first, self.begin, self.end, self.label, np.array(self.shape), across, found)
        in_order(lambda start, stop: _mark(*parts, start, stop), self.shape[0])
        return found

    def write(self, values: np.ndarray, chosen: np.ndarray, value: int) -> None:
        """Write `value` into the voxels of the components k for which `chosen[k - 1]` holds: into
        `values` itself.
        """
        lifted = values.reshape(self.shape)
        parts = (self.first, self.begin, self.end, self.label, chosen, lifted, value)
        _spread(lambda start, stop: _write(*parts, start, stop), self.shape)


def runs_of(values: np.ndarray, member: np.ndarray, connectivity: int) -> Runs:
    """Find the components of the voxels whose label is a member.

    Parameters
    ----------
    values : uint8 array, (Z, Y, X), C-contiguous
    member : bool array, (256,)
        Whether voxels of a label belong to the phase.
    connectivity : {6, 18, 26}; {4, 8} of one slice
        Neighbours of a voxel.
    """
    depth, height, width = values.shape
    first = np.zeros(depth * height + 1, np.int64)
    _spread(lambda start, stop: _count_runs(values, member, first, start, stop), values.shape)
    np.cumsum(first, out=first)
    count = int(first[-1])
    begin, end = memmap.empty(count, np.int32), memmap.empty(count, np.int32)
    _spread(
        lambda start, stop: _find_runs(values, member, first, begin, end, start, stop), values.shape
    )
    label, components = _labels(begin, end, first, np.array(_ROWS[connectivity], np.int64), height)
    bounds = first[::height]
    sizes = memmap.zeros(components, np.int64)
    in_order(
        lambda start, stop: _add_sizes(begin, end, label, sizes, bounds[start], bounds[stop]), depth
    )
    return Runs((depth, height, width), first, begin, end, label, sizes)


def _spread(work: Callable[[int, int], object], shape: tuple[int, ...]) -> None:
    """Run slabs in threads, where they pay."""
    (for_slabs if prod(shape) >= _MANY else in_order)(work, shape[0])


def _labels(
    begin: np.ndarray, end: np.ndarray, first: np.ndarray, rows: np.ndarray, height: int
) -> tuple[np.ndarray, int]:
    """Return the component of every run, and their number.

    Not in threads: runs are joined and numbered in their order.
    """
    bounds, count = first[::height], len(begin)
    parent = memmap.empty(count, np.int32 if count < 2**31 else np.int64)
    in_order(
        lambda start, stop: _join(begin, end, first, rows, height, parent, start, stop),
        len(bounds) - 1,
    )
    label, found = memmap.empty(count, np.int32), [0]

    def number(start: int, stop: int) -> None:
        found[0] = _number(parent, label, bounds[start], bounds[stop], found[0])

    in_order(number, len(bounds) - 1)
    return label, found[0]


RUN_BYTES = 24
"""Of a run while it is numbered: two ends, its parent, its label, and its size where it is a
component of its own.
"""

_APART = 8  # voxels from one run of a phase to the next, at least, in the mean


def run_bytes(shape: Sequence[int]) -> int:
    """Return the memory of the runs of a phase of a material, at most."""
    return RUN_BYTES * (prod(shape) // _APART)


INSIDE = np.arange(256) > 0
"""The members of a boolean array."""


def merge_labels(sizes: np.ndarray, pairs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Join labels 1 .. n by pairs of them; return the new label of each, numbered by the first of
    its labels, and the new sizes.
    """
    # A label is a run of its own size here, and its root again the one that comes first.
    parent = _join_pairs(len(sizes), pairs - 1)
    ends, label = np.cumsum(sizes), np.empty(len(parent), np.int32)
    merged = np.zeros(_number(parent, label, 0, len(parent), 0), np.int64)
    _add_sizes(ends - sizes, ends, label, merged, 0, len(parent))
    return label, merged


@kernel
def _count_runs(values, member, first, start, stop):
    """Count the runs of every row, one place further on."""
    height, width = values.shape[1:]
    for z in range(start, stop):
        for y in range(height):
            count = 0
            before = False
            for x in range(width):
                now = member[values[z, y, x]]
                count += now and not before
                before = now
            first[z * height + y + 1] = count


@kernel
def _find_runs(values, member, first, begin, end, start, stop):
    height, width = values.shape[1:]
    k = first[start * height]
    for z in range(start, stop):
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


@kernel
def _join(begin, end, first, rows, height, parent, start, stop):
    """Unite the runs that touch a run in one of the `rows` before theirs; the root is the smallest
    run.
    """
    for k in range(first[start * height], first[stop * height]):
        parent[k] = k
    for row in range(start * height, stop * height):
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
def _number(parent, label, start, stop, count):
    """Label the runs from `start` on, with `count` labels taken before; return the labels taken
    after. A root comes before its tree.
    """
    for k in range(start, stop):
        root = root_of(parent, k)
        if root == k:
            count += 1
            label[k] = count
        else:
            label[k] = label[root]
    return count


@kernel
def _add_sizes(begin, end, label, sizes, start, stop):
    for k in range(start, stop):
        sizes[label[k] - 1] += end[k] - begin[k]


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
def _bound(first, begin, end, label, height, chosen, place, boxes, start, stop):
    for row in range(start * height, stop * height):
        z, y = row // height, row % height
        for k in range(first[row], first[row + 1]):
            if not chosen[label[k] - 1]:
                continue
            box = boxes[place[label[k] - 1] - 1]
            box[0], box[3] = min(box[0], z), max(box[3], z + 1)
            box[1], box[4] = min(box[1], y), max(box[4], y + 1)
            box[2], box[5] = min(box[2], begin[k]), max(box[5], end[k])


@kernel
def _mark(first, begin, end, label, shape, across, found, start, stop):
    """Mark the components that have a run at a face across an axis that counts."""
    depth, height, width = shape
    for row in range(start * height, stop * height):
        z, y = row // height, row % height
        outer = (across[0] and (z == 0 or z == depth - 1)) or (
            across[1] and (y == 0 or y == height - 1)
        )
        for k in range(first[row], first[row + 1]):
            if outer or (across[2] and (begin[k] == 0 or end[k] == width)):
                found[label[k] - 1] = True


@kernel
def _write(first, begin, end, label, chosen, values, value, start, stop):
    height = values.shape[1]
    for row in range(start * height, stop * height):
        for k in range(first[row], first[row + 1]):
            if chosen[label[k] - 1]:
                values[row // height, row % height, begin[k] : end[k]] = value
