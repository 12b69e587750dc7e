"""Images as fields that can be averaged, in int8, and back: labels as clipped signed distances,
grey and colour as they are.

A mean of labels blurs; a mean of signed distances moves the interface. Two phases need one channel
(positive inside the second), more need one each, and the largest wins. Grey values and the three of
a colour are stretched over the bytes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.image import Image
from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs
from trabecula.measure.distance import signed_distance
from trabecula.synth.shared.content.histogram import (
    Histogram,
    look_up,
    match_histogram,
    matching_table,
)
from trabecula.synth.shared.slabs import for_plane_groups, make_by_slabs

FULL = 127
"""The int8 value of a voxel `clip` voxels or more inside its phase; of the brightest grey."""

UNIT = 256
"""An int8 step of a field in the int16 of votes."""

_WORDS = 4  # of 64 bits that the generator makes at once


def phases_present(images: Sequence[Image]) -> tuple[int, ...]:
    """List the labels that occur in any of the images, rising."""
    return tuple(
        int(label)
        for label in np.unique(np.concatenate([np.unique(image.values) for image in images]))
    )


def channels_of(exemplars: Sequence[Image]) -> int:
    """Count the channels of the fields of images."""
    first = exemplars[0]
    if first.kind != "labels":
        return 3 if first.kind == "colour" else 1
    present = len(phases_present(exemplars))
    return 1 if present == 2 else present


def phase_fields(
    image: Image, present: tuple[int, ...] | None = None, *, unit: float | None = None
) -> tuple[np.ndarray, tuple[int, ...]]:
    """Return signed distances in voxels, (C, Z, Y, X) or (C, Y, X) float32, and the labels that
    they stand for.

    With two labels present the one channel stands for the second. Distances follow the image's
    spacing; `unit` is the length that counts as one, by default the geometric mean of a voxel's
    edges. A label of `present` that does not occur is infinitely far.
    """
    present = phases_present([image]) if present is None else present
    spacing = (
        isotropic_scale(image.spacing)
        if unit is None
        else tuple(edge / unit for edge in image.spacing)
    )
    channels = present[1:] if len(present) == 2 else present
    fields = [_distance_of(image.values == label, spacing) for label in channels]
    return np.stack(fields).astype(np.float32, copy=False), present


def mean_edge(spacing: Sequence[float]) -> float:
    """Return the geometric mean of a voxel's edges."""
    return float(np.exp(np.mean(np.log(np.asarray(spacing)))))


def isotropic_scale(spacing: Sequence[float]) -> tuple[float, ...]:
    """Divide the edges of a voxel by their geometric mean."""
    edges = np.asarray(spacing)
    return tuple((edges / np.exp(np.mean(np.log(edges)))).tolist())


def _distance_of(inside: np.ndarray, spacing: tuple[float, ...]) -> np.ndarray:
    if inside.all() or not inside.any():
        return np.full(inside.shape, 1e6 if inside.any() else -1e6, np.float32)
    return signed_distance(inside, spacing=spacing)


def quantise(field: np.ndarray, *, clip: float, unit: float = 1.0) -> np.ndarray:
    """Round a field (..., Z, Y, X) to int8, where +-127 means `clip` of these units and beyond."""
    if field.ndim < 3:
        return _bytes(field, clip, unit)
    return make_by_slabs(
        lambda a, b: _bytes(field[..., a:b, :, :], clip, unit), field.shape, np.int8
    )


def _bytes(field: np.ndarray, clip: float, unit: float) -> np.ndarray:
    scaled = (field if unit == 1 else field / np.float32(unit)) * np.float32(FULL / clip)
    return np.rint(np.clip(scaled, -FULL, FULL)).astype(np.int8)


def value_fields(values: np.ndarray, *, colour: bool, low: float, high: float) -> np.ndarray:
    """Stretch grey values, or colours (..., 3), to (C, ...) float32, -127 at `low` and 127 at
    `high`.
    """
    channels = np.moveaxis(values, -1, 0) if colour else values[None]
    return (channels.astype(np.float32) - np.float32(low)) * np.float32(
        2 * FULL / (high - low)
    ) - np.float32(FULL)


