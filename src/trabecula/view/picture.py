"""Files and lettering of all pictures."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.checks import as_path_text
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.files import replacing
from trabecula.io.files import write

_WRITTEN = {".png": "pictures are", ".gif": "a turntable is", ".html": "a page is"}


def check_suffix(path: str | PathLike[str] | None, suffix: str) -> None:
    """Raise where a path does not end in .png (.gif, .html); call it before the work."""
    if path is None:
        return
    place = Path(as_path_text(path))
    if place.suffix.lower() != suffix:
        raise InputError(
            f"{_WRITTEN[suffix]} written as {suffix}, the path ends in {place.suffix!r}: "
            f"{place.name}"
        )


def save_picture(picture: Image, path: str | PathLike[str] | None) -> Image:
    """Write a picture with its recipe where a path is given; return the picture."""
    if path is not None:
        write(picture, path)
    return picture


def save_gif(pictures: Sequence[np.ndarray], path: str | PathLike[str], *, seconds: float) -> Path:
    """Write (H, W, 3) pictures as a GIF that repeats, each shown for so long; all share the first
    one's 256 colours.
    """
    from PIL import Image as Pillow

    first = Pillow.fromarray(pictures[0]).quantize(256, dither=Pillow.Dither.NONE)
    frames = [
        Pillow.fromarray(picture).quantize(palette=first, dither=Pillow.Dither.NONE)
        for picture in pictures
    ]
    with replacing(Path(path)) as temporary:
        frames[0].save(
            temporary,
            format="GIF",
            save_all=True,
            append_images=frames[1:],
            duration=round(1000 * seconds),
            loop=0,
        )
    return Path(path)


@cache
def font(size: int) -> Any:
    """Return the lettering of Pillow, `size` pixels high."""
    from PIL import ImageFont

    return ImageFont.load_default(size=size)


def ink_on(background: tuple[int, int, int]) -> tuple[int, int, int]:
    """Return the colour of letters: dark on a light ground, light on a dark one."""
    return (40, 44, 52) if sum(background) > 384 else (232, 234, 238)
