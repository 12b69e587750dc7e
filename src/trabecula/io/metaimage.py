"""MetaImage: a text header, `.mhd` with the voxels in `.raw` beside it, or `.mha` with both in one
file.

The header lists axes x first. ITK's reader takes lines of at most 500 characters, so our JSON is
cut into numbered keys, which it skips.
"""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np

from trabecula.core.errors import FileError, InputError
from trabecula.core.image import Image
from trabecula.engine.files import replacing
from trabecula.io.guard import DEFLATE, check_claim, check_dtype, check_there, report_damage
from trabecula.io.metadata import FileContent, decode, encode
from trabecula.io.units import canonical

_ELEMENTS = {
    "MET_CHAR": "int8",
    "MET_UCHAR": "uint8",
    "MET_SHORT": "int16",
    "MET_USHORT": "uint16",
    "MET_INT": "int32",
    "MET_UINT": "uint32",
    "MET_LONG_LONG": "int64",
    "MET_ULONG_LONG": "uint64",
    "MET_FLOAT": "float32",
    "MET_DOUBLE": "float64",
    # Written by few; ITK gives them four bytes on every machine.
    "MET_LONG": "int32",
    "MET_ULONG": "uint32",
}
_UNITS = ("um", "mm", "cm")  # what DistanceUnits can say
_KEY = "TrabeculaJson"
_CUT = 400
_HEADER_ROOM = 1 << 22  # bytes; a header without an end is no header


def write(image: Image, path: Path) -> Path:
    """Write .mhd and .raw, or .mha (see `trabecula.io.files.write`)."""
    check_dtype(image.values.dtype, tuple(dict.fromkeys(_ELEMENTS.values())), form="MetaImage")
    values = np.ascontiguousarray(image.values, dtype=image.values.dtype.newbyteorder("<"))
    if path.suffix.lower() == ".mha":
        packed = zlib.compress(values.data.cast("B"), 4)
        with replacing(path) as temporary, temporary.open("wb") as file:
            file.write(_header(image, "LOCAL", packed=len(packed)).encode("ascii"))
            file.write(packed)
        return path
    header, voxels = path.with_suffix(".mhd"), path.with_suffix(".raw")
    # Both are complete before either takes its place; the inner one, the voxels, does so first.
    with replacing(header) as temporary_header, replacing(voxels) as temporary_voxels:
        values.tofile(temporary_voxels)
        try:
            temporary_header.write_text(_header(image, voxels.name), encoding="utf-8")
        except UnicodeEncodeError:
            raise InputError(
                f"the name {voxels.name!r} cannot stand in a MetaImage header: choose another"
            ) from None
    return header


def _header(image: Image, data_file: str, *, packed: int | None = None) -> str:
    spacing = " ".join(repr(edge) for edge in reversed(image.spacing))
    element = next(met for met, name in _ELEMENTS.items() if name == image.values.dtype.name)
    lines = {
        "ObjectType": "Image",
        "NDims": image.ndim,
        "BinaryData": "True",
        "BinaryDataByteOrderMSB": "False",
        "CompressedData": packed is not None,
        **({} if packed is None else {"CompressedDataSize": packed}),
        "Offset": " ".join(["0"] * image.ndim),
        "ElementSpacing": spacing,
        **({"DistanceUnits": canonical(image.unit)} if canonical(image.unit) in _UNITS else {}),
        "DimSize": " ".join(map(str, reversed(image.shape))),
        **({"ElementNumberOfChannels": 3} if image.kind == "colour" else {}),
        "ElementType": element,
    }
    text = encode(image)
    pieces = [text[start : start + _CUT] for start in range(0, len(text), _CUT)]
    # A piece that began or ended in a space would lose it, so each stands in bars.
    lines |= {f"{_KEY}{number:03d}": f"|{piece}|" for number, piece in enumerate(pieces)}
    lines["ElementDataFile"] = data_file  # the last key, by the format's rule
    return "".join(f"{key} = {value}\n" for key, value in lines.items())


