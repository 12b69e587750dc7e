"""Files that appear whole or not at all, and arrays written and read piece by piece."""

from __future__ import annotations

import math
import shutil
import struct
import uuid
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from tokenize import TokenError

import numpy as np

from trabecula.core.errors import FileError
from trabecula.engine import memmap

_AT_ONCE = 1 << 24
"""Bytes of an array that are copied at once."""

_SUFFIX = ".npy"

UNREADABLE: tuple[type[Exception], ...] = (
    OSError,
    ValueError,
    TypeError,
    LookupError,
    ArithmeticError,
    EOFError,
    MemoryError,
    RuntimeError,
    SyntaxError,
    TokenError,
    struct.error,
    zlib.error,
    zipfile.BadZipFile,
)
"""Raised by a damaged file of arrays, or of the JSON in it."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`; on success it takes the place of `path`, on failure
    nothing is left.

    The temporary name keeps the suffix, since writers choose their format by it. Works for files
    and for folders.

    Raises
    ------
    FileError
        The folder cannot be written, the disk is full, or a folder is where a file should go.
    """
    path = Path(path)
    temporary = path.with_name(f".{uuid.uuid4().hex[:8]}-{path.name}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        put_in_place(temporary, path)
    except OSError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(
            f"cannot write {path}: {error.strerror or error}; check the folder, its rights and the "
            "space left"
        ) from error
    finally:
        remove(temporary)


def put_in_place(temporary: Path, path: Path) -> None:
    """Give a finished file or folder its name; what had that name before goes."""
    if path.is_dir() and not temporary.is_dir():
        raise FileError(f"cannot write {path}: a folder of that name is there; choose another name")
    if path.is_dir() and not path.is_symlink():
        # A folder cannot be replaced in one step: set the old one aside, so that a failure can put
        # it back.
        aside = path.with_name(f".{uuid.uuid4().hex[:8]}-{path.name}")
        path.rename(aside)
        try:
            temporary.rename(path)
        except OSError:
            aside.rename(path)
            raise
        remove(aside)
    else:
        temporary.replace(path)


def remove(path: Path) -> None:
    """Remove a file or a folder with all in it, as far as can be; what is not there is no error."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        # Where the folder never came to be there is nothing to remove, and the first error is the
        # one to tell.
        with suppress(OSError):
            path.unlink(missing_ok=True)


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
    One of `UNREADABLE`
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
                info = file.getinfo(name)
                if info.compress_size < math.prod(shape) * dtype.itemsize:
                    raise ValueError(f"{name} claims more than it holds")
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
