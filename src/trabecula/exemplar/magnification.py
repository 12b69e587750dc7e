"""Pictures of one material with pixels of different sizes, brought to the largest of them: nothing
is invented, what a finer one shows beyond it is averaged.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.image import Image
from trabecula.core.progress import notify

_SAME = 1e-6  # relative, by which edges of pixels may differ and are the same


def to_one_magnification(images: Sequence[Image]) -> list[Image]:
    """Return pictures with pixels as large as the largest of them.

    Parameters
    ----------
    images : sequence of Image, each (Y, X)
        Where the pixels of all are square and their edges differ, finer ones are averaged over
        areas: grey values and colours their means, of two phases the places where the share of the
        second is highest, as many as keep its fraction, of more the most frequent one. What is left
        of a row or column at the far sides is cut off. All others are returned as they are.

    Examples
    --------
    >>> fine = Image(np.kron(np.eye(4), np.ones((2, 2))).astype(np.uint8), "labels", spacing=0.5)
    >>> found = to_one_magnification([fine, Image(np.eye(5, dtype=np.uint8), "labels", spacing=1)])
    >>> found[0].spacing, np.array_equal(found[0].values, np.eye(4))
    ((1.0, 1.0), True)
    """
    square = all(max(image.spacing) <= min(image.spacing) * (1 + _SAME) for image in images)
    edges = [image.spacing[0] for image in images]
    largest = max(edges)
    finer = [edge < largest * (1 - _SAME) for edge in edges]
    if not square or not any(finer) or len({image.unit for image in images}) > 1:
        return list(images)
    told = ", ".join(sorted({f"{edge:g}" for edge in edges}, key=float))
    notify(
        f"the pictures have pixels of {told} {images[0].unit}: the finer ones are averaged to "
        f"{largest:g}, the voxels of the result"
    )
    return [
        _average(image, largest / edge) if fine else image
        for image, edge, fine in zip(images, edges, finer, strict=True)
    ]


def _average(image: Image, ratio: float) -> Image:
    """Return a picture with pixels `ratio` times as long."""
    if image.kind == "labels":
        values = _average_labels(np.asarray(image.values), ratio)
    else:
        means = _means(np.asarray(image.values, np.float64), ratio)
        dtype = image.values.dtype
        values = (np.rint(means) if np.issubdtype(dtype, np.integer) else means).astype(dtype)
    spacing = tuple(edge * ratio for edge in image.spacing)
    recipe = image.recipe.then("average", values, ratio=ratio)
    return Image(values, image.kind, spacing, image.unit, image.phases, recipe)


def _average_labels(values: np.ndarray, ratio: float) -> np.ndarray:
    present = np.unique(values)
    shares = [_means((values == label).astype(np.float64), ratio) for label in present]
    if len(present) == 2:
        count = round(float((values == present[1]).mean()) * shares[1].size)
        order = np.argsort(-shares[1], axis=None, kind="stable")
        found = np.full(shares[1].size, present[0])
        found[order[:count]] = present[1]
        return found.reshape(shares[1].shape)
    return present[np.argmax(shares, axis=0)]


def _means(values: np.ndarray, ratio: float) -> np.ndarray:
    """Return the means over squares `ratio` pixels long of (Y, X) or (Y, X, C) float64, parts of
    pixels by their area.
    """
    for axis in (0, 1):
        side = values.shape[axis]
        lines = np.moveaxis(values, axis, -1)
        up_to = np.concatenate(
            [np.zeros((*lines.shape[:-1], 1)), np.cumsum(lines, axis=-1)], axis=-1
        )
        ends = np.minimum(np.arange(int(side / ratio * (1 + _SAME)) + 1) * ratio, side)
        low = np.minimum(ends.astype(np.int64), side - 1)
        sums = up_to[..., low] + (ends - low) * lines[..., low]
        values = np.moveaxis(np.diff(sums, axis=-1) / ratio, -1, axis)
    return values
