"""Phases of a scan: how many its grey values or colours tell, and which voxel belongs to which.

Inside a phase the level of a scan is even, between two phases it climbs. So the mean squared
gradient of the voxels of a level has a minimum at every phase and a maximum between two (Weszka and
Rosenfeld 1979, "Histogram modification for threshold selection", IEEE Transactions on Systems, Man,
and Cybernetics 9, 38-52: pixels of low and of high gradient). It tells phases that overlap so far
that the histogram has one hump; of noise without phases it is flat, since gradient and level of a
Gaussian field are independent. Where it has less than two maxima, Otsu's criterion says whether
there are two phases.

Two phases are split by Otsu's threshold, as `exemplar.segment` does, three at the steepest levels.
A scan whose grain would cross its thresholds is smoothed by a voxel first. Of three phases, a voxel
on the way from the darkest to the brightest has the middle one's level; where the level climbs too
fast for a middle phase, it belongs to the side that it is nearer to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.exemplar.segment import otsu
from trabecula.measure.smooth import gaussian, reach_of

NEAR = 2
"""Voxels to either side within which a transition between phases is completed."""

_SMOOTH = 1.0  # voxels: grain is no structure
_CLEAR = 0.65  # between-class variance over the variance; of one normal distribution it is 2 / pi
_CLEARER = 0.7  # where no level is steeper than others: noise of few bodies reaches .66
_RARE = 0.005  # a phase of less is not learnt
_LEVELS = 24  # of the profile of gradients, each of as many voxels
_RISE = 1.3  # of a maximum over the minima beside it
_MOST = 2  # thresholds
_ALIKE = 0.8  # of a maximum
_QUIET = 2.5  # standard deviations of the grain between two phases that it does not mix
_LUMINANCE = np.array([0.299, 0.587, 0.114], np.float32)  # ITU-R BT.601


@dataclass(frozen=True)
class ScanPhases:
    """Where phases of a scan begin, in the units of a field.

    Attributes
    ----------
    thresholds : tuple of float
        One or two, rising; phase 0 is the darkest.
    smooth : float
        Width of the Gaussian by which a field is smoothed before, voxels.
    """

    thresholds: tuple[float, ...]
    smooth: float

    @property
    def count(self) -> int:
        """Count the phases."""
        return len(self.thresholds) + 1

    @property
    def reach(self) -> int:
        """Return the voxels to either side that the phase of a voxel depends on."""
        more = reach_of(_SMOOTH) + 1 if self.count > 2 else 0
        return max(reach_of(self.smooth) + NEAR, more)

    def structure_of(self, field: np.ndarray) -> np.ndarray:
        """Return the phases (Z, Y, X) uint8 of a field (C, Z, Y, X)."""
        levels = gaussian(luminance(field), self.smooth)
        structure = (levels > np.float32(self.thresholds[0])).astype(np.uint8)
        if self.count > 2:
            low, high = (np.float32(level) for level in self.thresholds)
            structure += levels > high
            slopes = _squared_gradient(gaussian(luminance(field), _SMOOTH), (1.0,) * 3)
            crossed = slopes * np.float32((NEAR + 0.5) ** 2) > (high - low) ** 2
            crossed &= (structure == 1) & (_extreme(levels, np.maximum) > high)
            crossed &= _extreme(levels, np.minimum) < low
            structure[crossed] = np.where(levels[crossed] > (low + high) / 2, 2, 0)
        return structure

    def bounds(self, structure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the lowest and the highest level (Z, Y, X) float32 that the smoothed field may
        have; the darkest and the brightest of three phases meet halfway.
        """
        ends = np.array([-np.inf, *self.thresholds, np.inf], np.float32)
        low, high = ends[structure], ends[structure + np.uint8(1)]
        if self.count > 2:
            middle = (ends[1] + ends[2]) / np.float32(2)
            touching = _extreme(structure, np.minimum) == 0
            touching &= _extreme(structure, np.maximum) == 2
            low[touching & (structure == 2)] = middle
            high[touching & (structure == 0)] = middle
        return low, high


def find_phases(
    fields: Sequence[np.ndarray], edges: Sequence[float], *, way: str = "found"
) -> ScanPhases | None:
    """Find the phases of fields; None where these tell none.

    Parameters
    ----------
    fields : sequence of (C, Z, Y, X) float32
        Grey values, or colours, of which the luminance counts.
    edges : three floats
        Sides of a voxel over their geometric mean.
    way : {"found", "two"}
        "found": as many as the gradients tell, at most three. "two": two of the smoothed scan, or
        none where Otsu's criterion does not tell them.
    """
    plain = np.concatenate([luminance(field).ravel() for field in fields])
    smooth = [gaussian(luminance(field), _SMOOTH) for field in fields]
    values = np.concatenate([part.ravel() for part in smooth])
    if not values.var(dtype=np.float64):
        return None
    squares = np.concatenate([_squared_gradient(part, edges).ravel() for part in smooth])
    steepest = _steepest_levels(values, squares, otsu(plain)[0]) if way == "found" else ()
    if len(steepest) > 1 and _are_common(values, steepest):
        grainy = way == "two" or _is_grainy(plain, values, squares, steepest)
        return ScanPhases(steepest, _SMOOTH if grainy else 0.0)
    found = otsu(values)
    least = _CLEAR if steepest or way == "two" else _CLEARER
    if not _are_common(values, found) or _clarity(values, found[0]) < least:
        return None
    if way == "two" or _is_grainy(plain, values, squares, found):
        return ScanPhases(found, _SMOOTH)
    return ScanPhases(otsu(plain), 0.0)


