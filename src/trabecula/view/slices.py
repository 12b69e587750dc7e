"""`slices` and `montage`: sheets of slices, every voxel a block of whole pixels, with captions and
scale bars.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.core.recipe import Recipe
from trabecula.view.looks import Look, find_look, phase_colours
from trabecula.view.picture import check_suffix, font, ink_on, save_picture
from trabecula.view.scale import draw_bar

_GAP = 14
_LETTERS = 15
_FOOT = 2 * _LETTERS + 8
_HEAD = 24
_WIDE = 640
"""Pixels that a panel may be wide; larger slices are thinned by a whole factor."""

AXES = "zyx"


@dataclass(frozen=True, eq=False)
class _Panel:
    """One slice as pixels, with the words below it."""

    pixels: np.ndarray
    caption: str
    pixel: float
    unit: str


def slices(
    image: Image | ArrayLike,
    path: str | PathLike[str] | None = None,
    *,
    per_axis: int = 1,
    look: str = "bone",
    side: int = 320,
) -> Image:
    """Draw a sheet of slices across z, y and x: labels in the colours of their phases, grey and
    colour as they are.

    Parameters
    ----------
    image : Image or array, (Z, Y, X) or (Y, X)
    path : path, optional
        Where to write it too, ending in .png.
    per_axis : int
        Slices an axis, 1..16, evenly spaced; one means the middle. A 2-D image is one panel.
    look : str
        Names the colours.
    side : int
        Pixels, 32..4096, that the longest edge of the image is enlarged to, at most and by whole
        factors.

    Returns
    -------
    Image
        Colour, one row of panels an axis (one row in all with one slice an axis).

    Raises
    ------
    InputError
        Numbers out of range, or an unknown look.
    """
    image = as_image(image)
    check_suffix(path, ".png")
    if not 1 <= per_axis <= 16:
        raise InputError(f"per_axis {per_axis} is outside 1..16")
    chosen = find_look(look)
    smallest = min(image.spacing)
    zoom = _zoom(image, smallest, side)
    rows = [
        [
            _panel(image, axis, at, chosen, smallest, zoom)
            for at in _places(image.shape[axis], per_axis)
        ]
        for axis in _axes(image)
    ]
    if per_axis == 1:
        rows = [[row[0] for row in rows]]
    values = _sheet(rows, [None] * len(rows), chosen)
    made = {"per_axis": per_axis, "look": look, "side": side}
    recipe = image.recipe.then("slices", values, **made)
    return save_picture(Image(values, "colour", recipe=recipe), path)


def montage(
    images: Sequence[Image | ArrayLike],
    names: Sequence[str],
    path: str | PathLike[str] | None = None,
    *,
    look: str = "bone",
    side: int = 320,
) -> Image:
    """Draw the middle slices of several images below each other, all at one scale where they share
    a unit.

    Parameters
    ----------
    images : sequence of Image or array
        Such as an exemplar and what was made from it.
    names : sequence of str
        A title for each.
    path, look, side
        As of `slices`; `side` is for the longest edge of all images.

    Returns
    -------
    Image
        Colour. Its recipe has one step, which holds the recipes of the images.

    Raises
    ------
    InputError
        No images, not as many names, numbers out of range, or an unknown look.
    """
    check_suffix(path, ".png")
    several = [as_image(image, name=f"image {index}") for index, image in enumerate(images)]
    if not several or len(names) != len(several):
        raise InputError(
            f"a montage needs images and a name for each: got {len(several)} images, {len(names)} "
            "names"
        )
    chosen = find_look(look)
    rows = []
    for image in several:
        peers = [other for other in several if other.unit == image.unit]
        smallest = min(min(other.spacing) for other in peers)
        zoom = min(_zoom(other, smallest, side) for other in peers)
        rows.append(
            [
                _panel(image, axis, image.shape[axis] // 2, chosen, smallest, zoom)
                for axis in _axes(image)
            ]
        )
    values = _sheet(rows, list(names), chosen)
    made = {
        "names": list(names),
        "look": look,
        "side": side,
        "images": [image.recipe.to_json() for image in several],
    }
    recipe = Recipe().then("montage", values, **made)
    return save_picture(Image(values, "colour", recipe=recipe), path)


def _axes(image: Image) -> Sequence[int]:
    """Return the axes to cut across; a 2-D image is shown as it is, as if across z."""
    return range(3) if image.ndim == 3 else (-1,)


def _places(length: int, count: int) -> list[int]:
    """Return evenly spaced positions; one is the middle."""
    return [min(length - 1, (2 * k + 1) * length // (2 * count)) for k in range(count)]


def _zoom(image: Image, smallest: float, side: int) -> float:
    """Return the pixels per smallest voxel edge: a whole number, or 1 / a whole number where the
    image is larger than a panel.
    """
    if not 32 <= side <= 4096:
        raise InputError(f"side {side} is outside 32..4096 pixels")
    ratios = [edge / smallest for edge in image.spacing]
    longest = max(n * ratio for n, ratio in zip(image.shape, ratios, strict=True))
    if longest > max(side, _WIDE):
        return 1 / -(-longest // max(side, _WIDE))
    most = max(1, int(side // longest))
    # Unequal edges become whole factors too: take the zoom that distorts least, the larger of
    # equals.
    return min(
        range((most + 1) // 2, most + 1),
        key=lambda zoom: (round(_distortion(ratios, zoom), 2), -zoom),
    )


def _distortion(ratios: Sequence[float], zoom: int) -> float:
    return max(abs(round(ratio * zoom) / (ratio * zoom) - 1) for ratio in ratios)


def _panel(image: Image, axis: int, at: int, look: Look, smallest: float, zoom: float) -> _Panel:
    plane = image.values if axis < 0 else np.take(image.values, at, axis=axis)
    edges = [edge for index, edge in enumerate(image.spacing) if index != axis]
    pixels = _colour_plane(image, plane, look)
    pixel = 0.0
    for index, edge in enumerate(edges):
        factor = edge / smallest * zoom
        if factor >= 1:
            pixels, pixel = np.repeat(pixels, round(factor), axis=index), edge / round(factor)
        else:
            every = round(1 / factor)
            pixels, pixel = (
                np.take(pixels, np.arange(0, pixels.shape[index], every), axis=index),
                edge * every,
            )
    size = " x ".join(map(str, image.shape))
    caption = size if axis < 0 else f"{AXES[axis]} = {at} of {image.shape[axis]}"
    # The pixel is that of the last axis, along which the scale bar lies.
    return _Panel(pixels, caption, pixel, image.unit)


def _colour_plane(image: Image, plane: np.ndarray, look: Look) -> np.ndarray:
    """Colour a plane, (H, W, 3) uint8; grey of other types than uint8 runs from the image's lowest
    to its highest value.
    """
    if image.kind == "colour":
        return plane
    if image.kind == "labels":
        return phase_colours(image, look)[plane]
    if plane.dtype != np.uint8:
        low, high = float(image.values.min()), float(image.values.max())
        plane = np.round(
            (plane.astype(np.float64) - low) * (255 / (high - low) if high > low else 0)
        ).astype(np.uint8)
    return np.repeat(plane[..., None], 3, axis=-1)


def _sheet(rows: list[list[_Panel]], titles: Sequence[str | None], look: Look) -> np.ndarray:
    """Draw rows of panels on the look's background."""
    from PIL import Image as Pillow
    from PIL import ImageDraw

    heads = [_HEAD if title else 0 for title in titles]
    heights = [max(panel.pixels.shape[0] for panel in row) for row in rows]
    widths = [
        sum(max(panel.pixels.shape[1], _least(panel)) + _GAP for panel in row) for row in rows
    ]
    named = [int(font(_LETTERS + 3).getlength(title)) + _GAP if title else 0 for title in titles]
    width = max(*widths, *named) + _GAP
    height = sum(heads) + sum(heights) + len(rows) * (_FOOT + _GAP) + _GAP
    picture = Pillow.new("RGB", (width, height), look.background)
    canvas, ink = ImageDraw.Draw(picture), ink_on(look.background)
    top = _GAP
    for row, title, head, tall in zip(rows, titles, heads, heights, strict=True):
        if title:
            canvas.text((_GAP, top), title, fill=ink, font=font(_LETTERS + 3))
        left = _GAP
        for panel in row:
            picture.paste(Pillow.fromarray(np.ascontiguousarray(panel.pixels)), (left, top + head))
            _letter(canvas, panel, left, top + head + panel.pixels.shape[0], ink)
            left += max(panel.pixels.shape[1], _least(panel)) + _GAP
        top += head + tall + _FOOT + _GAP
    return np.asarray(picture)


def _least(panel: _Panel) -> int:
    """Return the pixels that caption and scale bar need side by side."""
    return int(font(_LETTERS).getlength(panel.caption)) + 90


def _letter(canvas: Any, panel: _Panel, left: int, top: int, ink: tuple[int, int, int]) -> None:
    """Draw the caption to the left below the panel, the scale bar to the right of it."""
    canvas.text((left, top + 6), panel.caption, fill=ink, font=font(_LETTERS))
    start = left + int(font(_LETTERS).getlength(panel.caption)) + 16
    room = max(panel.pixels.shape[1], _least(panel)) + left - start
    draw_bar(
        canvas,
        start,
        top + _LETTERS + 14,
        pixel=panel.pixel,
        unit=panel.unit,
        room=max(room / 2, 24),
        ink=ink,
        size=_LETTERS,
    )
