"""What every picture shares: its file and its lettering."""

from __future__ import annotations

from functools import cache
from os import PathLike
from pathlib import Path
from typing import Any

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.io.files import write


def check_png(path: str | PathLike[str] | None) -> None:
    """Raise where a path does not end in .png; asked before the work, not after it."""
    if path is not None and Path(path).suffix.lower() != ".png":
        raise InputError(f"pictures are written as .png, the path ends in {Path(path).suffix!r}: {Path(path).name}")


def kept(picture: Image, path: str | PathLike[str] | None) -> Image:
    """The picture, also written with its recipe where a path is given."""
    if path is not None:
        write(picture, path)
    return picture


@cache
def font(size: int) -> Any:
    """The lettering that Pillow brings, in pixels."""
    from PIL import ImageFont

    return ImageFont.load_default(size=size)


def ink_on(background: tuple[int, int, int]) -> tuple[int, int, int]:
    """Dark letters on a light ground, light ones on a dark."""
    return (40, 44, 52) if sum(background) > 384 else (232, 234, 238)
