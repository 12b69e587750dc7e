"""NRRD through pynrrd. The file lists axes fastest first: colour, x, y, z."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.files import replacing
from trabecula.io.guard import DEFLATE, NUMBERS, check_claim, check_dtype, report_damage
from trabecula.io.metadata import KEY, FileContent, decode, encode
from trabecula.io.units import has_length

_NAMES = {  # as the format's definition lists them, NRRD 5, section 5
    "int8": ("signed char", "int8", "int8_t"),
    "uint8": ("uchar", "unsigned char", "uint8", "uint8_t"),
    "int16": ("short", "short int", "signed short", "signed short int", "int16", "int16_t"),
    "uint16": ("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"),
    "int32": ("int", "signed int", "int32", "int32_t"),
    "uint32": ("uint", "unsigned int", "uint32", "uint32_t"),
    "int64": (
        "longlong",
        "long long",
        "long long int",
        "signed long long",
        "signed long long int",
        "int64",
        "int64_t",
    ),
    "uint64": ("ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"),
    "float32": ("float",),
    "float64": ("double",),
}
_COLOUR = ("RGB-color", "3-color")
_NOT_SPACE = (
    *_COLOUR,
    "RGBA-color",
    "4-color",
    "vector",
    "list",
    "covariant-vector",
    "normal",
    "complex",
    "2-vector",
    "3-vector",
    "4-vector",
)


def write(image: Image, path: Path) -> Path:
    """Write .nrrd, gzip (see `trabecula.io.files.write`)."""
    import nrrd

    check_dtype(image.values.dtype, NUMBERS, form="NRRD")
    colour = image.kind == "colour"
    header: dict[str, Any] = {
        "encoding": "gzip",
        "kinds": [*(["RGB-color"] if colour else []), *["domain"] * image.ndim],
        "spacings": [*([math.nan] if colour else []), *reversed(image.spacing)],
    }
    if has_length(image.unit):
        header["units"] = [*([""] if colour else []), *[image.unit] * image.ndim]
    header[KEY] = encode(image)
    with replacing(path) as temporary:
        nrrd.write(str(temporary), image.values, header, compression_level=4, index_order="C")
    return path


def read(path: Path) -> FileContent:
    """Read .nrrd (see `trabecula.io.files.read`)."""
    import nrrd

    with report_damage(path, "NRRD", also=(nrrd.NRRDError, StopIteration)), path.open("rb") as file:
        header = nrrd.read_header(file)
        shape = tuple(reversed([int(side) for side in header["sizes"]]))
        dtype = _dtype(header["type"])
        detached = "data file" in header or "datafile" in header
        shrinks = (
            None if detached else {"raw": 1, "gzip": DEFLATE, "gz": DEFLATE}.get(header["encoding"])
        )
        check_claim(
            path, shape, dtype, stored=shrinks and (path.stat().st_size - file.tell()) * shrinks
        )
        values = nrrd.read_data(header, file, str(path), index_order="C")
        kinds = header.get("kinds", ["domain"] * len(shape))
        colour = kinds[0] in _COLOUR
        if any(kind in _NOT_SPACE for kind in kinds[colour:]):
            raise InputError(
                f"{path} holds axes of {', '.join(kinds)}: only grey, labels and RGB in the "
                "fastest axis can be read"
            )
        spacing, unit = _calibration(header, kinds)
        return FileContent(
            values, colour=colour, spacing=spacing, unit=unit, fields=decode(header.get(KEY))
        )


def _dtype(name: str) -> np.dtype:
    """Return the dtype of a type's name in a header, in this machine's byte order."""
    return np.dtype(next(dtype for dtype, names in _NAMES.items() if name in names))


def _calibration(
    header: dict[str, Any], kinds: list[str]
) -> tuple[tuple[float, ...] | None, str | None]:
    """Return the spacing along (z, y, x) and its unit."""
    in_space = [axis for axis, kind in enumerate(kinds) if kind not in _NOT_SPACE]
    if "spacings" in header:
        edges = [abs(float(header["spacings"][axis])) for axis in in_space]
    elif "space directions" in header:
        # A direction is the step from a voxel to the next along its axis; its length is the voxel's
        # edge.
        edges = [
            float(np.linalg.norm(np.asarray(header["space directions"][axis], float)))
            for axis in in_space
        ]
    else:
        return None, None
    units = [name for name in header.get("units", header.get("space units", [])) if name]
    if len(set(units)) > 1:
        raise InputError(
            f"the file's axes have different units ({', '.join(units)}): give spacing= and unit="
        )
    good = all(math.isfinite(edge) and edge > 0 for edge in edges)
    return (tuple(reversed(edges)) if good else None), (units[0] if units else None)
