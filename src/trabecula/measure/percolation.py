"""Percolation: components of a phase that connect two opposite faces, and their share."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image
from trabecula.measure.labelling import label_components
from trabecula.measure.phases import as_axis, as_periodic, indicator_in_mask

AXES = ("z", "y", "x")


def percolates(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    connectivity: int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> dict[str, bool]:
    """Return, for every axis, whether one component of a phase (default "solid") touches both end
    faces.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        Neighbours within the phase. Default: those that share a face.
    mask : bool array, the image's shape, optional
        Ways lead through the mask alone; its end faces are the first and the last layer that it has
        along the axis.
    periodic : bool or one per axis
        Ways may leave through the sides of such axes and come back at the opposite one; never
        through the end faces of the axis that is asked about.

    Returns
    -------
    percolates : dict
        `{"z": ..., "y": ..., "x": ...}`; without z in 2-D.

    Raises
    ------
    InputError
        A mask of another shape, not boolean or empty, another connectivity, or no such phase.
    """
    image, inside, region = indicator_in_mask(image, phase, mask)
    wraps = as_periodic(periodic, image.ndim)
    if any(wraps):
        found = [
            _spanning(_labels_along(inside, connectivity, wraps, axis), axis, region)
            for axis in range(image.ndim)
        ]
    else:
        labels = label_components(inside, connectivity=connectivity)[0]
        found = [_spanning(labels, axis, region) for axis in range(image.ndim)]
    return {
        name: len(labels) > 0 for name, labels in zip(AXES[3 - image.ndim :], found, strict=True)
    }


def percolating_fraction(
    image: Image | ArrayLike,
    *,
    axis: int,
    phase: str | int | None = None,
    connectivity: int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> float:
    """Return the share of a phase's voxels in components that connect the two end faces of an axis,
    0..1.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    axis : int
        From the first to the last layer along this axis.
    phase, connectivity, mask, periodic
        As for `percolates`.

    Returns
    -------
    fraction : float
        0 where the phase is empty.

    Raises
    ------
    InputError
        As `percolates`, and no such axis.

    Examples
    --------
    >>> percolating_fraction(np.array([[1, 1, 1], [0, 0, 0], [1, 0, 0]]), axis=1)
    0.75
    """
    image, inside, region = indicator_in_mask(image, phase, mask)
    along = as_axis(axis, image.ndim)
    labels = _labels_along(inside, connectivity, as_periodic(periodic, image.ndim), along)
    total = int(np.count_nonzero(inside))
    return int(np.count_nonzero(spanning_voxels(labels, along, region))) / total if total else 0.0


def spanning_voxels(labels: np.ndarray, axis: int, region: np.ndarray | None = None) -> np.ndarray:
    """Return the voxels, True, of the components that touch both ends of an axis."""
    through = np.zeros(int(labels.max()) + 1, bool)
    through[_spanning(labels, axis, region)] = True
    return through[labels]


def _labels_along(
    inside: np.ndarray, connectivity: int | None, wraps: tuple[bool, ...], axis: int
) -> np.ndarray:
    """Label components that do not pass the end faces of `axis`."""
    sideways = tuple(wrap and other != axis for other, wrap in enumerate(wraps))
    return label_components(inside, connectivity=connectivity, periodic=sideways)[0]


def _spanning(labels: np.ndarray, axis: int, region: np.ndarray | None) -> np.ndarray:
    """Return the labels that occur in the first and in the last layer of the image, or of the
    region that counts.
    """
    ends = (0, -1)
    if region is not None:
        layers = np.flatnonzero(
            region.any(axis=tuple(other for other in range(labels.ndim) if other != axis))
        )
        ends = (int(layers[0]), int(layers[-1]))
    near, far = (np.unique(labels.take(at, axis=axis)) for at in ends)
    both = np.intersect1d(near, far, assume_unique=True)
    return both[both > 0]


def wrapping_voxels(inside: np.ndarray) -> np.ndarray:
    """Return the voxels of the components (of shared faces) that wrap around the periodic box along
    some direction, (Z, Y, X) bool.

    They alone carry load: all others are islands, which an overall strain moves.
    """
    labels, periods = wrapping_components(inside)
    bears = np.zeros(int(labels.max(initial=0)) + 1, bool)
    bears[list(periods)] = True
    return bears[labels]


def wrapping_components(
    inside: np.ndarray, *, connectivity: int = 6
) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """Label the components of the periodic box, and find along which periods they meet themselves.

    Parameters
    ----------
    inside : bool array, (Z, Y, X)
    connectivity : {6, 26}

    Returns
    -------
    labels : int32 array, (Z, Y, X)
    periods : dict
        Label of every component that wraps -> (n, 3) int64: periods along z, y, x from a voxel to
        itself; they span all directions that it wraps along.
    """
    labels, sizes = label_components(inside, connectivity=connectivity)
    count = len(sizes)
    parent = list(range(count + 1))
    # of a component's box, seen from its parent's
    offset: list[tuple[int, ...]] = [(0, 0, 0)] * (count + 1)
    gaps: list[tuple[int, tuple[int, ...]]] = []
    for axis in range(3):
        for low, high, *step in _meetings(labels, axis, aside=connectivity == 26):
            _join(parent, offset, gaps, low, high, tuple(step))
    roots = np.array([_root(parent, offset, k)[0] for k in range(count + 1)], np.int32)
    found: dict[int, list[tuple[int, ...]]] = {}
    for member, gap in gaps:
        found.setdefault(int(roots[member]), []).append(gap)
    return roots[labels], {root: np.unique(gap, axis=0) for root, gap in found.items()}


def _meetings(labels: np.ndarray, axis: int, *, aside: bool) -> list[list[int]]:
    """Return the labels that meet across the end faces of an axis, each with the periods z, y, x
    that lie between; `aside`: also by an edge or a node.
    """
    far, near = labels.take(-1, axis=axis), labels.take(0, axis=axis)
    first, second = (other for other in range(3) if other != axis)
    places = np.argwhere(far > 0)
    found: list[np.ndarray] = [np.empty((0, 5), np.int64)]
    for shift in product((-1, 0, 1), repeat=2) if aside else [(0, 0)]:
        periods, beside = np.divmod(places + shift, far.shape)
        rows = np.zeros((len(places), 5), np.int64)
        rows[:, 0], rows[:, 1] = far[tuple(places.T)], near[tuple(beside.T)]
        rows[:, 2 + axis] = 1
        rows[:, 2 + first], rows[:, 2 + second] = periods.T
        found.append(np.unique(rows[rows[:, 1] > 0], axis=0))
    return np.unique(np.concatenate(found), axis=0).tolist()


def _root(parent: list[int], offset: list[tuple[int, ...]], k: int) -> tuple[int, tuple[int, ...]]:
    """Return the root of a component, and its box seen from the root's."""
    total: tuple[int, ...] = (0, 0, 0)
    path = []
    while parent[k] != k:
        path.append(k)
        k = parent[k]
    for member in reversed(path):  # from the root's child down, so that each one's parent is done
        total = tuple(a + b for a, b in zip(total, offset[member], strict=True))
        parent[member], offset[member] = k, total
    return k, total


def _join(
    parent: list[int],
    offset: list[tuple[int, ...]],
    gaps: list[tuple[int, tuple[int, ...]]],
    a: int,
    b: int,
    step: tuple[int, ...],
) -> None:
    """Join component b, one `step` of boxes on, to a, which it touches; where they are one already,
    note the periods between the two ways.
    """
    root_a, from_a = _root(parent, offset, a)
    root_b, from_b = _root(parent, offset, b)
    gap = tuple(p + s - q for p, s, q in zip(from_a, step, from_b, strict=True))
    if root_a != root_b:
        parent[root_b], offset[root_b] = root_a, gap
    elif any(gap):
        gaps.append((root_a, gap))
