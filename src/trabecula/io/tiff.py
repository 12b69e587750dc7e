"""TIFF: pages along z, with the metadata of ImageJ and OME both ways.

What is written is an ImageJ stack where ImageJ has the type (uint8, uint16, float32, colour) and
classic TIFF the room, else OME-TIFF, else plain pages. Our own JSON is in a private tag of the
first page, so both kinds of reader skip it.
"""

from __future__ import annotations

import inspect
import logging
import struct
import xml.etree.ElementTree as ElementTree
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.files import replacing
from trabecula.engine.parallel import thread_count
from trabecula.io.guard import DEFLATE, check_claim, check_dtype, report_damage
from trabecula.io.metadata import FileContent, decode, encode
from trabecula.io.pixels import from_palette, without_alpha
from trabecula.io.resolution import Calibration, from_resolution, plausible
from trabecula.io.units import canonical, has_length, symbol, to_metres

TAG = 65000  # first of the codes that TIFF leaves for private use
_DESCRIPTION = 270
_IMAGEJ = ("uint8", "uint16", "float32")
_OME = ("uint8", "uint16", "uint32", "int8", "int16", "int32", "float32", "float64")
_PLAIN = (*_OME, "uint64", "int64", "float16")
# offsets of classic TIFF have 32 bits; leave room for the directories
_CLASSIC_ROOM = 2**32 - 2**25
# Codes of compression and of what a page's numbers mean, as the format defines them.
_NONE, _ADOBE_DEFLATE, _DEFLATE, _PACKBITS, _LZMA = 1, 8, 32946, 32773, 34925
# by tifffile alone; the rest goes through Pillow
_DECODED = (_NONE, _ADOBE_DEFLATE, _DEFLATE, _PACKBITS, _LZMA)
_WHITE_IS_ZERO, _PALETTE = 0, 3

# tifffile tells what it stumbles over to a logger; here it becomes one error, so a terminal need
# not show both.
logging.getLogger("tifffile").addHandler(logging.NullHandler())


def write(image: Image, path: Path) -> Path:
    """Write a TIFF (see `trabecula.io.files.write`)."""
    import tifffile

    check_dtype(image.values.dtype, _PLAIN, form="TIFF")
    flavour, metadata = _flavour(image)
    with (
        replacing(path) as temporary,
        tifffile.TiffWriter(
            temporary, bigtiff=image.values.nbytes > _CLASSIC_ROOM, **_writer_options(flavour)
        ) as tiff,
    ):
        values = np.ascontiguousarray(image.values)
        # all its axes, TZCYXS: tifffile would take a last axis of one voxel for samples
        if flavour == "imagej":
            y, x = image.shape[-2:]
            values = values.reshape(1, -1, 1, y, x, 3 if image.kind == "colour" else 1)
        tiff.write(
            values,
            photometric="rgb" if image.kind == "colour" else "minisblack",
            compression="zlib",
            maxworkers=thread_count(),
            resolution=(_per_unit(image.spacing[-1]), _per_unit(image.spacing[-2])),
            resolutionunit="none",
            metadata=metadata,
            extratags=[(TAG, "s", 0, encode(image), True)],
        )
    return path


def _writer_options(flavour: str) -> dict[str, Any]:
    """Return the options of `TiffWriter` for a flavour: `kind` since tifffile 2026.5, three
    booleans before.
    """
    import tifffile

    if "kind" in inspect.signature(tifffile.TiffWriter).parameters:
        return {"kind": "shaped" if flavour == "plain" else flavour}
    return {"imagej": flavour == "imagej", "ome": flavour == "ome", "shaped": flavour == "plain"}


def _flavour(image: Image) -> tuple[str, dict[str, Any]]:
    """Return the flavour of TIFF, by the readers that have the type, and its metadata."""
    axes = ("ZYX" if image.ndim == 3 else "YX") + ("S" if image.kind == "colour" else "")
    name = image.values.dtype.name
    if name in _IMAGEJ and image.values.nbytes <= _CLASSIC_ROOM:
        metadata: dict[str, Any] = {
            "unit": canonical(image.unit) if has_length(image.unit) else "pixel"
        }
        if image.ndim == 3:
            metadata["spacing"] = image.spacing[0]
        if image.kind == "labels":  # else a viewer shows labels 0 and 1 both as black
            metadata |= {"min": 0.0, "max": float(len(image.phases) - 1)}
        return "imagej", metadata
    if name in _OME:
        metadata = {"axes": axes}
        for axis, edge in zip("ZYX"[-image.ndim :], image.spacing, strict=True):
            metadata |= {
                f"PhysicalSize{axis}": edge,
                f"PhysicalSize{axis}Unit": symbol(image.unit) or "pixel",
            }
        return "ome", metadata
    return "plain", {"axes": axes}


def _per_unit(edge: float) -> tuple[int, int]:
    """Return the voxels per unit as the nearest rational of two 32-bit numbers."""
    most = 2**32 - 1
    value = min(max(1 / Fraction(edge), Fraction(1, most)), Fraction(most))
    if value >= 1:
        near = value.limit_denominator(int(most / value))
        return near.numerator, near.denominator
    near = (1 / value).limit_denominator(int(most * value))
    return near.denominator, near.numerator


