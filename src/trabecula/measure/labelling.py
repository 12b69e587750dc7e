"""Connected components, numbered.

Runs of voxels along x are joined by union-find, root = the run that comes first, so that components are numbered by
their first voxel in raster order. Voxels are visited twice: to find the runs, and to write the labels. Where an axis
is periodic, labels that meet across its faces are joined afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from trabecula.engine.compile import kernel
from trabecula.measure.phases import as_connectivity, as_inside, as_periodic
from trabecula.measure.union import join, root_of

# Rows before the present one that can hold neighbours, as (dz, dy, how far x may differ).
_ROWS = {
    6: [(0, -1, 0), (-1, 0, 0)],
    18: [(0, -1, 1), (-1, 0, 1), (-1, -1, 0), (-1, 1, 0)],
    26: [(0, -1, 1), (-1, 0, 1), (-1, -1, 1), (-1, 1, 1)],
}
_ROWS[4], _ROWS[8] = _ROWS[6], _ROWS[26]


def label_components(
    inside: ArrayLike, *, connectivity: int | None = None, periodic: bool | Sequence[bool] = False
) -> tuple[np.ndarray, np.ndarray]:
    """Number the connected components.

    Parameters
    ----------
    inside : bool array, (Z, Y, X) or (Y, X)
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        Neighbours of a voxel. Default: those that share a face (6; 4).
    periodic : bool or one per axis
        Voxels at opposite faces of these axes are neighbours.

    Returns
    -------
    labels : int32 array, the shape of `inside`
        0 outside, then 1 .. n in the order of each component's first voxel (raster order).
    sizes : int64 array, (n,)
        Voxels of component k at `sizes[k - 1]`.

    Raises
    ------
    InputError
        Not boolean, or another connectivity.

    Examples
    --------
    >>> labels, sizes = label_components(np.array([[1, 0, 1], [1, 0, 0]], bool))
    >>> labels.tolist(), sizes.tolist()
    ([[1, 0, 2], [1, 0, 0]], [2, 1])
    """
    neighbours = as_connectivity(connectivity, np.ndim(inside))
    solid = as_inside(inside)
    wraps = as_periodic(periodic, np.ndim(inside))
    first = _count_runs(solid)
    begin, end = _find_runs(solid, first)
    parent = _join(begin, end, first, np.array(_ROWS[neighbours], np.int64), solid.shape[1])
    label, sizes = _number(begin, end, parent)
    labels = _paint(solid.shape, begin, end, first, label).reshape(np.shape(inside))
    return _wrapped(labels, sizes, neighbours, wraps) if any(wraps) else (labels, sizes)


def _wrapped(
    labels: np.ndarray, sizes: np.ndarray, connectivity: int, wraps: tuple[bool, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Join the labels that are neighbours across a periodic face."""
    pairs = np.concatenate([_meeting(labels, connectivity, wraps, axis) for axis in range(labels.ndim) if wraps[axis]])
    # A label is a run of its own size here, and its root again the one that comes first.
    parent = _join_pairs(len(sizes), pairs.astype(np.int64) - 1)
    ends = np.cumsum(sizes)
    number, merged = _number(ends - sizes, ends, parent)
    return np.concatenate([[0], number]).astype(np.int32)[labels], merged


def _meeting(labels: np.ndarray, connectivity: int, wraps: tuple[bool, ...], axis: int) -> np.ndarray:
    """(n, 2): pairs of labels that are neighbours from the last layer of an axis to its first."""
    lateral = [wrap for other, wrap in enumerate(wraps) if other != axis]
    far, near = labels.take(-1, axis=axis), labels.take(0, axis=axis)
    for other, wrap in enumerate(lateral):
        margin = [(int(other == at),) * 2 for at in range(far.ndim)]
        near = np.pad(near, margin, mode="wrap" if wrap else "constant")
    reach = {4: 0, 6: 0, 8: 1, 18: 1, 26: 2}[connectivity]  # steps aside that a neighbour may take in all
    found = [np.empty((0, 2), labels.dtype)]
    for step in product((-1, 0, 1), repeat=far.ndim):
        if sum(map(abs, step)) <= reach:
            beside = near[tuple(slice(1 + by, 1 + by + side) for by, side in zip(step, far.shape, strict=True))]
            both = (far > 0) & (beside > 0)
            found.append(np.unique(np.stack([far[both], beside[both]], axis=1), axis=0))
    return np.concatenate(found)


@kernel
def _count_runs(inside):
    """Number of the first run of every row z * Y + y, and at the end of all runs."""
    depth, height, width = inside.shape
    first = np.zeros(depth * height + 1, np.int64)
    for z in range(depth):
        for y in range(height):
            count = 0
            before = False
            for x in range(width):
                count += inside[z, y, x] and not before
                before = inside[z, y, x]
            first[z * height + y + 1] = first[z * height + y] + count
    return first


@kernel
def _find_runs(inside, first):
    """Run k covers begin[k] <= x < end[k] of its row."""
    depth, height, width = inside.shape
    begin = np.empty(first[-1], np.int32)
    end = np.empty(first[-1], np.int32)
    k = 0
    for z in range(depth):
        for y in range(height):
            before = False
            for x in range(width):
                now = inside[z, y, x]
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
def _join(begin, end, first, rows, height):
    """Union of the runs that touch a run in one of the `rows` before theirs; the root is the smallest run."""
    parent = np.arange(len(begin))
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
    return parent


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
    sizes = np.zeros(len(parent), np.int64)
    count = 0
    for k in range(len(parent)):
        root = root_of(parent, k)
        if root == k:
            count += 1
            label[k] = count
        else:
            label[k] = label[root]
        sizes[label[k] - 1] += end[k] - begin[k]
    return label, sizes[:count].copy()


@kernel
def _paint(shape, begin, end, first, label):
    labels = np.zeros(shape, np.int32)
    for z in range(shape[0]):
        for y in range(shape[1]):
            row = z * shape[1] + y
            for k in range(first[row], first[row + 1]):
                labels[z, y, begin[k] : end[k]] = label[k]
    return labels
