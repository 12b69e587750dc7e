"""Memory-mapped arrays: large arrays are stored in files of a scratch folder, and only the slabs in
use are resident.

A run that does not fit into its budget is wrapped in `map_large_arrays`. Code that needs large
arrays gets them from a `memory.Workspace` (or from `empty` and `zeros`) and works on them slab by
slab (`parallel.for_slabs`). It is the same code as in memory, so the voxels are the same. After
every slab `release_pages` gives its pages back; they stay in the system's cache as long as there is
room, and on disk beyond that.
"""

from __future__ import annotations

import errno
import io
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

SMALLEST = mmap.PAGESIZE
"""Arrays of fewer bytes stay in memory."""


@dataclass(frozen=True)
class MappedFile:
    """The part of a file that holds an array: `offset` bytes into it, with these `strides`."""

    path: Path
    dtype: str
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    offset: int = 0


WORTH_SENDING = 1 << 24
"""Bytes of all arrays from which on work is worth sending."""


class MappedWorkers(Protocol):
    """Processes that work on slabs of memory-mapped arrays."""

    at_once: int

    def spread(self, work: Callable[[int, int], object], bounds: Sequence[tuple[int, int]]) -> None:
        """Call `work` on slabs, in any order, and return when all are done; memory-mapped arrays
        are sent as file names.
        """


@dataclass
class _Scratch:
    folder: Path
    memory: int
    thickest: int | None
    workers: MappedWorkers | None
    files: WeakKeyDictionary[mmap.mmap, tuple[Path, Any]] = field(default_factory=WeakKeyDictionary)
    scattered: int = 0
    lock: Any = field(default_factory=Lock)

    def live(self) -> list[mmap.mmap]:
        with self.lock:
            return list(self.files)


_scratch: ContextVar[_Scratch | None] = ContextVar("trabecula_scratch", default=None)

_AROUND = 1 << 17
"""Bytes that become resident, at most, where a few voxels of a plane are touched."""

_PIECE = 1 << 16
"""Bytes of a file that are written, and cached, at once."""

_LEAST = 1 << 20
"""Bytes of memory-mapped arrays that are resident in any case."""


@contextmanager
def map_large_arrays(
    folder: Path, *, memory: int, thickest: int | None = None, workers: MappedWorkers | None = None
) -> Iterator[None]:
    """Store large arrays in files of `folder` while the block lasts; a file is removed with its
    array.

    Parameters
    ----------
    folder : Path
        Created where it does not exist.
    memory : int
        Bytes of the arrays that may be resident at once, about.
    thickest : int, optional
        Planes of a slab at most.
    workers : MappedWorkers, optional
        Processes for the slabs that any process may work on.
    """
    folder.mkdir(parents=True, exist_ok=True)
    token = _scratch.set(_Scratch(folder, memory, thickest, workers))
    try:
        yield
    finally:
        _scratch.reset(token)


def is_active() -> bool:
    """Return whether large arrays are memory-mapped."""
    return _scratch.get() is not None


def empty(shape: Sequence[int] | int, dtype: Any, *, least: int | None = None) -> np.ndarray:
    """Return an array of undefined values (those of a file are zeros); in memory below `least`
    bytes, or `SMALLEST`.
    """
    scratch = _scratch.get()
    shape = (shape,) if isinstance(shape, int) else tuple(int(side) for side in shape)
    size = np.dtype(dtype).itemsize * math.prod(shape)
    # What others write is not seen in an array in memory.
    fewest = SMALLEST if scratch is None or scratch.workers is None else 1
    if scratch is None or size < (fewest if least is None else least) or size == 0:
        return np.empty(shape, dtype)
    path = scratch.folder / f"{uuid4().hex}.raw"
    memory = _create_file(path, size)
    with scratch.lock:
        scratch.files[memory] = path, finalize(memory, _remove, path)
    return np.ndarray(shape, dtype, memory)


def _create_file(path: Path, size: int) -> mmap.mmap:
    """Map a new file of zeros; where the disk has no room for it nothing is left."""
    try:
        with path.open("xb+", buffering=0) as file:
            _allocate(path, file.fileno(), size)
            _write_zeros(file, size)
            return mmap.mmap(file.fileno(), size)
    except BaseException:
        _remove(path)
        raise