def read(path: Path) -> FileContent:
    """Read a TIFF (see `trabecula.io.files.read`)."""
    import tifffile

    with (
        report_damage(path, "TIFF", also=(tifffile.TiffFileError,)),
        tifffile.TiffFile(path) as tiff,
    ):
        _check_directories(tiff)
        series = _only_series(tiff)
        page: Any = tiff.pages.first
        _check_codes(page)
        shrinks = {_NONE: 1, _ADOBE_DEFLATE: DEFLATE, _DEFLATE: DEFLATE}.get(page.compression)
        check_claim(
            path, series.shape, series.dtype, stored=shrinks and tiff.filehandle.size * shrinks
        )
        native = page.compression in _DECODED
        values = (
            series.asarray(maxworkers=thread_count()) if native else _read_by_pillow(path, tiff)
        )
        # Versions of tifffile differ in which axes of one voxel they leave out; shape and axes of a
        # series agree in each.
        values = _stack_axes(values.reshape(series.shape), series.axes, path)
        values, colour = _pixel_values(
            values, page, tiff.is_imagej, inverted=native and page.photometric == _WHITE_IS_ZERO
        )
        tag = page.tags.get(TAG)
        fields = decode(tag.value if tag else None)
        if fields is not None and len(fields["spacing"]) == 3 and values.ndim - colour == 2:
            # a volume of one slice, which TIFF itself cannot tell from a picture
            values = values[None]
        return FileContent(
            values,
            colour=colour,
            fields=fields,
            **_calibration(tiff, page, ndim=values.ndim - colour)._asdict(),
        )


def _check_codes(page: Any) -> None:
    """Raise where a tag that should be one number is none, as tifffile then gives it."""
    for name in ("compression", "photometric", "samplesperpixel"):
        if not isinstance(getattr(page, name), int):
            raise ValueError(f"its {name} is {getattr(page, name)}, which should be one number")


def _check_directories(tiff: Any) -> None:
    """Raise where a directory of a page lies beyond the end: tifffile would leave such pages out
    and go on.
    """
    file, form, size = tiff.filehandle, tiff.tiff, tiff.filehandle.size
    file.seek(4 if form.version == 42 else 8)
    pages, offset = 0, _number(file, form.offsetformat)
    while offset and pages <= size // form.tagsize:
        file.seek(offset)
        entries = file.read(_number(file, form.tagnoformat) * form.tagsize)
        if pages == 0:
            _check_first(entries, form, size)
        offset = _number(file, form.offsetformat)
        pages += 1
    if pages != len(tiff.pages):
        raise ValueError(f"its directories name {pages} pages, {len(tiff.pages)} are readable")


def _check_first(entries: bytes, form: Any, size: int) -> None:
    """Raise where the texts that say what the file means lie beyond its end."""
    value_at = form.tagsize - form.offsetsize
    for start in range(0, len(entries) - form.tagsize + 1, form.tagsize):
        (code,) = struct.unpack_from(form.byteorder + "H", entries, start)
        if code in (_DESCRIPTION, TAG):
            (count,) = struct.unpack_from(
                form.offsetformat, entries, start + value_at - form.offsetsize
            )
            (offset,) = struct.unpack_from(form.offsetformat, entries, start + value_at)
            if count > form.offsetsize and offset + count > size:
                raise ValueError("its description lies beyond its end")


def _number(file: Any, form: str) -> int:
    return int(struct.unpack(form, file.read(struct.calcsize(form)))[0])


def _only_series(tiff: Any) -> Any:
    if not len(tiff.series):
        raise ValueError("it holds no picture")
    series = tiff.series[0]
    if len(tiff.series) > 1:
        raise InputError(
            f"{tiff.filename} holds {len(tiff.series)} unlike stacks: save the one you mean alone"
        )
    if series.is_multifile:
        raise InputError(
            f"{tiff.filename} is one of several files that hold the volume together: save it as "
            "one file"
        )
    for page in series:
        if page is None:
            raise ValueError("pages that its metadata name are missing")
        # A count of bytes is read in one piece, however little of it the file has.
        if (
            max(map(sum, zip(page.dataoffsets, page.databytecounts, strict=True)), default=0)
            > tiff.filehandle.size
        ):
            raise ValueError("voxels of a page lie beyond its end")
    images = (tiff.imagej_metadata or {}).get("images", 1) if tiff.is_imagej else 1
    if images * tiff.pages.first.size > series.size:
        raise ValueError(f"its metadata name {images} pages, {len(series)} are there")
    return series


def _read_by_pillow(path: Path, tiff: Any) -> np.ndarray:
    """Read pages in a compression that tifffile leaves to another package (LZW, JPEG, fax): Pillow
    brings libtiff.
    """
    from trabecula.io.raster import open_picture

    with open_picture(path, ("TIFF",)) as picture:
        pages = []
        for index in range(len(tiff.pages)):
            picture.seek(index)
            pages.append(np.asarray(picture))
    return np.stack(pages)