def luminance(field: np.ndarray) -> np.ndarray:
    """Return the one channel of a field (C, Z, Y, X), or the luminance of three."""
    return weighted_sum(field, _LUMINANCE if len(field) == 3 else np.ones(1, np.float32))


def weighted_sum(field: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Sum channels one after another: a matrix product may round by the number of threads."""
    total = weights[0] * field[0]
    for weight, channel in zip(weights[1:], field[1:], strict=True):
        total += weight * channel
    return np.asarray(total)


def _extreme(values: np.ndarray, of: np.ufunc) -> np.ndarray:
    """Return the extreme (`np.maximum`, `np.minimum`) of (Z, Y, X) over cubes that reach `NEAR`
    voxels; beyond the faces there is nothing.
    """
    for axis in range(values.ndim):
        found, lines = values.copy(), np.moveaxis(values, axis, 0)
        to = np.moveaxis(found, axis, 0)
        for far in range(1, min(NEAR, len(lines) - 1) + 1):
            of(to[far:], lines[:-far], out=to[far:])
            of(to[:-far], lines[far:], out=to[:-far])
        values = found
    return values


def _steepest_levels(values: np.ndarray, squares: np.ndarray, cut: float) -> tuple[float, ...]:
    """Return the levels between phases: maxima of the mean squared gradient by level, each well
    above the minima beside it; the most prominent ones where there are too many.

    Of a maximum nearly as steep at `cut`, that is taken: where the scan would be segmented.
    """
    order = np.argsort(values, kind="stable")
    groups = np.array_split(order, _LEVELS)
    profile = np.array([squares[group].mean(dtype=np.float64) for group in groups])
    levels = [float(np.median(values[group])) for group in groups]
    inner = profile[1:-1]
    peaks = list(1 + np.flatnonzero((inner > profile[:-2]) & (inner >= profile[2:])))
    while peaks:
        ends = [0, *peaks, _LEVELS - 1]
        rises = [
            profile[peak] / max(profile[a : peak + 1].min(), profile[peak : b + 1].min(), 1e-30)
            for a, peak, b in zip(ends[:-2], peaks, ends[2:], strict=True)
        ]
        if min(rises) >= _RISE and len(peaks) <= _MOST:
            break
        peaks.pop(int(np.argmin(rises)))
    place = min(int(np.searchsorted(levels, cut)), _LEVELS - 1)
    nearest = min(peaks, key=lambda peak: abs(peak - place), default=-1)
    return tuple(
        cut if peak == nearest and profile[place] >= _ALIKE * profile[peak] else levels[peak]
        for peak in peaks
    )


def _squared_gradient(values: np.ndarray, edges: Sequence[float]) -> np.ndarray:
    """Return the squared gradient of (Z, Y, X) by central differences."""
    total = np.zeros(values.shape, np.float32)
    for axis, edge in enumerate(edges):
        slope = np.gradient(values, axis=axis) / np.float32(edge)
        total += slope * slope
    return total


def _are_common(values: np.ndarray, thresholds: Sequence[float]) -> bool:
    """Return whether every phase is common enough to be learnt."""
    above = [1.0, *(float((values > np.float32(level)).mean()) for level in thresholds), 0.0]
    return bool(min(-np.diff(above)) >= _RARE)


def _clarity(values: np.ndarray, threshold: float) -> float:
    """Return the share of the variance that lies between the phases of a threshold."""
    bright = values > np.float32(threshold)
    share = float(bright.mean())
    gap = float(values[bright].mean(dtype=np.float64) - values[~bright].mean(dtype=np.float64))
    return share * (1 - share) * gap**2 / float(values.var(dtype=np.float64))


def _is_grainy(
    plain: np.ndarray, smooth: np.ndarray, squares: np.ndarray, thresholds: Sequence[float]
) -> bool:
    """Return whether grain, which smoothing takes from even places, would mix two phases."""
    even = squares <= np.median(squares)
    grain = float((plain - smooth)[even].std(dtype=np.float64))
    phase = np.searchsorted(np.asarray(thresholds, np.float32), plain)
    means = [plain[phase == k].mean(dtype=np.float64) for k in range(len(thresholds) + 1)]
    return bool(np.diff(means).min() < _QUIET * grain)
