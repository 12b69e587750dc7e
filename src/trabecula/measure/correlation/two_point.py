"""Two points in a phase, in two phases, or in one connected cluster.

For clusters along a ray, labels are compared. Their radial average needs every offset: a cluster is
transformed alone, in its own box, or, where that would take longer (all but the largest few), its
pairs of voxels are visited one by one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image
from trabecula.engine.compile import kernel
from trabecula.engine.rows import copy_row
from trabecula.measure.correlation.fourier import count_mirror_pairs
from trabecula.measure.correlation.pair_geometry import (
    Radial,
    positive_fits,
    probability,
    select_pairs,
)
from trabecula.measure.correlation.window import Window, as_window
from trabecula.measure.labelling import label_components
from trabecula.measure.phases import indicator
from trabecula.numerics.transforms import fast_side

# Seconds, on one core of 2024, only to choose between two ways to the same counts.
_PAIR, _TRANSFORMED_VOXEL, _TRANSFORMED_PLANE = 2.5e-9, 9e-9, 6e-5


def two_point(
    image: Image | ArrayLike,
    *,
    r_max: int,
    phase: str | int | None = None,
    axis: int | None = None,
    direction: Sequence[float] | None = None,
    periodic: bool | Sequence[bool] = False,
    mask: ArrayLike | None = None,
) -> np.ndarray:
    """Return the two-point probability S2(r) of a phase, r = 0 .. r_max.

    The probability that two points a distance r apart are both in the phase, in Torquato's
    normalisation: S2(0) = phi, and S2 tends to phi^2 (Torquato 2002, doi:10.1007/978-1-4757-6355-3,
    section 2.2). `covariance_form` scales it to 1 .. 0. Here it is the number of pairs of voxels in
    the phase over the number of pairs that fit.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    r_max : int
        Largest distance, in voxels (of the smallest edge, where edges differ), or in steps of
        `direction`.
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    axis : int, optional
        Only pairs along this axis, r in voxels of it. Default, without `direction` too: the radial
        average, over every offset whose length rounds to r; the length is in units of the smallest
        voxel edge.
    direction : sequence of float, one per axis, optional
        Only pairs along this vector of voxels, slowest axis first: the ends of sample r are `r *
        direction` apart, a length of `r * norm(direction * spacing)`. Where that is a voxel, as
        always with whole numbers such as (1, 1, 0), that offset is used; otherwise pairs are
        interpolated linearly between the offsets around it. A direction `u` of length 1 in space,
        in steps of the smallest edge, is `u * min(spacing) / spacing`.
    periodic : bool or one per axis
        Pairs wrap around the faces.
    mask : bool array, the image's shape, optional
        Only pairs with both ends in the mask count.

    Returns
    -------
    s2 : float64 array, (r_max + 1,)
        0 .. 1; S2(0) is the fraction of the phase.

    Raises
    ------
    InputError
        r_max that does not fit the image, or a distance at which the mask holds no pair.

    Examples
    --------
    >>> two_point(np.array([[1, 1, 0, 0, 1, 1, 0, 0]]), r_max=2, axis=1, periodic=True).tolist()
    [0.5, 0.25, 0.0]
    >>> two_point(np.eye(4, dtype=int), r_max=3, direction=(1, 1)).tolist()
    [0.25, 0.3333333333333333, 0.5, 1.0]
    """
    image, inside = indicator(image, phase)
    window = as_window(image.shape, periodic, mask)
    pairs = select_pairs(image, window, r_max=r_max, axis=axis, direction=direction)
    fits = positive_fits(pairs)
    return probability(pairs.count(window.within(inside), None, fits), fits)


def cross_correlation(
    image: Image | ArrayLike,
    *,
    first: str | int,
    second: str | int,
    r_max: int,
    axis: int | None = None,
    direction: Sequence[float] | None = None,
    periodic: bool | Sequence[bool] = False,
    mask: ArrayLike | None = None,
) -> np.ndarray:
    """Return the two-point probability S_ij(r) across phases, r = 0 .. r_max: one end in phase i,
    the other in phase j.

    Torquato 2002, doi:10.1007/978-1-4757-6355-3, section 2.2. Both orders of the two ends are
    counted and averaged, so that S_ij = S_ji, and each probability is out of all pairs that fit:
    the sum over all i and j is 1 at every r, and the sum over j is the fraction of ends in
    phase i (phi_i, where the image is periodic). S_ii is `two_point`.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    first, second : str or int
        The phases i and j.
    r_max, axis, direction, periodic, mask
        As in `two_point`.

    Returns
    -------
    s_ij : float64 array, (r_max + 1,)
        0 .. 1; 0 at r = 0 where the phases differ; tends to phi_i phi_j.

    Raises
    ------
    InputError
        As `two_point`, and no such phase.

    Examples
    --------
    >>> stripes = np.array([[1, 1, 0, 0, 1, 1, 0, 0]])
    >>> cross_correlation(stripes, first=0, second=1, r_max=2, axis=1, periodic=True).tolist()
    [0.0, 0.25, 0.5]
    """
    image, ours = indicator(image, first)
    theirs = indicator(image, second)[1]
    window = as_window(image.shape, periodic, mask)
    pairs = select_pairs(image, window, r_max=r_max, axis=axis, direction=direction)
    fits = positive_fits(pairs)
    return probability(pairs.count(window.within(ours), window.within(theirs), fits), fits)


def two_point_cluster(
    image: Image | ArrayLike,
    *,
    r_max: int,
    phase: str | int | None = None,
    connectivity: int | None = None,
    axis: int | None = None,
    direction: Sequence[float] | None = None,
    periodic: bool | Sequence[bool] = False,
    mask: ArrayLike | None = None,
) -> np.ndarray:
    """Return the two-point cluster function C2(r) of a phase, r = 0 .. r_max: both ends in the same
    connected cluster of it.

    Torquato, Beasley and Chiew 1988, doi:10.1063/1.454440; as a descriptor Jiao, Stillinger and
    Torquato 2009, doi:10.1073/pnas.0905919106. S2 less the pairs between different clusters, out of
    the same pairs that fit: it falls to 0 beyond the largest cluster, and equals S2 where the phase
    is one cluster.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    r_max, phase, axis, direction
        As in `two_point`.
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        Neighbours of a voxel. Default: those that share a face (6; 4).
    periodic : bool or one per axis
        Pairs wrap around the faces, and so do clusters.
    mask : bool array, the image's shape, optional
        Only what is in the mask counts, and only clusters connected within it.

    Returns
    -------
    c2 : float64 array, (r_max + 1,)
        0 .. S2; C2(0) is the fraction of the phase.

    Raises
    ------
    InputError
        As `two_point`, and another connectivity.

    Examples
    --------
    >>> two_point_cluster(np.array([[1, 1, 0, 1, 0, 1, 1, 1]]), r_max=2, axis=1).tolist()
    [0.75, 0.42857142857142855, 0.16666666666666666]
    """
    image, inside = indicator(image, phase)
    window = as_window(image.shape, periodic, mask)
    pairs = select_pairs(image, window, r_max=r_max, axis=axis, direction=direction)
    solid = window.within(inside)
    wraps = window.wraps[3 - image.ndim :]
    labels, sizes = label_components(
        solid.reshape(image.shape), connectivity=connectivity, periodic=wraps
    )
    fits = positive_fits(pairs)
    labels = labels.reshape(window.shape)
    hits = _radial(labels, sizes, pairs) if isinstance(pairs, Radial) else pairs.count_same(labels)
    return probability(hits, fits)


def _radial(labels: np.ndarray, sizes: np.ndarray, pairs: Radial) -> np.ndarray:
    lows, highs = _boxes(labels, len(sizes))
    large = [
        label
        for label in range(1, len(sizes) + 1)
        if _transform_is_faster(sizes, lows, highs, label, pairs)
    ]
    small = np.ones(len(sizes) + 1, bool)
    small[[0, *large]] = False
    first = np.concatenate([[0], np.cumsum(np.where(small[1:], sizes, 0))])
    sides, wraps = np.array(labels.shape), np.array(pairs.window.wraps)
    voxels = _voxels(labels, small, first)
    counts = _pairs_one_by_one(voxels, first, pairs.lengths(), sides, wraps, pairs.r_max)
    hits = counts.astype(np.float64)
    for label in large:
        hits += _count_by_transform(labels, label, lows[label], highs[label], pairs)
    return hits


def _box(
    low: np.ndarray, high: np.ndarray, pairs: Radial
) -> tuple[tuple[slice, ...], Window, tuple[int, ...]]:
    """Return the bounding box of a cluster, as a window of its own; an axis around which its pairs
    could wrap is taken whole.
    """
    window = pairs.window
    sides = [
        (slice(0, side), True, far)
        if wrap and end - begin + far > side
        else (slice(begin, end), False, min(far, end - begin - 1))
        for begin, end, side, wrap, far in zip(
            low.tolist(), high.tolist(), window.shape, window.wraps, pairs.reach, strict=True
        )
    ]
    box, wraps, reach = zip(*sides, strict=True)
    return box, Window(tuple(part.stop - part.start for part in box), wraps), reach


def _transform_is_faster(
    sizes: np.ndarray, lows: np.ndarray, highs: np.ndarray, label: int, pairs: Radial
) -> bool:
    one_by_one = _PAIR * sizes[label - 1] ** 2 / 2
    if one_by_one < 40 * _TRANSFORMED_PLANE:
        return False
    _, window, reach = _box(lows[label], highs[label], pairs)
    sides = [fast_side(side + far) for side, far in zip(window.shape, reach, strict=True)]
    planes = window.shape[0] + sides[2] // 2
    return bool(one_by_one > _TRANSFORMED_VOXEL * math.prod(sides) + _TRANSFORMED_PLANE * planes)


def _count_by_transform(
    labels: np.ndarray, label: int, low: np.ndarray, high: np.ndarray, pairs: Radial
) -> np.ndarray:
    box, window, reach = _box(low, high, pairs)
    counts = np.zeros(tuple(far + 1 for far in pairs.reach))
    within = tuple(slice(far + 1) for far in reach)
    counts[within] = count_mirror_pairs(labels[box] == label, None, reach, window.wraps)
    return pairs.sum(counts)


@kernel
def _boxes(labels, count):
    """Return the first voxel and one past the last of every label, along every axis."""
    lows = np.full((count + 1, 3), 2**62)
    highs = np.zeros((count + 1, 3), np.int64)
    for z in range(labels.shape[0]):
        for y in range(labels.shape[1]):
            for x in range(labels.shape[2]):
                label = labels[z, y, x]
                if label:
                    for axis, at in enumerate((z, y, x)):
                        lows[label, axis] = min(lows[label, axis], at)
                        highs[label, axis] = max(highs[label, axis], at + 1)
    return lows, highs


@kernel
def _voxels(labels, chosen, first):
    """List the voxels of the chosen labels, label by label; those of label k begin at first[k -
    1].
    """
    voxels = np.empty((first[-1], 3), np.int32)
    ends = first[:-1].copy()
    for z in range(labels.shape[0]):
        for y in range(labels.shape[1]):
            for x in range(labels.shape[2]):
                label = labels[z, y, x]
                if chosen[label]:
                    copy_row(voxels[ends[label - 1]], (z, y, x))
                    ends[label - 1] += 1
    return voxels


@kernel
def _pairs_one_by_one(voxels, first, lengths, sides, wraps, r_max):
    """Count ordered pairs within every stretch first[k] .. first[k + 1], by their rounded
    distance.
    """
    counts = np.zeros(r_max + 1, np.int64)
    far_z, far_y, far_x = lengths.shape
    for k in range(len(first) - 1):
        for i in range(first[k], first[k + 1]):
            counts[0] += 1
            for j in range(i + 1, first[k + 1]):
                dz = abs(voxels[i, 0] - voxels[j, 0])
                dy = abs(voxels[i, 1] - voxels[j, 1])
                dx = abs(voxels[i, 2] - voxels[j, 2])
                if wraps[0]:
                    dz = min(dz, sides[0] - dz)
                if wraps[1]:
                    dy = min(dy, sides[1] - dy)
                if wraps[2]:
                    dx = min(dx, sides[2] - dx)
                if dz < far_z and dy < far_y and dx < far_x:
                    length = lengths[dz, dy, dx]
                    if length <= r_max:
                        counts[length] += 2
    return counts
