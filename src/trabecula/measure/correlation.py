"""Two-point probability and lineal path: how far a phase reaches.

Torquato 2002, "Random Heterogeneous Materials", doi:10.1007/978-1-4757-6355-3: S2(r) (section 2.2.1) is the
probability that two points a distance r apart both lie in the phase. Here it is the share of the pairs of voxels
that fit into the image: the number of pairs is counted for every offset, so nothing is lost to a border of zeros.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.measure.phases import as_inside, indicator

_COLUMN_BYTES = 1 << 25  # memory of the columns that are transformed along z at once


def two_point(
    image: Image | ArrayLike,
    *,
    r_max: int,
    phase: str | int | None = None,
    axis: int | None = None,
    periodic: bool | Sequence[bool] = False,
    mask: ArrayLike | None = None,
) -> np.ndarray:
    """Two-point probability S2(r) of a phase, r = 0 .. r_max.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    r_max : int
        Largest distance, in voxels (of the smallest edge, where edges differ).
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    axis : int, optional
        Only pairs along this axis, r in voxels of it. Default: the radial average, over every offset whose length
        rounds to r; the length is in units of the smallest voxel edge.
    periodic : bool or one per axis
        Pairs wrap around the faces.
    mask : bool array, the image's shape, optional
        Only pairs with both ends in the mask count.

    Returns
    -------
    s2 : float64 array, (r_max + 1,)
        S2(0) is the fraction of the phase. Pairs in the phase over pairs that fit.

    Raises
    ------
    InputError
        r_max that does not fit the image, or a distance at which the mask holds no pair.

    Examples
    --------
    >>> two_point(np.array([[1, 1, 0, 0, 1, 1, 0, 0]]), r_max=2, axis=1, periodic=True).tolist()
    [0.5, 0.25, 0.0]
    """
    image, inside = indicator(image, phase)
    wraps = (False,) * (3 - image.ndim) + _per_axis(periodic, image.ndim)
    where = None if mask is None else _checked_mask(mask, inside.shape)
    inside = as_inside(inside if where is None else inside & where)
    where = None if where is None else as_inside(where)
    if axis is not None:
        if not -image.ndim <= axis < image.ndim:
            raise InputError(f"axis {axis} does not exist: the image has {image.ndim}")
        along = axis % image.ndim + 3 - image.ndim
        _check_range(r_max, inside.shape[along], wraps[along])
        hits = _count_along(inside, r_max, along, wraps[along])
        pairs = (
            _pairs_along(inside.shape, r_max, along, wraps[along])
            if where is None
            else _count_along(where, r_max, along, wraps[along])
        )
    else:
        _check_range(r_max, max(inside.shape), all(wraps))
        steps = (1.0,) * (3 - image.ndim) + tuple(edge / min(image.spacing) for edge in image.spacing)
        reach = _reach(inside.shape, r_max, steps, wraps)
        distance = _offset_bins(reach, steps)
        hits = _radial_sum(_autocorrelation(inside, reach, wraps), distance, r_max)
        fits = _pairs(inside.shape, reach, wraps) if where is None else _autocorrelation(where, reach, wraps)
        pairs = _radial_sum(fits, distance, r_max)
    if not pairs.all():
        r = int(np.flatnonzero(pairs == 0)[0])
        where_to = "the image" if mask is None else "the image and its mask"
        raise InputError(f"no pair of voxels {r} apart fits into {where_to}: lower r_max to {r - 1}")
    return hits / pairs


def covariance_form(s2: ArrayLike) -> np.ndarray:
    """S2 without what porosity alone explains: (S2 - phi^2) / (phi - phi^2), with phi = S2(0).

    1 at r = 0, and 0 where the ends of a pair are independent (Torquato 2002, equation 2.20 scaled). All 0 but the
    first where the phase is empty or alone.
    """
    values = np.asarray(s2, np.float64)
    phi = values[0]
    if not 0 < phi < 1:
        return (np.arange(len(values)) == 0).astype(np.float64)
    return (values - phi**2) / (phi - phi**2)


def lineal_path(
    image: Image | ArrayLike, *, r_max: int, phase: str | int | None = None, axis: int | None = None
) -> np.ndarray:
    """Lineal path function L(r), r = 0 .. r_max: the probability that a segment of length r lies wholly in the phase.

    Lu and Torquato 1992, doi:10.1103/PhysRevA.45.922. A segment of length r is r + 1 voxels in a row, r in voxels of
    its axis; the share is of the segments that fit into the image.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    r_max : int
        Largest length in voxels, below the side of every axis asked for.
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    axis : int, optional
        Segments along this axis only. Default: along every axis, all segments taken together.

    Returns
    -------
    path : float64 array, (r_max + 1,)
        L(0) is the fraction of the phase; L never rises.

    Raises
    ------
    InputError
        r_max that does not fit.

    Examples
    --------
    >>> lineal_path(np.array([[1, 1, 0, 1]]), r_max=1, axis=1).tolist()
    [0.75, 0.3333333333333333]
    """
    image, inside = indicator(image, phase)
    if axis is not None and not -image.ndim <= axis < image.ndim:
        raise InputError(f"axis {axis} does not exist: the image has {image.ndim}")
    hits = np.zeros(r_max + 1 if r_max >= 0 else 0)
    fits = np.zeros_like(hits)
    for along in range(image.ndim) if axis is None else (axis % image.ndim,):
        _check_range(r_max, image.shape[along], False)
        # Segments of r + 1 voxels are those of r voxels, ended by one more: no need to look at every length anew.
        lines = _packed(as_inside(inside), along + 3 - image.ndim)
        rows = lines
        for r in range(r_max + 1):
            if r:
                rows = rows[:-1] & lines[r:]
            hits[r] += int(np.bitwise_count(rows).sum(dtype=np.int64))
            fits[r] += inside.size // image.shape[along] * (image.shape[along] - r)
    return hits / fits


def _per_axis(periodic: bool | Sequence[bool], ndim: int) -> tuple[bool, ...]:
    wraps = (
        (bool(periodic),) * ndim if isinstance(periodic, (bool, np.bool_)) else tuple(bool(wrap) for wrap in periodic)
    )
    if len(wraps) != ndim:
        raise InputError(f"periodic has {len(wraps)} values: give one, or one for each of the {ndim} axes")
    return wraps


def _checked_mask(mask: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    array = np.asarray(mask)
    if array.dtype != bool or array.shape != shape:
        raise InputError(
            f"the mask is {array.dtype} of shape {array.shape}: a boolean array of shape {shape} is needed"
        )
    return array


def _check_range(r_max: int, side: int, wraps: bool) -> None:
    limit = side // 2 if wraps else side - 1
    if not 0 <= r_max <= limit:
        what = "half of it, the image is periodic" if wraps else "below it"
        raise InputError(f"r_max {r_max} does not fit a side of {side} voxels: give 0 .. {limit} ({what})")


def _packed(inside: np.ndarray, axis: int) -> np.ndarray:
    """`axis` first, the other two packed to bits: a shift along `axis` is a slice, and a word holds 64 voxels."""
    lines = np.moveaxis(inside, axis, 0)
    flat = np.packbits(lines.reshape(len(lines), -1), axis=1)
    words = np.zeros((len(flat), -(-flat.shape[1] // 8) * 8), np.uint8)
    words[:, : flat.shape[1]] = flat
    return words.view(np.uint64)


def _count_along(inside: np.ndarray, r_max: int, axis: int, wraps: bool) -> np.ndarray:
    lines = _packed(inside, axis)
    if wraps:
        lines = np.concatenate([lines, lines[:r_max]])
    side = inside.shape[axis]
    counts = np.empty(r_max + 1)
    for r in range(r_max + 1):
        count = side if wraps else side - r
        counts[r] = np.bitwise_count(lines[:count] & lines[r : r + count]).sum(dtype=np.int64)
    return counts


def _pairs_along(shape: tuple[int, ...], r_max: int, axis: int, wraps: bool) -> np.ndarray:
    side, size = shape[axis], int(np.prod(shape))
    return size // side * np.where(wraps, float(side), side - np.arange(r_max + 1.0))


def _reach(shape: tuple[int, ...], r_max: int, steps: tuple[float, ...], wraps: tuple[bool, ...]) -> tuple[int, ...]:
    """The largest offset along every axis: what can round to r_max, and fits."""
    fits = [side // 2 if wrap else side - 1 for side, wrap in zip(shape, wraps, strict=True)]
    return tuple(min(int((r_max + 0.5) / step), fit) for step, fit in zip(steps, fits, strict=True))


def _offset_bins(reach: tuple[int, ...], steps: tuple[float, ...]) -> np.ndarray:
    """Length of every offset, rounded: z runs over 0..reach (the other half is its mirror), y and x over
    -reach..reach."""
    z, y, x = (
        np.arange(0 if axis == 0 else -far, far + 1) * step
        for axis, (far, step) in enumerate(zip(reach, steps, strict=True))
    )
    square = (z**2)[:, None, None] + (y**2)[:, None] + x**2
    return (np.sqrt(square) + 0.5).astype(np.int32)


def _radial_sum(counts: np.ndarray, distance: np.ndarray, r_max: int) -> np.ndarray:
    near = distance <= r_max
    # Offsets with z = 0 come with their mirror image, those with z > 0 stand for two.
    weights = counts.astype(np.float64)
    weights[1:] *= 2
    return np.bincount(distance[near], weights=weights[near], minlength=r_max + 1)


def _pairs(shape: tuple[int, ...], reach: tuple[int, ...], wraps: tuple[bool, ...]) -> np.ndarray:
    """Pairs of voxels that fit, for every offset (as `_autocorrelation`, of an image full of the phase)."""
    z, y, x = (
        np.full(2 * far + 1, float(side)) if wrap else side - np.abs(np.arange(-far, far + 1.0))
        for side, far, wrap in zip(shape, reach, wraps, strict=True)
    )
    return z[reach[0] :, None, None] * y[:, None] * x


def _autocorrelation(inside: np.ndarray, reach: tuple[int, ...], wraps: tuple[bool, ...]) -> np.ndarray:
    """Pairs of True voxels for every offset (dz, dy, dx): dz in 0..reach, dy and dx in -reach..reach.

    By Fourier transform in float32, padded by `reach` alone. Only lines that hold something are transformed, and the
    way back keeps only the offsets within reach after every axis. Counts are whole numbers, so what float32 adds is
    rounded off again.
    """
    sides = [side if wrap else _smooth(side + far) for side, far, wrap in zip(inside.shape, reach, wraps, strict=True)]
    spectrum = np.empty((inside.shape[0], sides[1], sides[2] // 2 + 1), np.complex64)
    for z, plane in enumerate(inside):
        spectrum[z] = np.fft.fft(np.fft.rfft(plane.astype(np.float32), sides[2], axis=1), sides[1], axis=0)
    power = np.empty((reach[0] + 1, *spectrum.shape[1:]), np.complex64)
    rows = max(1, _COLUMN_BYTES // (8 * sides[0] * spectrum.shape[2]))
    for y in range(0, sides[1], rows):
        column = np.fft.fft(spectrum[:, y : y + rows], sides[0], axis=0)
        column *= column.conj()
        power[:, y : y + rows] = np.fft.ifft(column, axis=0)[: reach[0] + 1]
    near_y, near_x = (np.arange(-far, far + 1) % side for far, side in zip(reach[1:], sides[1:], strict=True))
    counts = np.empty((reach[0] + 1, len(near_y), len(near_x)))
    for z, plane in enumerate(power):
        lines = np.fft.ifft(plane, axis=0)[near_y]
        counts[z] = np.rint(np.fft.irfft(lines, sides[2], axis=1)[:, near_x])
    counts[0, reach[1], reach[2]] = np.count_nonzero(inside)
    return counts


def _smooth(side: int) -> int:
    """The smallest number from `side` up whose only prime factors are 2, 3 and 5: fast to transform."""
    while True:
        rest = side
        for prime in (2, 3, 5):
            while rest % prime == 0:
                rest //= prime
        if rest == 1:
            return side
        side += 1
