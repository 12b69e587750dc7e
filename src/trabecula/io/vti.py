"""VTK ImageData (.vti), as ParaView reads it: voxels are cells, axes x first.

Written with zlib blocks as appended raw bytes; read with voxels inline or appended, text, base64 or
raw, packed or not. Our JSON is a string in the field data. Formats: VTK File Formats,
https://docs.vtk.org/en/latest/vtk_file_formats/.
"""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ElementTree
import zlib
from pathlib import Path

import numpy as np

from trabecula.core.checks import check_name
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.files import replacing
from trabecula.io.guard import check_claim, check_dtype, report_damage
from trabecula.io.metadata import KEY, FileContent, decode, encode
from trabecula.io.vtk_xml import TYPES, parse

_BLOCK = 1 << 20


def write(image: Image, path: Path) -> Path:
    """Write .vti (see `trabecula.io.files.write`)."""
    check_dtype(image.values.dtype, tuple(TYPES.values()), form="VTK ImageData")
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
    type_name = next(vtk for vtk, name in TYPES.items() if name == image.values.dtype.name)
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


def read(path: Path, dataset: str | None = None) -> FileContent:
    """Read .vti (see `trabecula.io.files.read`); `dataset` names one of its arrays."""
    with report_damage(path, "VTK ImageData"):
        whole = parse(path)
        grid = whole.root.find("ImageData")
        pieces = [] if grid is None else grid.findall("Piece")
        if grid is None or len(pieces) != 1:
            raise ValueError(f"it holds {len(pieces)} pieces of ImageData, one is needed")
        low_high = [
            int(bound) for bound in pieces[0].get("Extent", grid.get("WholeExtent", "")).split()
        ]
        spans = [high - low for low, high in zip(low_high[::2], low_high[1::2], strict=True)]
        array, cells = _choose_array(pieces[0], dataset)
        sides = [max(span, 1) if cells else span + 1 for span in reversed(spans)]
        channels = int(array.get("NumberOfComponents", "1"))
        shape = tuple(sides if spans[2] else sides[1:]) + ((channels,) if channels != 1 else ())
        check_claim(path, shape, whole.dtype(array), stored=whole.room(array))
        if channels not in (1, 3) or (channels == 3 and whole.dtype(array).kind == "f"):
            raise InputError(
                f"{path}: {array.get('Name')} has {channels} components: read one as a field "
                "(tb.fields.import_result, trabecula field import)"
            )
        values = whole.values(array, shape)
        spacing = [abs(float(edge)) for edge in reversed(grid.get("Spacing", "1 1 1").split())]
        return FileContent(
            values,
            colour=channels == 3,
            spacing=tuple(spacing if spans[2] else spacing[1:]),
            fields=_read_fields(grid),
        )


def _choose_array(
    piece: ElementTree.Element, dataset: str | None
) -> tuple[ElementTree.Element, bool]:
    """Return the array that is the image, the named scalars or else the only one, and whether its
    values are on cells.
    """
    if dataset is not None:
        known = {
            str(array.get("Name")): (array, place == "CellData")
            for place in ("PointData", "CellData")
            for array in piece.findall(f"{place}/DataArray")
        }
        check_name(dataset, known, name="array")
        return known[dataset]
    for place in ("CellData", "PointData"):
        node = piece.find(place)
        arrays = [] if node is None else node.findall("DataArray")
        if node is None or not arrays:
            continue
        named = [array for array in arrays if array.get("Name") == node.get("Scalars")]
        if len(arrays) > 1 and not named:
            names = ", ".join(str(array.get("Name")) for array in arrays)
            raise InputError(
                f"the file holds several arrays ({names}) and names none as scalars: name "
                "one (--dataset)"
            )
        return (named or arrays)[0], place == "CellData"
    raise ValueError("it holds no array")


def _read_fields(grid: ElementTree.Element) -> dict | None:
    for array in grid.findall("FieldData/Array"):
        if array.get("Name") == KEY and array.get("format") == "ascii":
            return decode(bytes(int(code) for code in (array.text or "").split()))
    return None
