"""Colours by a field: the drawn phases in bands of its values, and the legend that names them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.checks import as_number, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.view.picture import font

BANDS = 64
"""Colours from the least to the greatest value."""

# viridis (van der Walt and Smith, CC0): rises in lightness, so that it reads in grey as well
ANCHORS = np.array(
    [
        (68, 1, 84), (72, 40, 120), (62, 74, 137), (49, 104, 142), (38, 130, 142),
        (31, 158, 137), (53, 183, 121), (110, 206, 88), (181, 222, 43), (253, 231, 37),
    ],
    float,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class FieldColours:
    """A volume of bands in place of phases.

    Attributes
    ----------
    labels : uint8 array, (Z, Y, X)
        0 where nothing is drawn, else 1 + the band.
    colours : uint8 array, (BANDS + 1, 3)
    limits : (low, high)
        Values of the first and the last colour; None for colours of a volume's own, which have no
        legend.
    """

    labels: np.ndarray
    colours: np.ndarray
    limits: tuple[float, float] | None


def colour_by(
    image: Image, drawn: Sequence[int], field: Image, limits: Sequence[float] | None
) -> FieldColours:
    """Return the drawn phases of an image in bands of a field.

    Parameters
    ----------
    image : Image of labels, (Z, Y, X)
    drawn : sequence of int
        Labels that are drawn.
    field : Image, grey, of the image's shape
    limits : (low, high), optional
        Values of the first and the last colour; what is beyond takes that colour. Default: the
        1st and 99th percentile of the drawn voxels, since single ones of a stress stand out.

    Raises
    ------
    InputError
        A field of another kind or shape, or limits that are not two rising numbers.
    """
    if not isinstance(field, Image) or field.kind != "grey" or field.shape != image.shape:
        what = f"{field.kind} of shape {field.shape}" if isinstance(field, Image) else quote(field)
        raise InputError(
            f"field is {what}: give a grey Image of the volume's shape {image.shape} (tb.fields)"
        )
    inside = np.isin(image.values, list(drawn))
    values = field.values[inside].astype(np.float64)
    if limits is None:
        found = np.quantile(values, [0.01, 0.99]) if values.size else np.zeros(2)
        low, high = (float(value) for value in found)
    else:
        if len(limits) != 2:
            raise InputError(
                f"limits {quote(limits)} of the field: give the least and the greatest"
            )
        low, high = (as_number(value, name="limit", low=-1e30, high=1e30) for value in limits)
        if low >= high:
            raise InputError(f"limits {low:g} and {high:g} of the field do not rise: exchange them")
    bands = np.floor((values - low) / max(high - low, 1e-300) * BANDS).clip(0, BANDS - 1)
    labels = np.zeros(image.shape, np.uint8)
    labels[inside] = 1 + bands.astype(np.uint8)
    return FieldColours(labels, _colours(), (low, high))


def _colours() -> np.ndarray:
    at = (np.arange(BANDS) + 0.5) / BANDS * (len(ANCHORS) - 1)
    places = np.arange(len(ANCHORS))
    found = np.stack([np.interp(at, places, channel) for channel in ANCHORS.T], axis=1)
    return np.concatenate([[(30, 30, 30)], np.rint(found)]).astype(np.uint8)


def draw_legend(
    canvas: Any, right: float, bottom: float, colours: FieldColours, *, ink: Any, size: int
) -> None:
    """Draw the colours as a bar with their least and greatest values above its ends, the lower
    right corner at (right, bottom).
    """
    thick, wide = max(4, size // 2), 8 * size
    edges = np.rint(np.linspace(right - wide, right, BANDS + 1)).astype(int).tolist()
    for band in range(BANDS):
        colour = tuple(colours.colours[1 + band].tolist())
        canvas.rectangle(
            (edges[band], bottom - thick, edges[band + 1] - 1, bottom - 1), fill=colour
        )
    words = [f"{value:.3g}" for value in colours.limits or ()]
    given = {"fill": ink, "font": font(size)}
    top = bottom - thick - size // 3
    canvas.text((right - wide, top), words[0], anchor="ls", **given)
    canvas.text((right, top), words[1], anchor="rs", **given)
