"""Pairs at every offset at once, by Fourier transform; averaged over the mirror images of each
offset.

An average over directions, or a curve along an axis, needs no difference between (dz, dy, dx) and
(-dz, dy, dx). Averaged over such mirror images the correlation is even along every axis, so the
real and imaginary parts of the transform along one axis never mix with those along another: every
pass is a transform of *real* lines, a fifth of the cost of a complex one in NumPy, and the
transform back is a product with a small matrix of cosines that yields only the offsets within
reach.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.parallel import for_slabs, thread_count
from trabecula.numerics.transforms import fast_side

_TOGETHER = 1 << 14  # numbers of small planes that are transformed by one call


def count_mirror_pairs(
    first: np.ndarray,
    second: np.ndarray | None,
    reach: tuple[int, ...],
    wraps: tuple[bool, ...],
    *,
    exact: bool = False,
) -> np.ndarray:
    """Count pairs of voxels, the first True in `first` and the other in `second`, for every offset.

    Parameters
    ----------
    first, second : bool array, (Z, Y, X)
        `second` None means `first`.
    reach : three ints
        Largest offset along every axis: at most half of a side that wraps, below any other.
    wraps : three bools
        Whether pairs wrap around the faces of that axis; others are padded by `reach`.
    exact : bool
        Transform in float64, twice the memory. In float32 an entry was wrong by 4e-8 of the voxels
        of the phase at most (500^3 voxels, 85 % and 99.9 % full).

    Returns
    -------
    counts : float64 array, (reach + 1 along every axis)
        Mean over the eight mirror images of the offset, of which the opposite one swaps the two
        ends.
    """
    if first.shape[0] < first.shape[1]:
        # Few large planes would need several of their size at once.
        across = None if second is None else second.swapaxes(0, 1)
        reach, wraps = (reach[1], reach[0], reach[2]), (wraps[1], wraps[0], wraps[2])
        return count_mirror_pairs(first.swapaxes(0, 1), across, reach, wraps, exact=exact).swapaxes(
            0, 1
        )
    sides = tuple(
        side if wrap else fast_side(side + far)
        for side, far, wrap in zip(first.shape, reach, wraps, strict=True)
    )
    ours = _transform(first, sides, exact)
    theirs = ours if second is None else _transform(second, sides, exact)
    back = [_cosines(side, far) for side, far in zip(sides, reach, strict=True)]
    counts = _powers(ours, theirs, sides, back)
    # Eight times a mean over eight mirror images is a whole number: what rounding errors add goes
    # off again.
    counts = np.rint(np.tensordot(back[2], counts, 1).transpose(2, 1, 0) * 8) / 8
    counts[0, 0, 0] = np.count_nonzero(first if second is None else first & second)
    return counts


def transform_bytes(shape: tuple[int, int, int], reach: tuple[int, ...], *, exact: bool) -> int:
    """Forecast the memory of `count_mirror_pairs` of an array of `shape` with itself, no axis
    periodic.
    """
    (depth, height, width), (far_z, far_y, far_x) = shape, reach
    if depth < height:
        depth, height = height, depth
        far_z, far_y = far_y, far_z
    half_y, half_x = (
        fast_side(side + far) // 2 + 1 for side, far in ((height, far_y), (width, far_x))
    )
    lines = depth * half_x * 4 * half_y
    # A thread transforms some planes of its own: rows and columns, then lines along z and their
    # powers.
    planes = thread_count() * 8 * half_y * max(2 * half_x, fast_side(depth + far_z) + 2)
    return (8 if exact else 4) * (lines + planes) + 8 * half_x * (far_y + 1) * (far_z + 1)


def _transform(inside: np.ndarray, sides: tuple[int, ...], exact: bool) -> np.ndarray:
    """Transform along x and y: (Z, frequencies of x, 4 times those of y), where the 4 are the
    products of real and imaginary part along either axis.
    """
    real = np.float64 if exact else np.float32
    half_y, half_x = (side // 2 + 1 for side in sides[1:])
    lines = np.empty((len(inside), half_x, 4 * half_y), real)
    few = max(1, _TOGETHER // lines[0].size)

    def slab(start: int, stop: int) -> None:
        for z in range(start, stop, few):
            some = slice(z, min(z + few, stop))
            rows = np.fft.rfft(inside[some].astype(real), sides[2], axis=2).view(real)
            columns = np.ascontiguousarray(rows.swapaxes(1, 2))
            parts = np.fft.rfft(columns, sides[1], axis=2).view(real)
            lines[some] = parts.reshape(-1, half_x, 4 * half_y)

    for_slabs(slab, len(inside))
    return lines


def _powers(
    ours: np.ndarray, theirs: np.ndarray, sides: tuple[int, ...], back: list[np.ndarray]
) -> np.ndarray:
    """Transform along z, multiply the two, and transform back along z and y: (frequencies of x, dy,
    dz).
    """
    half_z, half_y = sides[0] // 2 + 1, sides[1] // 2 + 1
    depth, half_x, parts = ours.shape
    counts = np.empty((half_x, len(back[1]), len(back[0])))
    few = max(1, _TOGETHER // (depth * parts))

    def slab(start: int, stop: int) -> None:
        for x in range(start, stop, few):
            some = slice(x, min(x + few, stop))
            power = _along_z(ours, some, sides[0])
            power *= power if theirs is ours else _along_z(theirs, some, sides[0])
            # Lines are (part along x, frequency of y, part along y), columns (frequency of z, part
            # along z).
            power = power.reshape(-1, 2, half_y, 2, half_z, 2)
            power = power[..., 0] + power[..., 1]
            power = power[:, 0, :, 0] + power[:, 0, :, 1] + power[:, 1, :, 0] + power[:, 1, :, 1]
            counts[some] = back[1] @ (power.astype(np.float64) @ back[0].T)

    for_slabs(slab, half_x)
    return counts


def _along_z(lines: np.ndarray, some: slice, side: int) -> np.ndarray:
    own = np.ascontiguousarray(np.moveaxis(lines[:, some], 0, -1))
    return np.fft.rfft(own, side, axis=-1).view(lines.dtype)


def _cosines(side: int, reach: int) -> np.ndarray:
    """Return the transform back from the powers of a real line to its even correlation: (reach + 1,
    side // 2 + 1).
    """
    frequency = np.arange(side // 2 + 1)
    # Every frequency but 0 and, of an even side, the last stands also for its negative.
    weights = np.where((frequency == 0) | (2 * frequency == side), 1.0, 2.0) / side
    turns = np.outer(np.arange(reach + 1), frequency) % side
    return np.asarray(weights * np.cos(2 * np.pi / side * turns))
