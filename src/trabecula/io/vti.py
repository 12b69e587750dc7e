"""VTK ImageData (.vti), as ParaView reads it: voxels are cells, axes x first.

Written with zlib blocks as appended raw bytes; read with voxels inline or appended, text, base64 or
raw, packed or not. Our JSON is a string in the field data. Formats: VTK File Formats,
https://docs.vtk.org/en/latest/vtk_file_formats/.
"""

from __future__ import annotations

import base64
import sys
import xml.etree.ElementTree as ElementTree
import zlib
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.files import replacing
from trabecula.io.guard import DEFLATE, check_claim, check_dtype, report_damage
from trabecula.io.metadata import KEY, FileContent, decode, encode

_TYPES = {
    "UInt8": "uint8",
    "Int8": "int8",
    "UInt16": "uint16",
    "Int16": "int16",
    "UInt32": "uint32",
    "Int32": "int32",
    "UInt64": "uint64",
    "Int64": "int64",
    "Float32": "float32",
    "Float64": "float64",
}
_BLOCK = 1 << 20


def write(image: Image, path: Path) -> Path:
    """Write .vti (see `trabecula.io.files.write`)."""
    check_dtype(image.values.dtype, tuple(_TYPES.values()), form="VTK ImageData")
    values = np.ascontiguousarray(image.values)
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(_head(image).encode("ascii"))
        for piece in _compress(values):
            file.write(piece)
        file.write(b"\n  </AppendedData>\n</VTKFile>\n")
    return path


def _head(image: Image) -> str:
    # a flat extent along z is VTK's way to say 2-D
    sides = [*reversed(image.shape), *[0] * (3 - image.ndim)]
    spacing = [*reversed(image.spacing), *[1.0] * (3 - image.ndim)]
    extent = " ".join(f"0 {side}" for side in sides)
    type_name = next(vtk for vtk, name in _TYPES.items() if name == image.values.dtype.name)
    colour = ' NumberOfComponents="3"' if image.kind == "colour" else ""
    text = " ".join(str(code) for code in (*encode(image).encode("ascii"), 0))
    order = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
    kind = f'type="ImageData" version="1.0" byte_order="{order}" header_type="UInt64"'
    return f"""<?xml version="1.0"?>
<VTKFile {kind} compressor="vtkZLibDataCompressor">
  <ImageData WholeExtent="{extent}" Origin="0 0 0" Spacing="{" ".join(map(repr, spacing))}">
    <FieldData>
      <Array type="String" Name="{KEY}" NumberOfTuples="1" format="ascii">{text}</Array>
    </FieldData>
    <Piece Extent="{extent}">
      <CellData Scalars="{image.kind}">
        <DataArray type="{type_name}" Name="{image.kind}"{colour} format="appended" offset="0"/>
      </CellData>
    </Piece>
  </ImageData>
  <AppendedData encoding="raw">
   _"""


def _compress(values: np.ndarray) -> list[bytes]:
    """Return counts (blocks, bytes of a block, bytes of a shorter last one, packed bytes of each),
    then the blocks.
    """
    raw = values.reshape(-1).view(np.uint8).data
    blocks = [zlib.compress(raw[start : start + _BLOCK], 4) for start in range(0, len(raw), _BLOCK)]
    counts = [len(blocks), _BLOCK, len(raw) % _BLOCK, *map(len, blocks)]
    return [np.array(counts, np.uint64).tobytes(), *blocks]


@dataclass(frozen=True)
class _File:
    """The XML without its appended bytes, and how bytes are packed in it."""

    root: ElementTree.Element
    appended: bytes
    encoding: str

    @property
    def order(self) -> str:
        """Return the byte order, as NumPy writes it."""
        return ">" if self.root.get("byte_order") == "BigEndian" else "<"

    @property
    def count_type(self) -> np.dtype:
        """Return the type of the counts before the voxels."""
        return np.dtype(
            self.order + {"UInt32": "u4", "UInt64": "u8"}[self.root.get("header_type", "UInt32")]
        )

    @property
    def is_packed(self) -> bool:
        """Return whether the voxels are compressed, which only zlib may have done."""
        compressor = self.root.get("compressor", "")
        if compressor not in ("", "vtkZLibDataCompressor"):
            raise ValueError(
                f"it is packed with {compressor}, only vtkZLibDataCompressor is read; save it so "
                "in ParaView"
            )
        return bool(compressor)


def read(path: Path) -> FileContent:
    """Read .vti (see `trabecula.io.files.read`)."""
    with report_damage(path, "VTK ImageData"):
        whole = _parse(path)
        grid = whole.root.find("ImageData")
        pieces = [] if grid is None else grid.findall("Piece")
        if grid is None or len(pieces) != 1:
            raise ValueError(f"it holds {len(pieces)} pieces of ImageData, one is needed")
        low_high = [
            int(bound) for bound in pieces[0].get("Extent", grid.get("WholeExtent", "")).split()
        ]
        spans = [high - low for low, high in zip(low_high[::2], low_high[1::2], strict=True)]
        array, cells = _choose_array(pieces[0])
        sides = [max(span, 1) if cells else span + 1 for span in reversed(spans)]
        channels = int(array.get("NumberOfComponents", "1"))
        shape = tuple(sides if spans[2] else sides[1:]) + ((channels,) if channels != 1 else ())
        dtype = np.dtype(whole.order + np.dtype(_TYPES[array.get("type", "")]).str[1:])
        room = path.stat().st_size * (DEFLATE if whole.is_packed else 1)
        check_claim(path, shape, dtype, stored=room)
        values = _values(whole, array, dtype, int(np.prod(shape, dtype=np.int64))).reshape(shape)
        spacing = [abs(float(edge)) for edge in reversed(grid.get("Spacing", "1 1 1").split())]
        return FileContent(
            values,
            colour=channels == 3,
            spacing=tuple(spacing if spans[2] else spacing[1:]),
            fields=_read_fields(grid),
        )


