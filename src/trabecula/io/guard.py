"""Checks of a file before it is read: is it there, can it hold what it claims, is it whole?"""

from __future__ import annotations

import binascii
import difflib
import lzma
import math
import os
import struct
import sys
import traceback
import warnings
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from trabecula.core.checks import quote
from trabecula.core.errors import FileError, InputError, MemoryBudgetError, TrabeculaError
from trabecula.engine.memory import available_memory, format_bytes
from trabecula.engine.storage import Remote

_OURS = __name__.partition(".")[0]

# What libraries and our own parsers raise on bytes that make no sense. SyntaxError is Pillow's and
# the XML parser's.
_DAMAGE: tuple[type[Exception], ...] = (
    OSError,
    ValueError,
    LookupError,
    ArithmeticError,
    EOFError,
    SyntaxError,
    RuntimeError,
    struct.error,
    zlib.error,
    lzma.LZMAError,
    binascii.Error,
)

# What a mistake in code raises. Libraries fail so on wrong headers as well, so the place where it
# was raised decides.
_DEFECT: tuple[type[Exception], ...] = (
    AttributeError,
    TypeError,
    AssertionError,
    NameError,
    ImportError,
    NotImplementedError,
)


@contextmanager
def report_damage(
    path: Path | Remote, form: str, *, also: tuple[type[Exception], ...] = (), checked: bool = True
) -> Iterator[None]:
    """Turn whatever a library raises while it reads `path` into one line.

    A mistake of our own code passes unchanged. Of an error that may be a library's mistake as well
    as the file's, the message names the library, its version and the error, and does not ask
    whether the file is whole.

    Parameters
    ----------
    path : Path
    form : str
        Name of the format, for the message.
    also : tuple of exception types
        The library's own, where they derive from nothing usual.
    checked : bool
        Our own code checks whatever it takes from the file before it uses it. Where it does not, an
        error of it may come from either, and the message says so.
    """
    try:
        with warnings.catch_warnings():
            # libraries warn of oddities that they then read, or fail on
            warnings.simplefilter("ignore")
            yield
    except TrabeculaError:
        raise
    except MemoryError as error:
        raise MemoryBudgetError(
            f"cannot read {path} as {form}: it does not fit into memory; read a smaller part"
        ) from error
    except _DEFECT as error:
        library, what = library_of(error), f"{type(error).__name__}: {_reason(error)}"
        if library is None and checked:
            raise
        if library is None:
            raise FileError(
                f"cannot read {path} as {form}: {what}: it was changed by other hands, or "
                "trabecula has a defect; make it "
                "again, and report this where that does not help"
            ) from error
        raise FileError(
            f"cannot read {path} as {form}: {library} fails on it ({what}); try another version of "
            f"{library.split()[0]}, "
            "or save the file again in another format"
        ) from error
    except _DAMAGE + also as error:
        raise FileError(f"cannot read {path} as {form}: {_reason(error)}: is it whole?") from error


def library_of(error: BaseException) -> str | None:
    """Return the library that raised an error, with its version; None where our own code did.

    The innermost frame decides. Frames of the standard library are passed over: it does what its
    caller asks.
    """
    packages = [
        str(frame.f_globals.get("__name__", "")).partition(".")[0]
        for frame, _ in traceback.walk_tb(error.__traceback__)
    ]
    package = next(
        (name for name in reversed(packages) if name not in sys.stdlib_module_names), _OURS
    )
    if package == _OURS:
        return None
    version = getattr(sys.modules.get(package), "__version__", None)
    return f"{package} {version}" if version else package


def _reason(error: Exception) -> str:
    """Return an error's text in one line."""
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    line = " ".join(text.split()).rstrip(".:") or type(error).__name__
    return line if len(line) <= 160 else f"{line[:157]}..."


def check_there(path: Path | Remote) -> None:
    """Raise where nothing is at `path` (naming what is near), an empty file, or at an address no
    store.
    """
    if isinstance(path, Remote):
        if not path.is_store():
            raise FileError(
                f"there is no Zarr store at {path}, and nothing else is read from an address: "
                "check the name"
            )
        return
    try:
        there = path.exists()
    except OSError as error:  # a name that no system takes
        raise FileError(f"cannot read {quote(str(path))}: {error.strerror}") from error
    if not there:
        if path.with_name(path.name + ".part").exists():
            raise FileError(
                f"{path} is not finished: trabecula generate --resume {path} resumes the run "
                "that makes it"
            )
        raise FileError(f"there is no file {path}{_near(path)}")
    for pipe in _pipes(path):
        raise FileError(
            f"cannot read {path}: {pipe} is a pipe or a device; copy what it gives into a file"
        )
    if path.is_file() and path.stat().st_size == 0:
        raise FileError(f"cannot read {path}: it is empty (0 bytes); write or copy it again")


def _pipes(path: Path) -> Iterator[Path]:
    """Yield what is neither a file nor a folder, at a path or below it: reading it never ends."""
    if not path.is_dir():
        if not path.is_file():
            yield path
        return
    with os.scandir(path) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                yield from _pipes(Path(entry.path))
                continue
            with suppress(OSError):  # a link that names itself
                if not entry.is_file() and not entry.is_dir() and Path(entry.path).exists():
                    yield Path(entry.path)


def _near(path: Path) -> str:
    """Return a hint at names near to one that is not there."""
    if not path.parent.is_dir():
        return f": there is no folder {path.parent} either"
    names = [entry.name for entry in path.parent.iterdir()]
    near = difflib.get_close_matches(path.name, names, n=3, cutoff=0.6)
    return f": did you mean {' or '.join(near)}?" if near else ": check the name"


NUMBERS = tuple(
    ["uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float32", "float64"]
)
"""Types of voxels that most formats can hold."""

DEFLATE = 1032
"""No deflate stream (zlib, gzip, PNG) unpacks to more than this times its length."""


def check_claim(
    path: Path | Remote, shape: Sequence[int], dtype: np.dtype, *, stored: int | None = None
) -> None:
    """Raise, before anything is allocated, where a header claims more than can be.

    Parameters
    ----------
    path : Path
    shape, dtype :
        What the header says (colour included in the shape).
    stored : int, optional
        Bytes that the file can hold for it at most; packed ones count as often as the packing can
        shrink them.

    Raises
    ------
    FileError
        The file is too short for what its header claims, or the shape is not positive.
    MemoryBudgetError
        More than the available memory.
    """
    sides = [int(side) for side in shape]
    if not sides or min(sides) < 1:
        raise FileError(
            f"cannot read {path}: its header claims the shape {tuple(sides)}: is it whole?"
        )
    need = math.prod(sides) * dtype.itemsize
    claim = f"its header claims {'x'.join(map(str, sides))} voxels of {dtype}, {format_bytes(need)}"
    if stored is not None and stored < need:
        raise FileError(
            f"cannot read {path}: {claim}, the file can hold {format_bytes(max(stored, 0))}: is it "
            "whole?"
        )
    if need > available_memory():
        raise MemoryBudgetError(
            f"cannot read {path}: {claim}, only {format_bytes(available_memory())} of memory are "
            "free: "
            "crop it or use a larger machine"
        )


def check_dtype(dtype: np.dtype, fit: Sequence[str], *, form: str) -> None:
    """Raise where a format cannot hold a type of voxel."""
    if dtype.name not in fit:
        raise InputError(
            f"{form} cannot hold {dtype} voxels, only {', '.join(fit)}: convert the values, or "
            "write .zarr or .npy"
        )
