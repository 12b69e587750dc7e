"""PNG, JPEG and BMP: 2-D pictures, grey, colour or labels."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.files import replacing
from trabecula.io import sidecar
from trabecula.io.formats import format_of
from trabecula.io.guard import DEFLATE, check_claim, check_dtype, report_damage
from trabecula.io.metadata import KEY, FileContent, decode, encode, greys_of_labels, labels_of_greys
from trabecula.io.pixels import from_palette, without_alpha
from trabecula.io.resolution import Calibration, from_resolution

# MPO is how phones write JPEG: the picture first, a preview after it.
_PILLOW = {"PNG": ("PNG",), "JPEG": ("JPEG", "MPO"), "BMP": ("BMP",)}
_limit = threading.Lock()
_JPEG_COMMENT = 65000  # bytes that fit into a JPEG's comment
_MODES = {
    "1": bool,
    "L": np.uint8,
    "P": np.uint8,
    "I;16": np.uint16,
    "I": np.int32,
    "RGB": np.uint8,
    "LA": np.uint8,
    "RGBA": np.uint8,
}


def write(image: Image, path: Path) -> Path:
    """Write a picture (see `trabecula.io.files.write`)."""
    form = format_of(path).name
    if image.ndim != 2:
        raise InputError(
            f"{form} holds pictures of 2 axes, the image has {image.ndim}: "
            "write .tif or .zarr, or a folder of slices (a path ending in '/')"
        )
    check_dtype(image.values.dtype, ("uint8", "uint16") if form == "PNG" else ("uint8",), form=form)
    values, levels = greys_of_labels(image)
    text = encode(image, **({} if levels is None else {"levels": levels}))
    if form == "PNG":
        with replacing(path) as temporary:
            save_png(values, temporary, text=text)
    elif form == "JPEG":
        _write_jpeg(image, values, path, text)
    else:
        with sidecar.write_sidecar(path, values, text), replacing(path) as temporary:
            _picture(values).save(temporary, format="BMP")
    return path


def save_png(values: np.ndarray, path: Path, *, text: str | None = None) -> None:
    """Write grey (uint8, uint16) or colour (uint8) as PNG, with our JSON as a text chunk."""
    from PIL.PngImagePlugin import PngInfo

    info = PngInfo()
    if text is not None:
        info.add_text(KEY, text)
    _picture(values).save(path, format="PNG", pnginfo=info)


def _write_jpeg(image: Image, values: np.ndarray, path: Path, text: str) -> None:
    if image.kind == "labels":
        raise InputError("JPEG blurs labels into one another: write .png")
    if len(text) > _JPEG_COMMENT:
        raise InputError("the recipe is too long for a JPEG's comment: write .png")
    with replacing(path) as temporary:
        _picture(values).save(temporary, format="JPEG", quality=95, subsampling=0, comment=text)


def _picture(values: np.ndarray) -> Any:
    from PIL import Image as Picture

    return Picture.fromarray(np.ascontiguousarray(values))


def read(path: Path) -> FileContent:
    """Read a picture (see `trabecula.io.files.read`)."""
    form = format_of(path).name
    with report_damage(path, form):
        with open_picture(path, _PILLOW[form]) as picture:
            if picture.mode not in _MODES:
                raise InputError(
                    f"{path} has pixels of type {picture.mode}: save it as grey or RGB"
                )
            if form == "PNG" and getattr(picture, "n_frames", 1) > 1:
                raise InputError(f"{path} is an animation of {picture.n_frames} pictures: save one")
            bands = len(picture.getbands())
            # up to 8 pixels in a byte
            room = path.stat().st_size * 8 * DEFLATE if form != "JPEG" else None
            check_claim(
                path,
                (picture.height, picture.width, bands),
                np.dtype(_MODES[picture.mode]),
                stored=room,
            )
            values, colour = _pixels(picture)
            text = picture.info.get(KEY) if form == "PNG" else picture.info.get("comment")
            size = _calibration(picture, form)
        fields = sidecar.read_sidecar(path, values) if form == "BMP" else decode(text)
        return FileContent(
            labels_of_greys(values, fields),
            colour=colour,
            fields=fields,
            lossy=form == "JPEG",
            **size._asdict(),
        )


def _calibration(picture: Any, form: str) -> Calibration:
    """Return the calibration of a PNG's pHYs chunk or a JPEG's density, where it may be a voxel
    size.
    """
    x, y = picture.info.get("dpi", (0, 0)) if form in ("PNG", "JPEG") else (0, 0)
    if not (x > 0 and y > 0):
        return Calibration()
    # Pillow turns a PNG's whole pixels a metre into inches.
    if form == "PNG":
        return from_resolution(
            round(y / 0.0254), round(x / 0.0254), "m", what="the PNG's pHYs chunk"
        )
    return from_resolution(float(y), float(x), "inch", what="the JPEG's density")


def open_picture(path: Path, forms: tuple[str, ...]) -> Any:
    """Open a picture: its header is read, its pixels are not.

    Pillow refuses pictures of more than 179 million pixels, whatever memory there is; here
    `check_claim` weighs them.
    """
    from PIL import Image as Picture

    with _limit:
        usual, Picture.MAX_IMAGE_PIXELS = Picture.MAX_IMAGE_PIXELS, None
        try:
            return Picture.open(path, formats=forms)
        finally:
            Picture.MAX_IMAGE_PIXELS = usual


def _pixels(picture: Any) -> tuple[np.ndarray, bool]:
    """Return grey (Y, X) or colour (Y, X, 3), and whether it is colour."""
    if picture.mode == "P" and "transparency" not in picture.info:
        palette = np.array(picture.getpalette("RGB"), np.uint8).reshape(-1, 3)
        return from_palette(np.array(picture), palette)
    if "transparency" in picture.info:
        picture = picture.convert("LA" if picture.mode in ("1", "L") else "RGBA")
    values = np.array(picture)
    if picture.mode in ("LA", "RGBA"):
        values = without_alpha(values)
    return values, values.ndim == 3