def values_of(
    fields: np.ndarray, targets: Sequence[Histogram], inside: np.ndarray | None = None
) -> np.ndarray:
    """Return grey (Z, Y, X) or colour (Z, Y, X, 3) of voted fields (C, Z, Y, X) int16, with the
    histograms of the channels.
    """
    if len(fields) == 1:
        return match_histogram(fields[0], targets[0], inside)
    tables = [
        matching_table(field, target, inside) for field, target in zip(fields, targets, strict=True)
    ]
    values = memmap.empty((*fields.shape[1:], len(fields)), tables[0].dtype)

    def work(start: int, stop: int) -> None:
        plane = np.empty((1, *values.shape[1:3]), values.dtype)
        for z in range(start, stop):
            for c, table in enumerate(tables):
                look_up(fields[c], table, plane, z, z, z + 1)
                values[z, ..., c] = plane[0]

    for_slabs(work, len(values))
    return values


def values_by_phase(
    fields: np.ndarray,
    structure: np.ndarray,
    targets: Sequence[Sequence[Histogram]],
    inside: np.ndarray | None = None,
) -> np.ndarray:
    """Return grey (Z, Y, X) or colour (Z, Y, X, 3) of voted fields (C, Z, Y, X) int16, with the
    channels' histograms of every phase: `targets` by the value of the structure (Z, Y, X) uint8.
    """
    channels, shape = len(fields), structure.shape
    values = memmap.empty(
        shape if channels == 1 else (*shape, channels), targets[0][0].values.dtype
    )
    for phase, histograms in enumerate(targets):
        within = _voxels_of(structure, phase, inside)
        tables = [
            matching_table(field, target, within)
            for field, target in zip(fields, histograms, strict=True)
        ]

        def work(
            start: int, stop: int, within: np.ndarray = within, tables: list[np.ndarray] = tables
        ) -> None:
            plane = np.empty((1, *shape[1:]), values.dtype)
            for z in range(start, stop):
                for c, table in enumerate(tables):
                    look_up(fields[c], table, plane, z, z, z + 1)
                    to = values[z] if channels == 1 else values[z, ..., c]
                    np.copyto(to, plane[0], where=within[z])

        for_slabs(work, len(values))
    return values


def _voxels_of(structure: np.ndarray, phase: int, inside: np.ndarray | None) -> np.ndarray:
    """Mark the voxels of a phase, of those inside."""

    def mark(start: int, stop: int) -> np.ndarray:
        there = structure[start:stop] == phase
        return there if inside is None else there & inside[start:stop]

    return make_by_slabs(mark, structure.shape, bool)


def plain_values(fields: np.ndarray, *, low: float, high: float, dtype: np.dtype) -> np.ndarray:
    """Return grey (Z, Y, X) or colour (Z, Y, X, 3) of voted fields (C, Z, Y, X) int16: the inverse
    of `value_fields`.
    """
    shape = fields.shape[1:] if len(fields) == 1 else (*fields.shape[1:], len(fields))
    values = memmap.empty(shape, dtype)

    def work(start: int, stop: int) -> None:
        part = fields[:, start:stop]
        grey = (part.astype(np.float32) / 256 + FULL) * np.float32(
            (high - low) / (2 * FULL)
        ) + np.float32(low)
        np.clip(grey, low, high, out=grey)
        found = (grey if dtype.kind == "f" else np.rint(grey)).astype(dtype)
        values[start:stop] = found[0] if len(found) == 1 else np.moveaxis(found, 0, -1)

    for_plane_groups(work, values.shape[:3])
    return values


def votes_of(field: np.ndarray) -> np.ndarray:
    """Scale a field (C, Z, Y, X) int8 to votes (int16)."""
    votes = memmap.empty(field.shape, np.int16, least=0)  # another process may write it

    def work(start: int, stop: int) -> None:
        np.multiply(field[:, start:stop], np.int16(UNIT), out=votes[:, start:stop], dtype=np.int16)

    for_slabs(work, field.shape[1], anywhere=True)
    return votes


def noise(shape: Sequence[int], key: int) -> np.ndarray:
    """Draw white noise (C, Z, Y, X) int16, even from -8192 to 8191: the successive words of one
    generator.
    """
    votes = memmap.empty(shape, np.int16)
    channels, depth, height, width = votes.shape

    def work(start: int, stop: int) -> None:
        for c in range(channels):
            for z in range(start, stop):
                before = (c * depth + z) * height * width
                generator = np.random.Philox(key=key, counter=before // _WORDS)
                generator.random_raw(before % _WORDS)
                raw = generator.random_raw(height * width) >> np.uint64(50)
                votes[c, z] = raw.astype(np.int16).reshape(height, width) - np.int16(8192)

    for_slabs(work, depth)
    return votes
