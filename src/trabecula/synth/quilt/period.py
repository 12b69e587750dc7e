"""Lattices: the period of an exemplar along every axis, and the shift of each exemplar's cells from
those of the first.

They follow from how often voxels at a distance agree, in whole numbers, so that all machines agree.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_LEAST = 4
"""Voxels of the shortest period."""

_PEAK, _RISE = 0.4, 0.2
"""Agreement above chance at the period (1: all voxels), and its rise above the dip before."""

_CLEAR = 0.1
"""Agreement that a multiple away from whole periods has more than one at them."""

_SHARP = 4
"""Phases are distinguished to 1 part in this many of a voxel."""


def agreement(labels: np.ndarray, axis: int, reach: int) -> np.ndarray:
    """Return the share of voxels that agree with the one at a distance along an axis, (reach + 1,),
    above chance: 1 at 0, 0 by chance.
    """
    lines = np.moveaxis(labels, axis, 0)
    shares = np.bincount(labels.ravel()) / labels.size
    chance = float((shares**2).sum())
    equal = [np.count_nonzero(lines[lag:] == lines[: len(lines) - lag]) for lag in range(reach + 1)]
    whole = [(len(lines) - lag) * lines[0].size for lag in range(reach + 1)]
    return (np.array(equal) / np.array(whole) - chance) / (1 - chance)


def period_along(labels: np.ndarray, axis: int) -> float | None:
    """Return the period along an axis in voxels, or None where the exemplar has none.

    It is the first distance of strong agreement beyond a dip, refined by its multiples.

    Examples
    --------
    >>> period_along(np.tile([1, 1, 0, 0, 0, 0, 0], (3, 8)).astype(np.uint8), 1)
    7.0
    """
    side = labels.shape[axis]
    if side < 3 * _LEAST:
        return None
    curve = agreement(labels, axis, side - max(_LEAST, side // 4))
    falls = np.flatnonzero(np.diff(curve) > 0)
    dip = int(falls[0]) if len(falls) else len(curve)
    peaks = [
        lag
        for lag in range(max(dip + 1, _LEAST), len(curve) - 1)
        if curve[lag] >= max(curve[lag - 1], curve[lag + 1], _PEAK)
        and curve[lag] - curve[dip:lag].min() >= _RISE
    ]
    if not peaks or 2 * peaks[0] > side:
        return None
    found = float(peaks[0])
    for times in range(2, (len(curve) - 2) // peaks[0] + 1):
        near = round(times * found)
        lags = np.arange(max(1, near - 1), min(near + 2, len(curve)))
        best = int(lags[np.argmax(curve[lags])])
        if curve[best] < _PEAK:
            break
        # A gradient draws every peak to the near side by less than a voxel: only a clear one
        # counts.
        if (
            best != times * peaks[0]
            and curve[best] - curve[min(times * peaks[0], len(curve) - 1)] < _CLEAR
        ):
            continue
        found = best / times
    return found


def common_periods(stack: Sequence[np.ndarray]) -> tuple[float | None, ...]:
    """Return the periods that all exemplars share, along every axis."""
    found = []
    for axis in range(3):
        each = [period_along(labels, axis) for labels in stack]
        first = each[0]
        same = first is not None and all(
            one is not None and abs(one - first) <= 0.25 for one in each
        )
        found.append(first if same else None)
    return tuple(found)


def cell_shifts(stack: Sequence[np.ndarray], periods: Sequence[float | None]) -> np.ndarray:
    """Return (S, 3) voxels by which each exemplar's cells are shifted along every axis from the
    first one's.
    """
    cells = [_cell_counts(labels, periods) for labels in stack]
    first = np.conj(np.fft.rfftn(cells[0]))
    shifts = np.zeros((len(stack), 3), np.int64)
    for n, cell in enumerate(cells[1:], start=1):
        # The counts are whole, and far below 2**53: rounding makes what the transforms give exact.
        common = np.rint(np.fft.irfftn(np.fft.rfftn(cell) * first, s=cell.shape, axes=(0, 1, 2)))
        shifts[n] = np.unravel_index(int(np.argmax(common)), cell.shape)
    return shifts


def _cell_counts(labels: np.ndarray, periods: Sequence[float | None]) -> np.ndarray:
    """Count the voxels of label 0 at every voxel of a cell; one voxel along axes without a
    period.
    """
    places, sides = [], []
    for side, period in zip(labels.shape, periods, strict=True):
        size = 1 if period is None else round(period)
        places.append(
            np.zeros(side, np.int64)
            if period is None
            else np.floor(np.arange(side) % period).astype(int) % size
        )
        sides.append(size)
    at = np.ravel_multi_index(np.ix_(*places), sides)
    counts = np.bincount(at[labels == 0], minlength=int(np.prod(sides)))
    return counts.reshape(sides).astype(np.float64)


def phase_key(corner: Sequence[int], periods: Sequence[float | None]) -> tuple[int, ...]:
    """Return the phase of a place of the output, in parts of a voxel; 0 along axes without a
    period.
    """
    return tuple(
        0 if period is None else round(at % period * _SHARP)
        for at, period in zip(corner, periods, strict=True)
    )


def positions_in_phase(count: int, key: int, shift: int, period: float | None) -> np.ndarray:
    """Return the positions 0 .. count - 1 along an axis that have a phase, of an exemplar with
    cells shifted by `shift`.
    """
    at = np.arange(count)
    if period is None:
        return at
    off = (at - int(shift) - key / _SHARP + period / 2) % period - period / 2
    near = np.abs(off) <= 0.5
    return at[near]
