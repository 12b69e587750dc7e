"""Arrays too large for memory: they lie in files of a scratch folder, and only what is worked on is
resident.

A run that does not fit into its budget is wrapped in `spilled`. What makes large arrays asks
`empty` or `zeros` for them, works on them slab by slab (`tiles.for_slabs`), and is the same code as
in memory: so are the voxels. After every slab `release_pages` hands its pages back; they stay in
the system's cache as long as there is room, and on disk beyond that.
"""

from __future__ import annotations

import errno
import math
import mmap
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Any, Protocol
from uuid import uuid4
from weakref import WeakKeyDictionary, finalize

import numpy as np

LEAST = mmap.PAGESIZE
"""Arrays of fewer bytes stay in memory."""


@dataclass(frozen=True)
class MappedFile:
    """Where an array lies: `offset` bytes into a file, with these `strides`."""

    path: Path
    dtype: str
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    offset: int = 0


WORTH = 1 << 24
"""Bytes of all arrays from which on work is worth sending."""


class MappedWorkers(Protocol):
    """Other processes that work on slabs."""

    at_once: int

    def spread(self, work: Callable[[int, int], object], bounds: Sequence[tuple[int, int]]) -> None:
        """Call `work` on slabs, in any order, and return when all are done; arrays of scratch files
        go by their places.
        """


@dataclass
class _Scratch:
    folder: Path
    memory: int
    thickest: int | None
    hands: MappedWorkers | None
    files: WeakKeyDictionary[mmap.mmap, tuple[Path, Any]] = field(default_factory=WeakKeyDictionary)
    lock: Any = field(default_factory=Lock)

    def live(self) -> list[mmap.mmap]:
        with self.lock:
            return list(self.files)


_scratch: ContextVar[_Scratch | None] = ContextVar("trabecula_scratch", default=None)


@contextmanager
def spilled(
    folder: Path, *, memory: int, thickest: int | None = None, hands: MappedWorkers | None = None
) -> Iterator[None]:
    """Let large arrays lie in files of `folder` while the block lasts; they go with the arrays.

    Parameters
    ----------
    folder : Path
        Made where it is not there.
    memory : int
        Bytes of them that may be resident at once, about.
    thickest : int, optional
        Planes of a slab at most.
    hands : Hands, optional
        Who works on slabs that may be worked on anywhere.
    """
    folder.mkdir(parents=True, exist_ok=True)
    token = _scratch.set(_Scratch(folder, memory, thickest, hands))
    try:
        yield
    finally:
        _scratch.reset(token)


def is_active() -> bool:
    """Whether large arrays lie in files."""
    return _scratch.get() is not None


def empty(shape: Sequence[int] | int, dtype: Any, *, least: int | None = None) -> np.ndarray:
    """An array whose values do not matter yet (those of a file are zeros); in memory below `least`
    bytes, or `LEAST`.
    """
    scratch = _scratch.get()
    shape = (shape,) if isinstance(shape, int) else tuple(int(side) for side in shape)
    size = np.dtype(dtype).itemsize * math.prod(shape)
    # What others write is not seen in an array in memory.
    fewest = LEAST if scratch is None or scratch.hands is None else 1
    if scratch is None or size < (fewest if least is None else least) or size == 0:
        return np.empty(shape, dtype)
    path = scratch.folder / f"{uuid4().hex}.raw"
    memory = _mapped(path, size)
    with scratch.lock:
        scratch.files[memory] = path, finalize(memory, _remove, path)
    return np.ndarray(shape, dtype, memory)


def _mapped(path: Path, size: int) -> mmap.mmap:
    """A new file of zeros in memory; nothing is left of one for which there is no room."""
    try:
        with path.open("xb+") as file:
            _allocate(path, file.fileno(), size)
            return mmap.mmap(file.fileno(), size)
    except BaseException:
        _remove(path)
        raise


def _allocate(path: Path, descriptor: int, size: int) -> None:
    """Blocks that the disk does not have are an error here; where they are first touched the
    process would be killed.
    """
    try:
        os.posix_fallocate(descriptor, 0, size)
    except (AttributeError, OSError) as error:  # not on macOS and Windows, nor on every file system
        if isinstance(error, OSError) and error.errno not in (errno.EOPNOTSUPP, errno.EINVAL):
            raise
        if shutil.disk_usage(path.parent).free < size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from None
        os.ftruncate(descriptor, size)


def zeros(shape: Sequence[int] | int, dtype: Any) -> np.ndarray:
    """An array of zeros."""
    made = empty(shape, dtype)
    if _file_of(made) is None:
        made[...] = 0
    return made


def place_of(array: np.ndarray) -> MappedFile | None:
    """Where an array, or the one that it is a view of, lies; None for one in memory."""
    found = _file_of(array)
    if found is None:
        return None
    memory, path = found
    start = np.frombuffer(memory, np.uint8).__array_interface__["data"][0]
    offset = array.__array_interface__["data"][0] - start
    return MappedFile(path, array.dtype.str, array.shape, array.strides, offset)


def keep_file(array: np.ndarray) -> MappedFile:
    """Let the file of an array that `empty` gave stay when the array goes.

    Raises
    ------
    ValueError
        One in memory, or a part of another.
    """
    scratch, found, place = _scratch.get(), _file_of(array), place_of(array)
    if scratch is None or found is None or place is None or len(found[0]) != array.nbytes:
        raise ValueError("only a whole array that lies in a scratch file can be kept")
    memory, _ = found
    memory.flush()
    scratch.files[memory][1].detach()
    return place


def open_file(place: MappedFile) -> np.ndarray:
    """The array at a place, of which this process does not remove the file."""
    with place.path.open("rb+") as file:
        memory = mmap.mmap(file.fileno(), 0)
    return np.ndarray(place.shape, place.dtype, memory, place.offset, place.strides)


def thickness(length: int, threads: int) -> int:
    """Planes of a slab such that slabs of this share of all arrays, one a thread, are resident
    within the budget.
    """
    scratch = _scratch.get()
    if scratch is None:
        return length
    live = sum(map(len, scratch.live()))
    most = length if scratch.thickest is None else scratch.thickest
    return max(1, min(most, length * scratch.memory // max(1, live * threads)))


def run_on_workers(work: Callable[[int, int], object], length: int) -> bool:
    """Let others work on slabs that cover `0..length`, where there are any; whether they did."""
    scratch = _scratch.get()
    if scratch is None or scratch.hands is None or sum(map(len, scratch.live())) < WORTH:
        return False
    thick = thickness(length, scratch.hands.at_once)
    scratch.hands.spread(
        work, [(first, min(first + thick, length)) for first in range(0, length, thick)]
    )
    return True


def release_pages() -> None:
    """Hand all pages back; what was written stays in the files."""
    scratch = _scratch.get()
    if scratch is None or not hasattr(mmap, "MADV_DONTNEED"):
        return
    for memory in scratch.live():
        memory.madvise(mmap.MADV_DONTNEED)


def _file_of(array: np.ndarray) -> tuple[mmap.mmap, Path] | None:
    scratch, base = _scratch.get(), array.base
    while isinstance(base, np.ndarray):
        base = base.base
    if scratch is None or not isinstance(base, mmap.mmap):
        return None
    found = scratch.files.get(base)
    return None if found is None else (base, found[0])


def _remove(path: Path) -> None:
    with suppress(OSError):
        path.unlink(missing_ok=True)
