"""Volumes as a browser holds them: bytes, few enough for a tab."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

import numpy as np

from trabecula.core.image import Image
from trabecula.engine.lazy_volume import Slabs, as_slabs
from trabecula.engine.memory import Plan
from trabecula.exemplar.segment import otsu
from trabecula.view.page.joining import join_labels

LARGEST = 256**3
"""Voxels that a page draws; more are taken together in blocks."""

LONGEST = 1024
"""Voxels along an axis: what most graphics cards take is 2048."""

_SOFT = 6
"""Half the width of the default ramp of opacity around the threshold of a grey volume, of 255."""


@dataclass(frozen=True, eq=False)
class FittedVolume:
    """A volume as the page holds it.

    Parameters
    ----------
    values : (Z, Y, X) or (Z, Y, X, 3) uint8
    block : (z, y, x)
        Voxels of the image that make one of these.
    range : (low, high)
        What 0 and 255 stand for in a grey volume.
    threshold : int
        Of a grey volume: where its surface is, 0..255.
    """

    values: np.ndarray
    block: tuple[int, ...]
    range: tuple[float, float]
    threshold: int

    @property
    def ramp(self) -> tuple[int, int]:
        """Return the greys over which opacity rises at first."""
        return max(0, self.threshold - _SOFT), min(255, self.threshold + _SOFT)


def fit_volume(image: Image | Slabs) -> FittedVolume:
    """Fit a volume into a tab: means of blocks (of labels by their coverage, `join_labels`) where
    it is large; a picture as one slice.
    """
    if isinstance(image, Slabs):
        block = block_of(image.shape)
        return FittedVolume(join_labels(image, block), block, (0.0, 255.0), 0)
    values = image.values if image.ndim == 3 else image.values[None]
    shape = image.shape if image.ndim == 3 else (1, *image.shape)
    limits, threshold = (0.0, 255.0), 0
    if image.kind == "grey":
        limits = _limits(values)
    block = block_of(shape)
    if max(block) > 1 and image.kind == "labels" and image.ndim == 3:
        return fit_volume(as_slabs(image))
    if max(block) > 1:
        values = np.stack(
            [_join_blocks(part, block, image.kind) for part in _slabs(values, block[0])]
        )
    if image.kind == "grey":
        values = _bytes(values, limits)
        threshold = int(np.ceil(otsu(values)[0])) if values.min() < values.max() else 0
    return FittedVolume(np.ascontiguousarray(values), block, limits, threshold)


def forecast(shape: Sequence[int], itemsize: int) -> Plan:
    """Forecast the memory of a page with its volume, of so many bytes a voxel."""
    voxels = prod(shape)
    return Plan({"volume": (itemsize + 1) * voxels, "page": 12 * min(voxels, LARGEST)})


def fit_field(
    field: np.ndarray, drawn: np.ndarray, block: Sequence[int]
) -> tuple[np.ndarray, tuple[float, float]]:
    """Fit a field into a tab, as bytes.

    Parameters
    ----------
    field : (Z, Y, X) float
    drawn : (Z, Y, X) bool
        What is drawn at first.
    block : (z, y, x)
        Of a block the mean over what is drawn in it counts, else over all of it.

    Returns
    -------
    values : uint8, one for each block
    limits : (low, high)
        Of 0 and 255: the 1st and 99th percentile where it is drawn, as in a still; of a field that
        is the same all over what is drawn (a velocity, in the solid), where it is not.
    """
    inside = drawn
    if not drawn.any() or np.ptp(field[drawn]) == 0:
        inside = ~drawn
    if not inside.any():
        inside = np.ones_like(drawn)
    low, high = (float(value) for value in np.quantile(field[inside], [0.01, 0.99]))
    if high <= low:
        high = low + (abs(low) or 1.0)
    if max(block) > 1:
        share = _join_volume(inside.astype(np.float32), block)
        held = _join_volume(np.where(inside, field, 0).astype(np.float32), block)
        plain = _join_volume(field.astype(np.float32), block)
        field = np.where(share > 0, held / np.maximum(share, 1e-9), plain)
    return _bytes(field.astype(np.float32), (low, high)), (low, high)


def _join_volume(values: np.ndarray, block: Sequence[int]) -> np.ndarray:
    return np.stack([_join_blocks(part, block, "grey") for part in _slabs(values, block[0])])


def block_of(shape: Sequence[int]) -> tuple[int, ...]:
    """Return the edges of the smallest blocks that make the volume fit, the same along every axis
    that has so many voxels.
    """
    edge = 1
    while True:
        block = tuple(min(edge, side) for side in shape)
        left = [side // size for side, size in zip(shape, block, strict=True)]
        if np.prod(left, dtype=np.int64) <= LARGEST and max(left) <= LONGEST:
            return block
        edge += 1


def _slabs(values: np.ndarray, thick: int) -> list[np.ndarray]:
    return [
        values[start : start + thick] for start in range(0, values.shape[0] // thick * thick, thick)
    ]


def _join_blocks(slab: np.ndarray, block: Sequence[int], kind: str) -> np.ndarray:
    """Join a layer of blocks, (Y, X) or (Y, X, 3); the rest at the far ends is left out."""
    _, tall, wide = block
    rows, columns = slab.shape[1] // tall, slab.shape[2] // wide
    cut = slab[:, : rows * tall, : columns * wide].reshape(
        slab.shape[0], rows, tall, columns, wide, *slab.shape[3:]
    )
    if kind != "labels":
        mean = cut.mean(axis=(0, 2, 4), dtype=np.float64)
        return np.round(mean).astype(np.uint8) if kind == "colour" else mean.astype(np.float32)
    votes = np.stack(
        [np.count_nonzero(cut == label, axis=(0, 2, 4)) for label in range(int(slab.max()) + 1)]
    )
    return votes.argmax(axis=0).astype(np.uint8)


def _limits(values: np.ndarray) -> tuple[float, float]:
    """Return the range of greys: 0 to 255 of bytes, else the 0.1 to 99.9 percent of a sample."""
    if values.dtype == np.uint8:
        return 0.0, 255.0
    step = max(1, round((values.size / 1e6) ** (1 / 3)))
    low, high = np.percentile(values[::step, ::step, ::step].astype(np.float64), (0.1, 99.9))
    return float(low), float(high if high > low else low + 1)


def _bytes(values: np.ndarray, limits: tuple[float, float]) -> np.ndarray:
    if values.dtype == np.uint8:
        return values
    scaled = (values.astype(np.float32) - np.float32(limits[0])) * np.float32(
        255 / (limits[1] - limits[0])
    )
    return np.round(np.clip(scaled, 0, 255)).astype(np.uint8)
