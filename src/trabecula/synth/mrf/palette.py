"""A palette of real colours, by median cut with the box of largest scatter split first (Heckbert
1982).
"""

from __future__ import annotations

import numpy as np


def palette_of(pixels: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """At most so many colours that stand for all.

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
        lower, upper = _halves(colours, counts, boxes[worst], int(np.argmax(scatter[worst])))
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
    """The sum of squared deviations from the mean, for each channel."""
    size = counts[box].sum()
    first = (colours[box] * counts[box, None]).sum(0)
    second = (colours[box] ** 2 * counts[box, None]).sum(0)
    return np.asarray(second - first.astype(np.float64) ** 2 / size)


def _halves(
    colours: np.ndarray, counts: np.ndarray, box: np.ndarray, channel: int
) -> tuple[np.ndarray, np.ndarray]:
    """A box split at its mean along a channel: neither part is empty where the scatter is not 0."""
    values = colours[box, channel]
    below = values * counts[box].sum() <= (values * counts[box]).sum()
    return box[below], box[~below]
