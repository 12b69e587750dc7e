"""A step on the two-point function of what a field is cut to, rather than of its soft values.

A field that is histogram-matched to distances need not be one: where it rises slowly, fewer and smoother interfaces make up the
same histogram, and a soft indicator of its values does not see it. Divided by its own slope it is a distance near the
interface, whichever way it rises; the target is the two-point function of the picture's phases themselves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.synth.shared.fields import FULL
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.statistics.correlate import Correlations, corrected
from trabecula.synth.shared.statistics.sliced import UNIT

FAR = 4.0
"""Voxels at which distances saturate here."""

_FLAT = np.float32(1.0)  # least slope, int8 steps a voxel


def stepped(field: np.ndarray, target: Correlations, region: Region) -> np.ndarray:
    """One step.

    Parameters
    ----------
    field : (C, Z, Y, X) int8
    target : Correlations
        The softness is that of distances which saturate at `FAR`.
    region : Region

    Returns
    -------
    (C, Z, Y, X) int16
        In 1 / UNIT of an int8 step of the field, to be matched to its histogram.
    """
    slopes = np.stack([slope(channel, region.wraps) for channel in field])
    distance = np.clip(field / slopes, -FAR, FAR) * np.float32(FULL / FAR)
    distance = np.rint(distance, out=distance).astype(np.int8)
    moved = corrected(distance, target, periodic=region.wraps, free=region.free)
    moves = (moved - distance.astype(np.int16) * np.int16(UNIT)) * (slopes * np.float32(FAR / FULL))
    limit = FULL * UNIT
    return np.clip(field.astype(np.float32) * UNIT + np.rint(moves), -limit, limit).astype(np.int16)


def slope(channel: np.ndarray, wraps: Sequence[bool]) -> np.ndarray:
    """The length of the gradient of (Z, Y, X) int8 in steps a voxel, float32, averaged over neighbours; never 0."""
    square = np.zeros(channel.shape, np.float32)
    for axis, wrap in enumerate(wraps):
        before, after = _neighbours(channel, axis, wrap)
        rise = (after.astype(np.float32) - before) * np.float32(0.5)
        square += rise * rise
    mean = np.sqrt(square, out=square)
    for axis, wrap in enumerate(wraps):
        before, after = _neighbours(mean, axis, wrap)
        mean = (before + after + 2 * mean) * np.float32(0.25)
    return np.maximum(mean, _FLAT)


def _neighbours(values: np.ndarray, axis: int, wrap: bool) -> tuple[np.ndarray, np.ndarray]:
    """The values before and after every voxel along an axis."""
    cells = np.arange(values.shape[axis])
    before, after = cells - 1, cells + 1
    if wrap:
        return values.take(before % len(cells), axis), values.take(after % len(cells), axis)
    return values.take(before.clip(0), axis), values.take(after.clip(None, len(cells) - 1), axis)
