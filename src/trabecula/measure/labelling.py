"""Connected components, numbered: a label for every voxel.

Voxels are visited twice: to find the runs (see `measure.runs`), and to write the labels. Where an
axis is periodic, labels that meet across its faces are joined afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from trabecula.measure.phases import as_connectivity, as_inside, as_periodic
from trabecula.measure.runs import INSIDE, Runs, merge_labels, runs_of


def label_components(
    inside: ArrayLike, *, connectivity: int | None = None, periodic: bool | Sequence[bool] = False
) -> tuple[np.ndarray, np.ndarray]:
    """Label the connected components.

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
    runs = runs_of(solid.view(np.uint8), INSIDE, neighbours)
    labels = runs.labels().reshape(np.shape(inside))
    return (
        _join_across_faces(labels, runs.sizes, neighbours, wraps)
        if any(wraps)
        else (labels, runs.sizes)
    )


def labels_at_faces(labels: np.ndarray, count: int) -> np.ndarray:
    """Return which of the labels 0 .. `count` occur at a face of the image, (count + 1,) bool."""
    found = np.zeros(count + 1, bool)
    for axis in range(labels.ndim):
        for end in (0, -1):
            found[labels.take(end, axis=axis)] = True
    return found


def _join_across_faces(
    labels: np.ndarray, sizes: np.ndarray, connectivity: int, wraps: tuple[bool, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Join the labels that are neighbours across a periodic face."""
    found = []
    for axis in (axis for axis, wrap in enumerate(wraps) if wrap):
        faces = labels.take(-1, axis=axis), labels.take(0, axis=axis)
        found.append(pairs_across(*faces, connectivity, _without(axis, wraps)))
    number, merged = merge_labels(sizes, np.concatenate(found))
    return np.concatenate([[0], number]).astype(np.int32)[labels], merged


def _without(axis: int, wraps: Sequence[bool]) -> list[bool]:
    """Return which of the other axes wrap."""
    return [wrap for other, wrap in enumerate(wraps) if other != axis]


def pairs_across(
    far: np.ndarray, near: np.ndarray, connectivity: int, lateral: Sequence[bool]
) -> np.ndarray:
    """Return the pairs of labels that are neighbours from a layer to the one behind it, (n, 2)
    int64; `lateral` says which axes wrap.
    """
    for other, wrap in enumerate(lateral):
        margin = [(int(other == at),) * 2 for at in range(far.ndim)]
        near = np.pad(near, margin, mode="wrap" if wrap else "constant")
    # steps aside that a neighbour may take in all
    reach = {4: 0, 6: 0, 8: 1, 18: 1, 26: 2}[connectivity]
    found = [np.empty(0, np.int64)]
    for step in product((-1, 0, 1), repeat=far.ndim):
        if sum(map(abs, step)) <= reach:
            beside = near[
                tuple(
                    slice(1 + by, 1 + by + side) for by, side in zip(step, far.shape, strict=True)
                )
            ]
            both = (far > 0) & (beside > 0)
            # A pair as one number: quick to sort.
            found.append(np.unique(far[both].astype(np.int64) << 32 | beside[both]))
    pairs = np.concatenate(found)
    return np.stack([pairs >> 32, pairs & 0xFFFFFFFF], axis=1)


def joined_across(runs: Runs, connectivity: int, wraps: Sequence[bool]) -> Runs:
    """Return the runs with the components joined that meet across periodic faces.

    `wraps` has three values, `connectivity` is that of the runs.
    """
    found = [np.empty((0, 2), np.int64)]
    for axis in np.flatnonzero(wraps):
        faces = []
        for first in (runs.shape[axis] - 1, 0):
            box = [(0, side) for side in runs.shape]
            box[axis] = (first, first + 1)
            faces.append(runs.labels(tuple(box)).squeeze(axis))
        found.append(pairs_across(faces[0], faces[1], connectivity, _without(axis, wraps)))
    pairs = np.concatenate(found)
    if not len(pairs):
        return runs
    number, sizes = merge_labels(runs.sizes, pairs)
    return replace(runs, label=number[runs.label - 1], sizes=sizes)
