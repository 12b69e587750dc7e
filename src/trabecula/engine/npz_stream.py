"""Named arrays in a file (NumPy's .npz), written and read piece by piece: no array is held in
memory for it.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from trabecula.engine import memmap

_AT_ONCE = 1 << 24
"""Bytes that are copied at once."""

_SUFFIX = ".npy"


def write_npz(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays as members of a file that `numpy.load` reads as well.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=True) as file:
        for name, array in arrays.items():
            with file.open(name + _SUFFIX, "w", force_zip64=True) as member:
                header = {"descr": array.dtype.str, "fortran_order": False, "shape": array.shape}
                np.lib.format.write_array_header_1_0(member, header)
                for part in _parts(array):
                    member.write(np.ascontiguousarray(part).data if part.ndim else part.tobytes())
                    memmap.release_pages()


def read_npz(path: Path, prefix: str = "") -> dict[str, np.ndarray]:
    """Read the arrays of a file whose names begin with a prefix, by the rest of their names; large
    ones are memory-mapped where that is in use.

    Raises
    ------
    OSError, EOFError, ValueError, zipfile.BadZipFile
        It is damaged (every member is checked against its CRC-32), or none of `write_npz`.
    """
    found = {}
    with zipfile.ZipFile(path) as file:
        for name in file.namelist():
            if not name.startswith(prefix):
                continue
            with file.open(name) as member:
                np.lib.format.read_magic(member)
                shape, turned, dtype = np.lib.format.read_array_header_1_0(member)
                if turned:
                    raise ValueError(f"{name} is stored column by column")
                array = memmap.empty(shape, dtype)
                for part in _parts(array):
                    read = member.read(part.nbytes)
                    if len(read) != part.nbytes:
                        raise EOFError(f"{name} ends too early")
                    part[...] = np.frombuffer(read, dtype).reshape(part.shape)
                    memmap.release_pages()
                if member.read(1):  # and with it the check of the sum
                    raise ValueError(f"{name} does not end")
            found[name.removeprefix(prefix).removesuffix(_SUFFIX)] = array
    return found


def _parts(array: np.ndarray) -> list[np.ndarray]:
    """Cut an array into pieces along its first axis, or along the next where one entry of the first
    is a large array itself.
    """
    if array.size == 0:
        return []
    if array.ndim == 0 or array.nbytes <= _AT_ONCE:
        return [array]
    each = array.nbytes // len(array)
    if each > _AT_ONCE and array.ndim > 1:
        return [part for entry in array for part in _parts(entry)]
    step = max(1, _AT_ONCE // each)
    return [array[first : first + step] for first in range(0, len(array), step)]
