"""Scanco's ISQ: 16-bit voxels behind a header of 512 bytes or more, little-endian.

The header, by byte: 0 "CTDATA-HEADER_V1"; 44, 48, 52 the voxels along x, y, z; 56, 60, 64 the
lengths along them in um (where a file has a slice thickness at 68 and an increment at 72 instead,
the increment is taken); 88 mu_scaling, by which values are divided for attenuation in 1/cm; 508 the
blocks of 512 bytes that precede the voxels, less one. Source: Scanco's customer page "ISQ header
format", as ITKIOScanco (itkScancoImageIO.cxx) and BoneJ (ISQReader.java) read it.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.progress import notify
from trabecula.io.guard import check_claim, report_damage
from trabecula.io.metadata import FileContent

_MAGIC = b"CTDATA-HEADER_V1"
_BLOCK = 512
_SHORT = 3
"""Scanco's number for voxels of 16 bits with a sign."""


class IsqHeader(NamedTuple):
    """What the header says.

    Attributes
    ----------
    shape : tuple of int
        Voxels along z, y, x.
    spacing : tuple of float
        Edges of a voxel along z, y, x in um.
    mu_scaling : int
        Values over this are attenuation in 1/cm; 0 where it is not stated.
    start : int
        Byte of the first voxel.
    """

    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]
    mu_scaling: int
    start: int


def read_header(path: Path) -> IsqHeader:
    """Read the header of an ISQ file.

    Raises
    ------
    FileError
        Not ISQ, or truncated.
    InputError
        Other voxels than 16-bit ones.
    """
    with report_damage(path, "Scanco ISQ"):
        with path.open("rb") as file:
            raw = file.read(_BLOCK)
        if not raw.startswith(_MAGIC):
            raise ValueError(f"it does not begin with {_MAGIC.decode()}")
        if len(raw) < _BLOCK:
            raise ValueError(f"it ends within its header, after {len(raw)} bytes")
        words = np.frombuffer(raw, "<i4")
        kind = int(words[4])
        if kind != _SHORT:
            raise InputError(
                f"{path} holds voxels of Scanco's type {kind}, 16-bit ones (3) are read: export "
                "it as ISQ or TIFF"
            )
        sides = words[11:14].astype(int).tolist()
        lengths = words[14:17].astype(float).tolist()
        if min(sides) < 1:
            raise ValueError(f"it claims {' x '.join(map(str, sides))} voxels")
        edges = [length / side for length, side in zip(lengths, sides, strict=True)]
        if edges[2] <= 0 < words[18]:
            edges[2] = float(words[18])
        if min(edges) <= 0:
            raise ValueError("its lengths are not positive")
        start = (int(words[127]) + 1) * _BLOCK
        if start < _BLOCK:
            raise ValueError("its voxels begin within its header")
        return IsqHeader(
            (sides[2], sides[1], sides[0]),
            (edges[2], edges[1], edges[0]),
            max(int(words[22]), 0),
            start,
        )


def read(path: Path) -> FileContent:
    """Read an ISQ file (see `trabecula.io.files.read`); values are as stored."""
    head = read_header(path)
    with report_damage(path, "Scanco ISQ"):
        dtype = np.dtype("<i2")
        check_claim(path, head.shape, dtype, stored=path.stat().st_size - head.start)
        count = int(np.prod(head.shape, dtype=np.int64))
        values = np.fromfile(path, dtype, count, offset=head.start).reshape(head.shape)
    if head.mu_scaling:
        notify(f"{path}: values over {head.mu_scaling} are attenuation in 1/cm")
    return FileContent(values, spacing=head.spacing, unit="um", origin="the ISQ header")
