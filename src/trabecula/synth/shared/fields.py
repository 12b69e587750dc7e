"""Labels as fields that can be averaged: one clipped signed distance per phase, in int8, and back.

A mean of labels blurs; a mean of signed distances moves the interface. Two phases need one channel (positive inside the
second), more need one each, and the largest wins.
"""

from __future__ import annotations

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.distance import signed_distance
from trabecula.synth.shared.histogram import brightest

FULL = 127
"""The int8 value of a voxel `clip` voxels or more inside its phase."""


def phase_fields(image: Image) -> tuple[np.ndarray, tuple[int, ...]]:
    """Signed distances in voxels, (C, Z, Y, X) float32, and the labels that they stand for.

    With two labels present the one channel stands for the second. Distances follow the image's spacing, scaled so that
    the geometric mean of a voxel's edges is 1.
    """
    present = tuple(int(label) for label in np.unique(image.values))
    scale = np.asarray(image.spacing) / np.exp(np.mean(np.log(image.spacing)))
    channels = present[1:] if len(present) == 2 else present
    fields = [signed_distance(image.values == label, spacing=tuple(scale)) for label in channels]
    return np.stack(fields).astype(np.float32, copy=False), present


def quantise(field: np.ndarray, *, clip: float) -> np.ndarray:
    """A field in int8, where +-127 means `clip` and beyond."""
    return np.rint(np.clip(field * np.float32(FULL / clip), -FULL, FULL)).astype(np.int8)


def labels_of(fields: np.ndarray, present: tuple[int, ...], fractions: np.ndarray) -> np.ndarray:
    """Labels (uint8) of voted fields (C, Z, Y, X) int16, holding the phases in the given volume `fractions`.

    Two phases are split where the fraction is met to the voxel. More go to the largest field, each shifted by a constant so
    that the fractions come out as nearly as forty steps bring them: zeros alone need not agree where three phases meet.
    """
    if len(present) == 2:
        upper = brightest(fields[0], round(fields[0].size * float(fractions[1])))
        return np.where(upper, np.uint8(present[1]), np.uint8(present[0]))
    shift = np.zeros(len(present), np.float32)
    rate = 100.0 * 256
    kept, least = fields.argmax(0), np.inf
    for _ in range(40):
        winner = np.argmax([field + s for field, s in zip(fields, shift, strict=True)], axis=0)
        excess = np.bincount(winner.ravel(), minlength=len(present)) / winner.size - fractions
        if np.abs(excess).max() < least:
            kept, least = winner, np.abs(excess).max()
        else:
            rate /= 2  # overshot
        shift = (shift - rate * excess).astype(np.float32)
    return np.asarray(present, np.uint8)[kept]