def read(path: Path) -> FileContent:
    """Read .mhd, .mha, or the .raw beside an .mhd (see `trabecula.io.files.read`)."""
    if path.suffix.lower() == ".raw":
        header = path.with_suffix(".mhd")
        if not header.exists():
            raise FileError(
                f"cannot read {path}: raw voxels without {header.name} beside them; "
                "write that header, or read with numpy.fromfile"
            )
        path = header
    with report_damage(path, "MetaImage"):
        fields, local = _parse(path)
        shape, dtype, channels = _layout(fields)
        raw = _voxels(path, fields, local, shape, dtype)
        values = np.frombuffer(raw, dtype).reshape(shape)
        spacing = _floats(fields.get("ElementSpacing") or fields.get("ElementSize"))
        unit = fields.get("DistanceUnits")
        pieces = [
            fields[key].removeprefix("|").removesuffix("|")
            for key in sorted(fields)
            if key.startswith(_KEY)
        ]
        return FileContent(
            values,
            colour=channels == 3,
            spacing=spacing,
            unit=unit if unit in _UNITS else None,
            fields=decode("".join(pieces)) if pieces else None,
        )


def _parse(path: Path) -> tuple[dict[str, str], int]:
    """Return the header's keys and the offset of its end."""
    fields: dict[str, str] = {}
    with path.open("rb") as file:
        while "ElementDataFile" not in fields:
            line = file.readline(_HEADER_ROOM)
            if not line or file.tell() > _HEADER_ROOM:
                raise ValueError("its header has no ElementDataFile")
            key, equals, value = line.decode("utf-8").partition("=")
            if equals:
                fields[key.strip()] = value.strip()
        return fields, file.tell()


def _layout(fields: dict[str, str]) -> tuple[tuple[int, ...], np.dtype, int]:
    """Shape (colour last), type and channels of the voxels."""
    element = fields["ElementType"]
    if element.removesuffix("_ARRAY") not in _ELEMENTS:
        raise ValueError(f"its ElementType {element} is none of {', '.join(_ELEMENTS)}")
    order = fields.get("BinaryDataByteOrderMSB") or fields.get("ElementByteOrderMSB") or "False"
    dtype = np.dtype(_ELEMENTS[element.removesuffix("_ARRAY")]).newbyteorder(
        ">" if _true(order) else "<"
    )
    if not _true(fields.get("BinaryData", "True")):
        raise ValueError("its voxels are text (BinaryData = False), which is not read")
    sides = [int(side) for side in fields["DimSize"].split()]
    if len(sides) != int(fields["NDims"]):
        raise ValueError(f"NDims = {fields['NDims']} and DimSize = {fields['DimSize']} disagree")
    channels = int(fields.get("ElementNumberOfChannels", "1"))
    return (*reversed(sides), *([channels] if channels != 1 else [])), dtype, channels


def _voxels(
    path: Path, fields: dict[str, str], local: int, shape: tuple[int, ...], dtype: np.dtype
) -> bytes:
    name = fields["ElementDataFile"]
    if name.split()[0] == "LIST" or "%" in name:
        raise ValueError(
            "its voxels are in one file per slice, which is not read; read the folder of slices"
        )
    voxels = path if name == "LOCAL" else path.parent / name
    check_there(voxels)
    size, start = voxels.stat().st_size, local if name == "LOCAL" else 0
    packed = _true(fields.get("CompressedData", "False"))
    check_claim(path, shape, dtype, stored=(size - start) * (DEFLATE if packed else 1))
    need = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    skip = int(fields.get("HeaderSize", "0"))
    if name != "LOCAL":
        start = size - need if skip < 0 and not packed else max(skip, 0)
    if not packed and size - start != need:
        raise ValueError(
            f"its header claims {need} bytes of voxels, {voxels.name} holds {size - start}"
        )
    with voxels.open("rb") as file:
        file.seek(start)
        return _decompress(file.read(), need) if packed else file.read(need)


def _decompress(packed: bytes, need: int) -> bytes:
    decompressor = zlib.decompressobj(zlib.MAX_WBITS | 32)  # zlib or gzip, by their heads
    raw = decompressor.decompress(packed, need)
    # The check sum comes after the last voxel: ask for a byte more, so that it is read and weighed.
    if (
        decompressor.decompress(decompressor.unconsumed_tail, 1)
        or len(raw) != need
        or not decompressor.eof
    ):
        raise ValueError(f"its header claims {need} bytes of voxels, {len(raw)} can be unpacked")
    return raw


def _true(text: str) -> bool:
    return text.lower() in ("true", "1")


def _floats(text: str | None) -> tuple[float, ...] | None:
    return tuple(abs(float(edge)) for edge in reversed(text.split())) if text else None
