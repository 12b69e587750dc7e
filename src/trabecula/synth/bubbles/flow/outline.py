"""Following the outline of a slice: the slice is blurred, and its gradient turned by 90 degrees
runs along the border.

The blur is the mean over a disc, whose radius is the thickness of the zone: deeper than that the
gradient is exactly 0 and the zone ends (section 3.4: the kernel's size is the thickness of the
border). All sums are whole numbers. Thick zones are found on cells of several voxels."""

from __future__ import annotations

import math

import numpy as np

_FINE = 8  # cells that a zone is thick, at least, where it is not thinner in voxels


def along_outline(plane: np.ndarray, thickness: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Vectors along the border of what a slice holds, 0 where none is near.

    Parameters
    ----------
    plane : (V, U) bool array
        Nothing of the form lies beyond it.
    thickness : float
        Voxels from the border up to which it is followed, above 0.

    Returns
    -------
    rows, columns : float64 arrays, one value a cell
        Whole numbers, of no particular length; the sense is that of x' = -y, y' = x about a place
        inside.
    every : int
        Voxels along the edge of a cell.
    """
    every, cells = cell_of(thickness)
    counts = _counts(plane, every)
    rows, columns = np.zeros((2, *counts.shape))
    held = held_of(counts)  # what lies around the form is nobody's
    smooth = _disc_sums(np.pad(counts[held], cells), cells - 1)
    rows[held] = -(smooth[1:-1, 2:] - smooth[1:-1, :-2])
    columns[held] = smooth[2:, 1:-1] - smooth[:-2, 1:-1]
    return rows, columns, every


def cell_of(thickness: float) -> tuple[int, int]:
    """Voxels along the edge of a cell, and the cells that a zone is thick."""
    every = max(1, int(thickness / _FINE))
    return every, max(1, round(thickness / every))


def _counts(plane: np.ndarray, every: int) -> np.ndarray:
    """Voxels held in cells of `every` a side."""
    if every == 1:
        return plane.astype(np.int32)
    whole = np.pad(plane, [(0, -side % every) for side in plane.shape]).view(np.uint8)
    rows, columns = (side // every for side in whole.shape)
    return whole.reshape(rows, every, columns, every).sum(axis=(1, 3), dtype=np.int32)


def held_of(plane: np.ndarray) -> tuple[slice, ...]:
    """The box around what is not 0; of nothing an empty one."""
    ends = [np.flatnonzero(plane.any(axis=other)) for other in (1, 0)]
    return tuple(
        slice(int(held[0]), int(held[-1]) + 1) if len(held) else slice(0, 0) for held in ends
    )


def _disc_sums(values: np.ndarray, radius: int) -> np.ndarray:
    """Sums over the disc around every cell that lies `radius` cells or more from the array's faces."""
    height, width = (side - 2 * radius for side in values.shape)
    sums = np.zeros((values.shape[0], values.shape[1] + 1), np.int64)
    np.cumsum(values, axis=1, out=sums[:, 1:])
    total = np.zeros((height, width), np.int64)
    for row in range(-radius, radius + 1):
        half = math.isqrt(radius * radius - row * row)
        near = sums[radius + row : radius + row + height]
        total += near[:, radius + half + 1 : radius + half + 1 + width]
        total -= near[:, radius - half : radius - half + width]
    return total
