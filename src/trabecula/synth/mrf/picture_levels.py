"""Pictures as numbered levels: labels, grey values or colours, each level with whole-number
features.

The squared distance of two neighbourhoods is the sum over their pixels of the squared differences
of the levels' features.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.image import Image
from trabecula.engine.compile import kernel
from trabecula.engine.random import below, philox
from trabecula.synth.mrf.config import MrfConfig
from trabecula.synth.mrf.density import STEPS

_GROUPS = 12  # of levels, for the feedback


@dataclass(frozen=True)
class PictureLevels:
    """The levels of one material.

    Attributes
    ----------
    kind : str
        Of the pictures.
    values : (L,) or (L, 3)
        Value of a level in the result: a label, a grey value or a colour of the exemplar.
    features : (L, C) int16
        Whole numbers; at most `full` in size.
    dimensions : int
        Dimensions of the levels' space: 1 (two labels, grey), n - 1 (n labels), 3 (colour).
    groups : (L,) uint8
        Levels that count together in the feedback, 0 .. 15, by rising grey.
    pictures : list of (R, C) uint8
        The exemplars as levels.
    empty : int
        Value of the result outside a form (label of void; 0).
    pool : (N,) or (N, 3)
        The pixels' own values by rising level; those of level l begin at `starts[l]`, (L + 1,)
        int64.
    """

    kind: str
    values: np.ndarray
    features: np.ndarray
    dimensions: int
    groups: np.ndarray
    pictures: list[np.ndarray]
    empty: int
    pool: np.ndarray
    starts: np.ndarray

    @property
    def sort(self) -> str:
        """Return the sort of picture that defaults depend on: "two phases", "phases", "grey" or
        "colour".
        """
        if self.kind != "labels":
            return self.kind
        return "two phases" if len(self.values) == 2 else "phases"

    def draw_values(self, levels: np.ndarray, z: int, key: np.uint64) -> np.ndarray:
        """Convert levels (Y, X) of plane z to values: each voxel takes, at random, the value of one
        of the pixels of its level.
        """
        chosen = np.empty(levels.shape, np.int64)
        draw_pixels(levels, self.starts, key, z, chosen)
        return self.pool[chosen]

    @property
    def void(self) -> int | None:
        """Return the level of the void; None where the pictures have none."""
        if self.kind != "labels":
            return None
        found = np.flatnonzero(self.values == self.empty)
        return int(found[0]) if len(found) else None

    def nearest_levels(self, values: np.ndarray) -> np.ndarray:
        """Return the nearest level (uint8) of values of the exemplars' kind."""
        if self.kind == "labels":
            return (
                np.searchsorted(self.values, values).clip(0, len(self.values) - 1).astype(np.uint8)
            )
        if self.kind == "grey":
            middles = self.values[:-1] + (self.values[1:] - self.values[:-1]) / 2
            return np.searchsorted(middles, values, side="left").astype(np.uint8)
        flat, where = np.unique(values.reshape(-1, 3), axis=0, return_inverse=True)
        nearest = np.empty(len(flat), np.uint8)
        for first in range(0, len(flat), 4096):
            part = flat[first : first + 4096, None].astype(np.int32) - self.values[None].astype(
                np.int32
            )
            nearest[first : first + 4096] = (part**2).sum(2).argmin(1)
        return nearest[where.reshape(values.shape[:-1])]


@kernel
def draw_pixels(levels, starts, key, z, chosen):
    """Choose a place in the pool (Y, X) for every voxel of a plane."""
    for y in range(levels.shape[0]):
        for x in range(levels.shape[1]):
            first = starts[levels[y, x]]
            chosen[y, x] = first + below(
                philox(key, z, y, x, 0)[0], starts[levels[y, x] + 1] - first
            )


def number_levels(
    images: Sequence[Image], *, full: int, levels: int, colours: int
) -> PictureLevels:
    """Assign numbers to the levels of exemplars of the same kind.

    Parameters
    ----------
    full : int
        The largest size of a feature, 16 .. 127.
    levels : int
        Grey values at most, 2 .. 256: as they are where there are fewer, else by quantiles.
    colours : int
        Colours of the palette at most, 2 .. 256.
    """
    if images[0].kind == "labels":
        return _label_levels(images)
    if images[0].kind == "grey":
        return _grey_levels(images, full, levels)
    return _colour_levels(images, full, colours)


def _label_levels(images: Sequence[Image]) -> PictureLevels:
    present = np.unique(np.concatenate([np.unique(image.values) for image in images]))
    pictures = [np.searchsorted(present, image.values).astype(np.uint8) for image in images]
    count = len(present)
    features = np.arange(2)[:, None] if count == 2 else np.eye(count)
    names = images[0].phases
    return PictureLevels(
        "labels",
        present.astype(np.uint8),
        features.astype(np.int16),
        max(1, count - 1),
        np.arange(count, dtype=np.uint8),
        pictures,
        names.index("void") if "void" in names else 0,
        present.astype(np.uint8),
        np.arange(count + 1),
    )