def _stack_axes(values: np.ndarray, axes: str, path: Path) -> np.ndarray:
    """Return the values with axes (z, y, x), colour last; one page is a picture."""
    for axis, letter in reversed(list(enumerate(axes))):
        if values.shape[axis] == 1 and letter not in "YX":
            values, axes = values.take(0, axis), axes[:axis] + axes[axis + 1 :]
    stack = [letter for letter in axes if letter not in "YXS"]
    if (
        len(stack) > 1
        or any(letter not in "ZQI" for letter in stack)
        or "Y" not in axes
        or "X" not in axes
    ):
        sizes = ", ".join(
            f"{letter} {size}" for letter, size in zip(axes, values.shape, strict=True)
        )
        raise InputError(
            f"{path} has the axes {sizes}: only one stack of slices (Z) can be read; save one time "
            "and channel alone"
        )
    order = [axes.index(letter) for letter in [*stack, "Y", "X", *("S" if "S" in axes else "")]]
    return values.transpose(order)


def _pixel_values(
    values: np.ndarray, page: Any, imagej: bool, *, inverted: bool
) -> tuple[np.ndarray, bool]:
    """Return the values as brightness or colour, and whether they are colour. ImageJ's palettes
    only show greys, so they are dropped.
    """
    samples = page.samplesperpixel
    if samples in (2, 4):
        values = without_alpha(values)
    elif samples not in (1, 3):
        raise InputError(f"the file has {samples} channels a pixel: save grey or red, green, blue")
    if page.photometric == _PALETTE and not imagej:
        if page.colormap is None:
            raise ValueError("its numbers stand for colours of a palette that it does not hold")
        return from_palette(values, (page.colormap.T >> 8).astype(np.uint8))
    if inverted and values.dtype.kind in "bu":
        values = ~values
    return values, samples in (3, 4)


def _calibration(tiff: Any, page: Any, *, ndim: int) -> Calibration:
    """Return the spacing along (z, y, x) and its unit from OME, ImageJ or the resolution tags, in
    this order.
    """
    if tiff.is_ome:
        found = _ome_calibration(tiff.ome_metadata, ndim=ndim)
        if found.spacing or found.ignored:
            return found
    y, x = (_edge(page.tags.get(name)) for name in ("YResolution", "XResolution"))
    if x is None or y is None:
        return Calibration()
    stated = (tiff.imagej_metadata or {}) if tiff.is_imagej else {}
    if tiff.is_imagej and (
        "unit" in stated or "spacing" in stated or page.tags.get("ResolutionUnit") is None
    ):
        z = abs(float(stated.get("spacing", 1.0))) or 1.0  # which ImageJ writes where it is not 1
        unit = str(stated["unit"]) if "unit" in stated else None
        return plausible(_imagej_calibration((z, y, x)[-ndim:], unit))
    tag = page.tags.get("ResolutionUnit")
    # A file without this tag is in inches (TIFF 6.0, page 38), but nobody who leaves it out means
    # so.
    unit = None if tag is None else {2: "inch", 3: "cm"}.get(int(tag.value))
    if unit is not None:
        return from_resolution(1 / y, 1 / x, unit, what="the TIFF's resolution tags", ndim=ndim)
    if tiff.is_imagej:
        return _imagej_calibration((1.0, y, x)[-ndim:], None)
    return Calibration()


def _imagej_calibration(spacing: tuple[float, ...], unit: str | None) -> Calibration:
    """Return ImageJ's calibration; edges of 1 without a unit mean that it knows none."""
    known = set(spacing) != {1.0} or (unit is not None and has_length(unit))
    return Calibration(spacing, unit, "ImageJ metadata") if known else Calibration()


def _edge(resolution: Any) -> float | None:
    if resolution is None or not isinstance(resolution.value, tuple):
        return None
    voxels, units = resolution.value
    return units / voxels if voxels and units else None


def _ome_calibration(text: str, *, ndim: int) -> Calibration:
    pixels = next(
        (node for node in ElementTree.fromstring(text).iter() if node.tag.endswith("}Pixels")), None
    )
    if pixels is None or "PhysicalSizeX" not in pixels.attrib:
        return Calibration()
    missing = [axis for axis in "ZYX"[-ndim:] if f"PhysicalSize{axis}" not in pixels.attrib]
    if missing:
        return Calibration(
            ignored=f"its OME metadata say nothing of {', '.join(missing)}, so the sizes along the "
            "other axes are ignored: give "
            "the spacing (--spacing, --unit)"
        )
    edges, units = [], []
    for axis in "ZYX"[-ndim:]:
        edges.append(float(pixels.attrib[f"PhysicalSize{axis}"]))
        units.append(pixels.get(f"PhysicalSize{axis}Unit", "µm"))
    unit = units[-1]
    if not has_length(unit):
        return Calibration(tuple(edges), "voxel", "OME metadata")
    alike = (
        e if u == unit else e * to_metres(u) / to_metres(unit)
        for e, u in zip(edges, units, strict=True)
    )
    return Calibration(tuple(alike), unit, "OME metadata")