def _write_zeros(file: io.FileIO, size: int) -> None:
    """Write a new file, in pieces that the system caches as they are written.

    Untouched, a page is cached where a voxel is first written: ten times slower, and in pieces of
    up to a megabyte, all of which is resident once a voxel is touched.
    """
    some = memoryview(bytes(min(size, _PIECE)))
    for first in range(0, size, _PIECE):
        part = some[: size - first]
        if file.write(part) != len(part):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _allocate(path: Path, descriptor: int, size: int) -> None:
    """Allocate the blocks of a file: a full disk is an error here; where a page is first touched it
    would kill the process.
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
    """Return an array of zeros."""
    made = empty(shape, dtype)
    if _find_file(made) is None:
        made[...] = 0
    return made


def file_of(array: np.ndarray) -> MappedFile | None:
    """Return the file that holds an array, or the array that it is a view of; None for one in
    memory.
    """
    found = _find_file(array)
    if found is None:
        return None
    memory, path = found
    start = np.frombuffer(memory, np.uint8).__array_interface__["data"][0]
    offset = array.__array_interface__["data"][0] - start
    return MappedFile(path, array.dtype.str, array.shape, array.strides, offset)


def keep_file(array: np.ndarray) -> MappedFile:
    """Keep the file of an array that `empty` gave when the array goes.

    Raises
    ------
    ValueError
        One in memory, or a part of another.
    """
    scratch = _scratch.get()
    found, place = _find_file(array), file_of(array)
    if scratch is None or found is None or place is None or len(found[0]) != array.nbytes:
        raise ValueError("only a whole array in a scratch file can be kept")
    memory, _ = found
    memory.flush()
    scratch.files[memory][1].detach()
    return place


def open_file(place: MappedFile) -> np.ndarray:
    """Map the array in a file that this process does not remove."""
    with place.path.open("rb+") as file:
        memory = mmap.mmap(file.fileno(), 0)
    return np.ndarray(place.shape, place.dtype, memory, place.offset, place.strides)


def slab_thickness(length: int, threads: int) -> int:
    """Return the planes of a slab such that slabs of this share of all arrays, one a thread, are
    resident within the budget.
    """
    scratch = _scratch.get()
    if scratch is None:
        return length
    live = sum(map(len, scratch.live()))
    # A release of pages costs as much as many rows: no fewer bytes a slab than `_LEAST` has, and no
    # more than 64 slabs of lists far longer than a volume is deep.
    most = length if scratch.thickest is None else max(scratch.thickest, length // 64)
    memory = max(scratch.memory, _LEAST)
    return max(1, min(most, length * memory // max(1, live * threads)))


def run_on_workers(work: Callable[[int, int], object], length: int) -> bool:
    """Let workers work on slabs that cover `0..length`, where there are any; return whether they
    did.
    """
    scratch = _scratch.get()
    if scratch is None or scratch.workers is None or sum(map(len, scratch.live())) < WORTH_SENDING:
        return False
    thick = slab_thickness(length, scratch.workers.at_once)
    scratch.workers.spread(
        work, [(first, min(first + thick, length)) for first in range(0, length, thick)]
    )
    return True


def release_pages() -> None:
    """Release all pages; what was written stays in the files."""
    scratch = _scratch.get()
    if scratch is None or not hasattr(mmap, "MADV_DONTNEED"):
        return
    for memory in scratch.live():
        memory.madvise(mmap.MADV_DONTNEED)


def count_scattered(planes: int) -> None:
    """Count places that are touched in no order, by the planes in which they lie, and release all
    pages before they may be more than the budget.
    """
    scratch = _scratch.get()
    if scratch is None:
        return
    scratch.scattered += planes * _AROUND
    if scratch.scattered > max(scratch.memory, _LEAST):
        scratch.scattered = 0
        release_pages()


def _find_file(array: np.ndarray) -> tuple[mmap.mmap, Path] | None:
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