def _grey_levels(images: Sequence[Image], full: int, levels: int) -> PictureLevels:
    pooled = np.concatenate([image.values.ravel() for image in images])
    present, counts = np.unique(pooled, return_counts=True)
    if len(present) > levels:
        middle = np.cumsum(counts) - counts / 2
        cell = np.minimum(middle * levels // pooled.size, levels - 1).astype(np.int64)
        cells, first = np.unique(cell, return_index=True)
        weighed = np.cumsum(counts)
        below = np.concatenate([[0], weighed])[first]
        above = np.concatenate([below[1:], [pooled.size]])
        kept = np.searchsorted(weighed, (below + above) // 2, side="right")
        table, numbers = present[kept], np.searchsorted(cells, cell)
    else:
        table, numbers = present, np.arange(len(present))
    low, high = float(present[0]), float(present[-1])
    features = np.rint(
        (table.astype(np.float64) - low) * (2 * full / max(high - low, 1e-300)) - full
    )
    pictures = [
        numbers[np.searchsorted(present, image.values)].astype(np.uint8) for image in images
    ]
    groups, parts = (
        _group_levels(pictures, len(table)),
        _pool_by_level(pooled, pictures, len(table)),
    )
    return PictureLevels(
        "grey", table, features.astype(np.int16)[:, None], 1, groups, pictures, 0, *parts
    )


def _colour_levels(images: Sequence[Image], full: int, colours: int) -> PictureLevels:
    pooled = np.concatenate([image.values.reshape(-1, 3) for image in images])
    table, pixels = median_cut_palette(pooled, colours)
    # by rising brightness
    order = np.argsort(table.astype(np.int64) @ np.array([299, 587, 114]), kind="stable")
    place = np.empty(len(order), np.uint8)
    place[order] = np.arange(len(order))
    table, pixels = table[order], place[pixels]
    ends = np.cumsum([image.values.size // 3 for image in images])[:-1]
    pictures = [
        part.reshape(image.shape)
        for part, image in zip(np.split(pixels, ends), images, strict=True)
    ]
    features = np.rint((table.astype(np.float64) - 127.5) * (full / 127.5)).astype(np.int16)
    groups, parts = (
        _group_levels(pictures, len(table)),
        _pool_by_level(pooled, pictures, len(table)),
    )
    return PictureLevels("colour", table, features, 3, groups, pictures, 0, *parts)


def _pool_by_level(
    pooled: np.ndarray, pictures: Sequence[np.ndarray], count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Sort the pixels' values by level; return them and where each level begins."""
    levels = np.concatenate([picture.ravel() for picture in pictures])
    starts = np.concatenate([[0], np.cumsum(np.bincount(levels, minlength=count))])
    return pooled[np.argsort(levels, kind="stable")], starts


def _group_levels(pictures: Sequence[np.ndarray], count: int) -> np.ndarray:
    """Group levels in their order, with about equal shares."""
    counts = np.sum([np.bincount(picture.ravel(), minlength=count) for picture in pictures], axis=0)
    middle = np.cumsum(counts) - counts / 2
    return np.minimum(middle * _GROUPS // max(1, counts.sum()), _GROUPS - 1).astype(np.uint8)


def median_cut_palette(pixels: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Choose a palette of real colours by median cut, splitting the box of largest scatter first
    (Heckbert 1982, doi:10.1145/965145.801294).

    Parameters
    ----------
    pixels : (N, 3) uint8
    most : int
        1 .. 256.

    Returns
    -------
    colours : (L, 3) uint8
        Each occurs among the pixels: of its box the one nearest to the mean.
    which : (N,) uint8
        The box of every pixel.

    Examples
    --------
    >>> colours, which = palette_of(np.array([[0, 0, 0], [9, 9, 9], [250, 0, 0]], np.uint8), 2)
    >>> colours.tolist(), which.tolist()
    ([[0, 0, 0], [250, 0, 0]], [0, 0, 1])
    """
    packed = pixels.astype(np.int64) @ np.array([65536, 256, 1])
    present, where, counts = np.unique(packed, return_inverse=True, return_counts=True)
    colours = np.stack([present >> 16, present >> 8 & 255, present & 255], axis=1)
    boxes = [np.arange(len(present))]
    scatter = [_scatter(colours, counts, boxes[0])]
    while len(boxes) < min(most, len(present)):
        worst = int(np.argmax([part.sum() for part in scatter]))
        lower, upper = _split_box(colours, counts, boxes[worst], int(np.argmax(scatter[worst])))
        boxes[worst] = lower
        boxes.append(upper)
        scatter[worst] = _scatter(colours, counts, lower)
        scatter.append(_scatter(colours, counts, upper))
    number = np.empty(len(present), np.uint8)
    table = np.empty((len(boxes), 3), np.uint8)
    for i, box in enumerate(boxes):
        number[box] = i
        size = int(counts[box].sum())
        # from the mean, times the size
        apart = colours[box] * size - (colours[box] * counts[box, None]).sum(0)
        table[i] = colours[box[int(np.argmin(np.abs(apart).sum(1)))]]
    return table, number[where]


def _scatter(colours: np.ndarray, counts: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return the sum of squared deviations from the mean, for each channel."""
    size = counts[box].sum()
    first = (colours[box] * counts[box, None]).sum(0)
    second = (colours[box] ** 2 * counts[box, None]).sum(0)
    return np.asarray(second - first.astype(np.float64) ** 2 / size)


def _split_box(
    colours: np.ndarray, counts: np.ndarray, box: np.ndarray, channel: int
) -> tuple[np.ndarray, np.ndarray]:
    """Split a box at its mean along a channel: neither part is empty where the scatter is not 0."""
    values = colours[box, channel]
    below = values * counts[box].sum() <= (values * counts[box]).sum()
    return box[below], box[~below]


def largest_feature(kind: str, config: MrfConfig) -> int:
    """Return the largest feature for which distances stay exact in float32: 3 W F^2 C K < 2^24,
    with weights up to W.
    """
    channels = 3 if kind == "colour" else 1
    weight = STEPS if config.relaxation == "icm" else 1
    return min(
        127, int(np.sqrt((2**24 - 1) / (3 * weight * channels * (config.neighbourhood**2 - 1))))
    )
