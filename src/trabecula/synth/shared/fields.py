"""Images as fields that can be averaged, in int8, and back: labels as clipped signed distances, grey and colour as they are.

A mean of labels blurs; a mean of signed distances moves the interface. Two phases need one channel (positive inside the
second), more need one each, and the largest wins. Grey values and the three of a colour are stretched over the bytes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.distance import signed_distance
from trabecula.synth.shared.histogram import Histogram, brightest, match_histogram, mixed_with_neighbours

FULL = 127
"""The int8 value of a voxel `clip` voxels or more inside its phase; of the brightest grey."""

_AUCTIONS = 20  # rounds at most; a handful settle it


def phases_present(images: Sequence[Image]) -> tuple[int, ...]:
    """The labels that occur in any of the images, rising."""
    return tuple(int(label) for label in np.unique(np.concatenate([np.unique(image.values) for image in images])))


def phase_fields(
    image: Image, present: tuple[int, ...] | None = None, *, unit: float | None = None
) -> tuple[np.ndarray, tuple[int, ...]]:
    """Signed distances in voxels, (C, Z, Y, X) or (C, Y, X) float32, and the labels that they stand for.

    With two labels present the one channel stands for the second. Distances follow the image's spacing; `unit` is the length
    that counts as one, by default the geometric mean of a voxel's edges. A label of `present` that does not occur lies
    infinitely far.
    """
    present = phases_present([image]) if present is None else present
    spacing = isotropic_scale(image.spacing) if unit is None else tuple(edge / unit for edge in image.spacing)
    channels = present[1:] if len(present) == 2 else present
    fields = [_distance_of(image.values == label, spacing) for label in channels]
    return np.stack(fields).astype(np.float32, copy=False), present


def mean_edge(spacing: Sequence[float]) -> float:
    """The geometric mean of a voxel's edges."""
    return float(np.exp(np.mean(np.log(np.asarray(spacing)))))


def isotropic_scale(spacing: Sequence[float]) -> tuple[float, ...]:
    """Edges of a voxel over their geometric mean."""
    edges = np.asarray(spacing)
    return tuple((edges / np.exp(np.mean(np.log(edges)))).tolist())


def _distance_of(inside: np.ndarray, spacing: tuple[float, ...]) -> np.ndarray:
    if inside.all() or not inside.any():
        return np.full(inside.shape, 1e6 if inside.any() else -1e6, np.float32)
    return signed_distance(inside, spacing=spacing)


def quantise(field: np.ndarray, *, clip: float) -> np.ndarray:
    """A field in int8, where +-127 means `clip` and beyond."""
    return np.rint(np.clip(field * np.float32(FULL / clip), -FULL, FULL)).astype(np.int8)


def value_fields(image: Image, *, low: float, high: float) -> np.ndarray:
    """Grey or colour as (C, Z, Y, X) or (C, Y, X) float32, -127 at `low` and 127 at `high`."""
    channels = np.moveaxis(image.values, -1, 0) if image.kind == "colour" else image.values[None]
    return (channels.astype(np.float32) - np.float32(low)) * np.float32(2 * FULL / (high - low)) - np.float32(FULL)


def labels_of(
    fields: np.ndarray, present: tuple[int, ...], fractions: np.ndarray | None, inside: np.ndarray | None = None
) -> np.ndarray:
    """Labels (uint8) of voted fields (C, Z, Y, X) int16, holding the phases in the given volume `fractions`.

    Without fractions two phases are split at zero, and more go to the largest field.
    Two phases are split where the fraction is met to the voxel. More go to the largest field, each shifted by a constant so
    that the fractions come out, but for ties: zeros alone need not agree where three phases meet.
    Where `inside` (Z, Y, X) bool is given, fractions are those of the voxels inside.
    """
    if fractions is None:
        chosen = (fields[0] > 0).astype(np.intp) if len(present) == 2 else fields.argmax(0)
        return np.asarray(present, np.uint8)[chosen]
    size = fields[0].size if inside is None else int(np.count_nonzero(inside))
    if len(present) == 2:
        upper = brightest(fields[0], round(size * float(fractions[1])), inside)
        return np.where(upper, np.uint8(present[1]), np.uint8(present[0]))
    return np.asarray(present, np.uint8)[_shared_out(fields, np.rint(size * fractions).astype(np.int64), inside)]


def _shared_out(fields: np.ndarray, counts: np.ndarray, inside: np.ndarray | None) -> np.ndarray:
    """The largest field of every voxel (uint8), each with the shift that wins it `counts` voxels, one field after the other
    until no count is off by more than ties (the auction for a transport problem with few goods)."""
    counted = slice(None) if inside is None else inside
    fields = np.stack([mixed_with_neighbours(field) for field in fields]).astype(np.int32)
    shift = np.zeros(len(fields), np.int32)
    kept, least = np.zeros(fields.shape[1:], np.uint8), np.inf
    for _ in range(_AUCTIONS):
        for phase in range(len(fields)):
            rivals = [field + s for q, (field, s) in enumerate(zip(fields, shift, strict=True)) if q != phase]
            margin = np.max(rivals, axis=0)
            margin -= fields[phase]
            bids = margin[counted].ravel()  # what the phase has to be lifted by to win a voxel
            wins = min(max(int(counts[phase]), 1), bids.size) - 1
            shift[phase] = np.partition(bids, wins)[wins] if bids.size else 0
        winner = np.argmax([field + s for field, s in zip(fields, shift, strict=True)], axis=0).astype(np.uint8)
        excess = np.abs(np.bincount(winner[counted].ravel(), minlength=len(fields)) - counts).max()
        if excess >= least:
            break
        kept, least = winner, excess
    return kept


def values_of(fields: np.ndarray, targets: Sequence[Histogram], inside: np.ndarray | None = None) -> np.ndarray:
    """Grey (Z, Y, X) or colour (Z, Y, X, 3) of voted fields (C, Z, Y, X) int16, with the histograms of the channels."""
    channels = [match_histogram(field, target, inside) for field, target in zip(fields, targets, strict=True)]
    return channels[0] if len(channels) == 1 else np.stack(channels, axis=-1)


def plain_values(fields: np.ndarray, *, low: float, high: float, dtype: np.dtype) -> np.ndarray:
    """Grey (Z, Y, X) or colour (Z, Y, X, 3) of voted fields (C, Z, Y, X) int16: `value_fields` backwards."""
    grey = (fields.astype(np.float32) / 256 + FULL) * np.float32((high - low) / (2 * FULL)) + np.float32(low)
    grey = grey.clip(low, high)
    values = (grey if dtype.kind == "f" else np.rint(grey)).astype(dtype)
    return values[0] if len(values) == 1 else np.moveaxis(values, 0, -1).copy()