def _parse(path: Path) -> _File:
    raw = path.read_bytes()
    start = raw.find(b"<AppendedData")
    if start < 0:
        return _File(ElementTree.fromstring(raw), b"", "")
    # Appended raw bytes are not XML: cut them out before parsing, and close the tag.
    opened = raw.index(b">", start) + 1
    underscore = raw.index(b"_", opened)
    end = raw.rfind(b"</AppendedData>")
    if end < underscore:
        raise ValueError("its appended data have no end")
    root = ElementTree.fromstring(raw[:opened] + raw[end:])
    node = root.find("AppendedData")
    encoding = "" if node is None else node.get("encoding", "base64")
    return _File(root, raw[underscore + 1 : end], encoding)


def _choose_array(piece: ElementTree.Element) -> tuple[ElementTree.Element, bool]:
    """Return the array that is the image, the named scalars or else the only one, and whether its
    values are on cells.
    """
    for place in ("CellData", "PointData"):
        node = piece.find(place)
        arrays = [] if node is None else node.findall("DataArray")
        if node is None or not arrays:
            continue
        named = [array for array in arrays if array.get("Name") == node.get("Scalars")]
        if len(arrays) > 1 and not named:
            names = ", ".join(str(array.get("Name")) for array in arrays)
            raise InputError(
                f"the file holds several arrays ({names}) and names none as scalars: save one"
            )
        return (named or arrays)[0], place == "CellData"
    raise ValueError("it holds no array")


def _values(whole: _File, array: ElementTree.Element, dtype: np.dtype, count: int) -> np.ndarray:
    form, text = array.get("format", "ascii"), (array.text or "").strip()
    if form == "ascii":
        values = np.array(text.split()).astype(dtype)
        if len(values) != count:
            raise ValueError(f"it holds {len(values)} numbers, its extent asks for {count}")
        return values
    if form == "appended":
        data = whole.appended[int(array.get("offset", "0")) :]
        raw = _bytes(whole, data, count * dtype.itemsize, coded=whole.encoding == "base64")
    else:
        raw = _bytes(whole, text.encode("ascii"), count * dtype.itemsize, coded=True)
    return np.frombuffer(raw, dtype)


def _bytes(whole: _File, data: bytes, need: int, *, coded: bool) -> bytes:
    """Return the voxels' bytes from `data`, which starts with their counts; other arrays may
    follow.
    """
    width = whole.count_type.itemsize
    if not whole.is_packed:
        raw = _decode_base64(data, width + need) if coded else data[: width + need]
        count = int(np.frombuffer(raw[:width], whole.count_type)[0])
        if count != need or len(raw) != width + need:
            raise ValueError(
                f"it holds {min(count, len(raw) - width)} bytes of voxels, its extent asks for "
                f"{need}"
            )
        return raw[width:]
    # In base64 the counts and the blocks are coded each on their own.
    start = _decode_base64(data, 3 * width) if coded else data[: 3 * width]
    blocks, size, last = (int(value) for value in np.frombuffer(start, whole.count_type))
    if (blocks - 1 if last else blocks) * size + last != need:
        raise ValueError(
            f"it claims {blocks} blocks of {size} bytes, its extent asks for {need} bytes"
        )
    head = (3 + blocks) * width
    raw_head = _decode_base64(data, head) if coded else data[:head]
    lengths = [int(value) for value in np.frombuffer(raw_head, whole.count_type)[3:]]
    rest = data[_base64_length(head) if coded else head :]
    packed = memoryview(_decode_base64(rest, sum(lengths)) if coded else rest)
    ends = np.cumsum([0, *lengths])
    # Of each block no more than the header says, and a byte by which a longer one is told.
    raw = b"".join(
        zlib.decompressobj().decompress(packed[a:b], size + 1) for a, b in pairwise(ends)
    )
    if len(raw) != need:
        raise ValueError(f"it holds {len(raw)} bytes of voxels, its extent asks for {need}")
    return raw


def _base64_length(count: int) -> int:
    return 4 * -(-count // 3)


def _decode_base64(data: bytes, count: int) -> bytes:
    return base64.b64decode(data[: _base64_length(count)], validate=True)[:count]


def _read_fields(grid: ElementTree.Element) -> dict | None:
    for array in grid.findall("FieldData/Array"):
        if array.get("Name") == KEY and array.get("format") == "ascii":
            return decode(bytes(int(code) for code in (array.text or "").split()))
    return None
