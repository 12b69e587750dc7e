"""Scale bars: a round length and its words."""

from __future__ import annotations

import math
from typing import Any

from trabecula.view.picture import font

# Pillow's lettering has neither the micro sign nor the Angstrom's ring: units stand as they are
# named in an Image.
_THOUSAND = {"nm": "um", "um": "mm", "m": "km"}


def round_length(limit: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above `limit`."""
    power = 10.0 ** math.floor(math.log10(limit))
    # The factor absorbs rounding: a limit of exactly 5 must give 5.
    return max(step * power for step in (1, 2, 5) if step * power <= limit * (1 + 1e-9))


def format_length(length: float, unit: str) -> str:
    """Format a length, "500 um", "1 voxel", "2 mm"; from 1000 on in the next larger unit."""
    if length >= 1000 and unit in _THOUSAND:
        length, unit = length / 1000, _THOUSAND[unit]
    return f"{length:g} {unit}{'s' if unit == 'voxel' and length != 1 else ''}"


def bar_height(size: int) -> int:
    """Return the pixels that a bar with letters of that size takes."""
    return size + size // 3 + max(2, size // 4)


def draw_bar(
    canvas: Any,
    left: float,
    bottom: float,
    *,
    pixel: float,
    unit: str,
    room: float,
    ink: Any,
    size: int,
) -> None:
    """Draw a bar of at most `room` pixels with its length above, the lower left corner at (left,
    bottom).

    Parameters
    ----------
    canvas : PIL.ImageDraw
    pixel : float
        Edge of a pixel in `unit`.
    size : int
        Height of the letters in pixels.
    """
    length = round_length(room * pixel)
    thick = max(2, size // 4)
    canvas.rectangle((left, bottom - thick, left + round(length / pixel) - 1, bottom - 1), fill=ink)
    canvas.text(
        (left, bottom - thick - size // 3),
        format_length(length, unit),
        fill=ink,
        font=font(size),
        anchor="ls",
    )
