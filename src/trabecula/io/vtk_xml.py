"""XML files of VTK (.vti, .vtu): their data arrays, inline or appended, text, base64 or raw, packed
by zlib or not, of either byte order, with counts of 32 or 64 bits.

Format: VTK File Formats, https://docs.vtk.org/en/latest/vtk_file_formats/.
"""

from __future__ import annotations

import base64
import xml.etree.ElementTree as ElementTree
import zlib
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from trabecula.io.guard import DEFLATE

TYPES = {
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
"""VTK's names of the types of numbers -> NumPy's."""


@dataclass(frozen=True)
class VtkFile:
    """The XML without its appended bytes, and how bytes are packed in it."""

    path: Path
    root: ElementTree.Element
    appended: bytes
    encoding: str
    text: str = ""
    """What stands before the first tag of the file, comments among it."""

    @property
    def order(self) -> str:
        """Return the byte order, as NumPy writes it."""
        return ">" if self.root.get("byte_order") == "BigEndian" else "<"

    @property
    def count_type(self) -> np.dtype:
        """Return the type of the counts before the numbers."""
        return np.dtype(
            self.order + {"UInt32": "u4", "UInt64": "u8"}[self.root.get("header_type", "UInt32")]
        )

    @property
    def is_packed(self) -> bool:
        """Return whether the numbers are compressed, which only zlib may have done."""
        compressor = self.root.get("compressor", "")
        if compressor not in ("", "vtkZLibDataCompressor"):
            raise ValueError(
                f"it is packed with {compressor}, only vtkZLibDataCompressor is read; save it so "
                "in ParaView"
            )
        return bool(compressor)

    def dtype(self, array: ElementTree.Element) -> np.dtype:
        """Return the type of an array's numbers, in the byte order of the file."""
        return np.dtype(self.order + np.dtype(TYPES[array.get("type", "")]).str[1:])

    def room(self, array: ElementTree.Element) -> int:
        """Return the bytes of numbers that the file can hold at most for an array."""
        # a number as text takes two characters or more, and is one of up to eight bytes
        factor = 4 if array.get("format", "ascii") == "ascii" else DEFLATE if self.is_packed else 1
        return self.path.stat().st_size * factor

    def values(self, array: ElementTree.Element, shape: tuple[int, ...]) -> np.ndarray:
        """Return the numbers of a data array.

        Parameters
        ----------
        array : Element
            The tag DataArray.
        shape : tuple of int
            Of the result, components last; checked by `check_claim` before.

        Raises
        ------
        ValueError, LookupError
            The array is damaged, or holds another count of numbers.
        """
        dtype = self.dtype(array)
        count = int(np.prod(shape, dtype=np.int64))
        return _values(self, array, dtype, count).reshape(shape)


def parse(path: Path) -> VtkFile:
    """Parse the XML of a file, and keep its appended bytes apart."""
    raw = path.read_bytes()
    before = raw[: max(raw.find(b"<VTKFile"), 0)].decode("utf-8", "replace")
    start = raw.find(b"<AppendedData")
    if start < 0:
        return VtkFile(path, ElementTree.fromstring(raw), b"", "", before)
    # Appended raw bytes are not XML: cut them out before parsing, and close the tag.
    opened = raw.index(b">", start) + 1
    underscore = raw.index(b"_", opened)
    end = raw.rfind(b"</AppendedData>")
    if end < underscore:
        raise ValueError("its appended data have no end")
    root = ElementTree.fromstring(raw[:opened] + raw[end:])
    node = root.find("AppendedData")
    encoding = "" if node is None else node.get("encoding", "base64")
    return VtkFile(path, root, raw[underscore + 1 : end], encoding, before)


def _values(whole: VtkFile, array: ElementTree.Element, dtype: np.dtype, count: int) -> np.ndarray:
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


def _bytes(whole: VtkFile, data: bytes, need: int, *, coded: bool) -> bytes:
    """Return the numbers' bytes from `data`, which starts with their counts; other arrays may
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
