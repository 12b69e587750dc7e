"""Connected components, and what hangs together from face to face.

Runs of voxels along x are joined by union-find, root = the run that comes first, so that components are numbered by
their first voxel in raster order. Voxels are visited twice: to find the runs, and to write the labels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.compile import inline, kernel
from trabecula.measure.phases import as_inside, indicator

AXES = ("z", "y", "x")

# Rows before the present one that can hold neighbours, as (dz, dy, how far x may differ).
_ROWS = {
    6: [(0, -1, 0), (-1, 0, 0)],
    18: [(0, -1, 1), (-1, 0, 1), (-1, -1, 0), (-1, 1, 0)],
    26: [(0, -1, 1), (-1, 0, 1), (-1, -1, 1), (-1, 1, 1)],
}
_ROWS[4], _ROWS[8] = _ROWS[6], _ROWS[26]


def label_components(inside: ArrayLike, *, connectivity: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Number the connected components.

    Parameters
    ----------
    inside : bool array, (Z, Y, X) or (Y, X)
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        Neighbours of a voxel. Default: those that share a face (6; 4).

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
    rows = np.array(_ROWS[_checked_connectivity(connectivity, np.ndim(inside))], np.int64)
    solid = as_inside(inside)
    first = _count_runs(solid)
    begin, end = _find_runs(solid, first)
    parent = _join(begin, end, first, rows, solid.shape[1])
    label, sizes = _number(begin, end, parent)
    labels = _paint(solid.shape, begin, end, first, label)
    return labels.reshape(np.shape(inside)), sizes


def components(image: Image | ArrayLike, *, phase: str | int | None = None, connectivity: int | None = None) -> int:
    """Number of connected components of a phase (default "solid": every phase but "void")."""
    return len(_sizes(image, phase, connectivity))


def largest_fraction(
    image: Image | ArrayLike, *, phase: str | int | None = None, connectivity: int | None = None
) -> float:
    """Share of the phase's voxels that lie in its largest component, 0..1; 0 where the phase is empty."""
    return share_of_largest(_sizes(image, phase, connectivity))


def floating(image: Image | ArrayLike, *, phase: str | int | None = None, connectivity: int | None = None) -> int:
    """Number of floating parts: components of a phase (default "solid") beside the largest.

    Parts that touch a face of the image count as well: whether they hold on to something beyond it cannot be known.
    """
    return max(0, len(_sizes(image, phase, connectivity)) - 1)


def floating_voxels(
    image: Image | ArrayLike, *, phase: str | int | None = None, connectivity: int | None = None
) -> int:
    """Voxels of the floating parts (see `floating`)."""
    sizes = _sizes(image, phase, connectivity)
    return int(sizes.sum() - sizes.max(initial=0))


def percolates(
    image: Image | ArrayLike, *, phase: str | int | None = None, connectivity: int | None = None
) -> dict[str, bool]:
    """Whether one component of a phase (default "solid") touches both end faces, for every axis.

    Returns
    -------
    percolates : dict
        `{"z": ..., "y": ..., "x": ...}`; without z in 2-D.
    """
    image, inside = indicator(image, phase)
    return spans(label_components(inside, connectivity=connectivity)[0])


def share_of_largest(sizes: np.ndarray) -> float:
    """The largest of `sizes` over their sum; 0 where there are none."""
    return float(sizes.max() / sizes.sum()) if len(sizes) else 0.0


def spans(labels: np.ndarray) -> dict[str, bool]:
    """For every axis, whether a label other than 0 occurs in both end faces."""
    answer = {}
    for axis, name in enumerate(AXES[3 - labels.ndim :]):
        near, far = (np.unique(labels.take(at, axis=axis)) for at in (0, -1))
        answer[name] = bool(np.any(np.intersect1d(near, far) > 0))
    return answer


def _sizes(image: Image | ArrayLike, phase: str | int | None, connectivity: int | None) -> np.ndarray:
    _, inside = indicator(image, phase)
    return label_components(inside, connectivity=connectivity)[1]


def _checked_connectivity(connectivity: int | None, ndim: int) -> int:
    allowed = (4, 8) if ndim == 2 else (6, 18, 26)
    if connectivity is None:
        return allowed[0]
    if connectivity not in allowed:
        raise InputError(f"connectivity {connectivity} does not exist in {ndim}-D: give {', '.join(map(str, allowed))}")
    return connectivity


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


@inline
def _root(parent, k):
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


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
                    i, j = _root(parent, a), _root(parent, b)
                    parent[max(i, j)] = min(i, j)
                    if end[a] < end[b]:
                        a += 1
                    else:
                        b += 1
    return parent


@kernel
def _number(begin, end, parent):
    """Label of every run and size of every label. A root comes before all runs of its tree."""
    label = np.empty(len(parent), np.int32)
    sizes = np.zeros(len(parent), np.int64)
    count = 0
    for k in range(len(parent)):
        root = _root(parent, k)
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
