"""Volumes generated block by block into a store. A finished block is never generated again.

The store grows under the name `part` (at an address under its own name: see engine.storage), as
whole files that each appear at once. A killed run leaves it, and the same run resumes from it. The
cubes of a coarser level follow as soon as the blocks below them are there, and are read from those.
After the last one the store gets its recipe and its own name.

The caller's `make` returns the same voxels of a box whichever other boxes were made before. Then
neither the cut of the volume nor the process that makes a block matters: no file belongs to two
blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from trabecula.core.errors import FileError, TrabeculaError
from trabecula.core.progress import notify, track
from trabecula.core.recipe import digest_of
from trabecula.engine import store
from trabecula.engine.chunking import Box, Task, below, boxes_of, slices_of, sources_of, tasks_of
from trabecula.engine.lock import hold_lock
from trabecula.engine.multiscale import halve_resolution
from trabecula.engine.storage import AnyPath, Folder, Location, location_of

__all__ = [
    "BlockWorkers",
    "Box",
    "StoredVolume",
    "boxes_of",
    "digest_bytes",
    "do_task",
    "part_bytes",
    "slices_of",
    "stream",
]

_AT_ONCE = 256 << 20
"""Bytes of the finished volume that are read at once for its digest."""

_SLAB = 64  # planes of the level below that are read at once


@dataclass(frozen=True)
class StoredVolume:
    """A volume to generate, and how the store describes it.

    Attributes
    ----------
    shape, dtype : of the voxels, (Z, Y, X)
    make : Box -> array of its voxels, channels last where there are any
    describe : SHA-256 of all voxels -> plain JSON kept in the store, of an unfinished one with an
    empty digest
    identity : str
        SHA-256 of everything that the voxels depend on: a run resumes from its own blocks alone.
    scale, unit : as for `store.save`
    labels : bool
        True where the values are names, of which coarser levels hold the commonest; else the mean.
    channels : int
        Numbers of a voxel; 0 where it is one number, without an axis for them.
    resume_hint : str, optional
        What resumes an interrupted run, for messages. Default: generate --resume.
    """

    shape: tuple[int, ...]
    dtype: np.dtype
    make: Callable[[Box], np.ndarray]
    describe: Callable[[str], Mapping[str, Any]]
    identity: str
    scale: Sequence[float]
    unit: str | None
    labels: bool = True
    channels: int = 0
    resume_hint: str | None = None


class BlockWorkers(Protocol):
    """Processes that make blocks, where it is not this process alone."""

    def make(
        self,
        volume: StoredVolume,
        part: Location,
        tasks: Sequence[Task],
        sources: Sequence[Sequence[int]],
    ) -> Iterable[object]:
        """Run the tasks (see `do_task`), each after those at the places in the list that are its
        sources; yield once after each.
        """


def stream(
    volume: StoredVolume,
    path: AnyPath,
    *,
    part: AnyPath | None = None,
    side: int,
    chunk: int | None = None,
    workers: BlockWorkers | None = None,
) -> str:
    """Make a volume into a Zarr store, block by block.

    Parameters
    ----------
    volume : StoredVolume
    path : path or address
        The finished store; one that is there in a folder is replaced at the end.
    part : path, optional
        The unfinished store. Default: beside it, or at an address itself.
    side : int
        Edge of a block, a multiple of `chunk`, so that no file belongs to two.
    chunk : int, optional
        Edge of the cubes that are a file each. Default: `store.CHUNK`.
    workers : BlockWorkers, optional
        Processes that make the blocks. Default: this process, one after the other.

    Returns
    -------
    str
        SHA-256 of type, shape and voxels.

    Raises
    ------
    FileError
        Something else is at `part` or `path`, another run's blocks among it, or the disk is full:
        what is finished stays. Another process writes it.
    """
    chunk = store.CHUNK if chunk is None else chunk
    if side % chunk:
        raise ValueError(f"blocks of {side} voxels would share chunks of {chunk}")
    place = location_of(path)
    grown = place.growing() if part is None else location_of(part)
    if isinstance(place, Folder):
        place.check_replaceable()
    with hold_lock(grown.path) if isinstance(grown, Folder) else nullcontext():
        return _write_blocks(volume, place, grown, chunk, side, workers)


def _write_blocks(
    volume: StoredVolume,
    place: Location,
    grown: Location,
    chunk: int,
    side: int,
    workers: BlockWorkers | None,
) -> str:
    resume_hint = volume.resume_hint or f"generate --resume {place.name}"
    try:
        if isinstance(grown, Folder):
            grown.path.parent.mkdir(parents=True, exist_ok=True)
        opened = _open_part(volume, grown, place, chunk, side)
        tasks = _missing_tasks(opened, side)
        for _ in track(
            _run_tasks(volume, opened, tasks, side, workers), "blocks", total=len(tasks)
        ):
            pass
        for level, shape in enumerate(opened.shapes):
            _check_files(opened, level, tuple((0, length) for length in shape))
        whole = (*volume.shape, volume.channels) if volume.channels else volume.shape
        sha256 = digest_of(volume.dtype, whole, _slabs(opened))
        opened.finish(volume.describe(sha256))
        place.settle(grown)
    except KeyboardInterrupt:
        notify(f"interrupted: the same run resumes from {grown.name} ({resume_hint})")
        raise
    except OSError as error:
        if isinstance(error, TrabeculaError):
            raise
        raise FileError(
            f"cannot write {place}: {error.strerror or error}; the blocks that are finished stay "
            f"in {grown.name}, and the same run resumes from it ({resume_hint})"
        ) from error
    return sha256


def _open_part(
    volume: StoredVolume, part: Location, place: Location, chunk: int, side: int
) -> store.Unfinished:
    """Open the unfinished store that the same run left, or create one."""
    found = _find_part(volume, part, chunk)
    if found is None:
        number = len(boxes_of(volume.shape, side))
        notify(f"making {place.name} in {number} block{'s' if number > 1 else ''} of {side} voxels")
        return store.create_unfinished(
            part,
            (volume.channels, *volume.shape) if volume.channels else volume.shape,
            volume.dtype,
            scale=volume.scale,
            unit=volume.unit,
            fields=volume.describe(""),
            identity=volume.identity,
            name=place.stem,
            chunk=chunk,
            block=side,
        )
    notify(f"resuming from {part.name}")
    part.sweep()
    return found


def _find_part(volume: StoredVolume, part: Location, chunk: int) -> store.Unfinished | None:
    if not part.is_there():
        return None
    found = store.open_unfinished(part)
    if found is None:
        raise FileError(
            f"cannot write {part}: something else of that name is there; remove it, or choose "
            "another --out"
        )
    shape, dtype = found.shapes[0], found.arrays[0].dtype
    if (found.identity, shape, dtype, found.channels) != (
        volume.identity,
        volume.shape,
        volume.dtype,
        volume.channels,
    ):
        sides = "x".join(map(str, shape))
        if found.complete:
            raise FileError(
                f"cannot write {part}: another volume, of {sides} voxels, is there; remove it, or "
                "choose another --out"
            )
        raise FileError(
            f"{part} holds the blocks of another run, of {sides} voxels: go on with that one "
            "(generate --resume), remove it, or choose another --out"
        )
    if found.chunk != chunk:
        raise FileError(
            f"{part} was begun in chunks of {found.chunk} voxels, not of {chunk}: give --chunks "
            f"{found.chunk}"
        )
    return found


def _run_tasks(
    volume: StoredVolume,
    opened: store.Unfinished,
    tasks: Sequence[Task],
    side: int,
    workers: BlockWorkers | None,
) -> Iterable[object]:
    if workers is not None:
        sources = sources_of(tasks, opened.shapes, side=side, chunk=opened.chunk)
        return workers.make(volume, opened.place, tasks, sources)
    return _run_here(volume, opened, tasks)


def _run_here(
    volume: StoredVolume, opened: store.Unfinished, tasks: Sequence[Task]
) -> Iterator[None]:
    for task in tasks:
        do_task(task, opened, volume.make, labels=volume.labels)
        yield


def do_task(
    task: Task, opened: store.Unfinished, make: Callable[[Box], np.ndarray], *, labels: bool
) -> None:
    """Make a box of a level of an unfinished store and write it there, from `make` or from the
    level below.
    """
    if task.level:
        values = _coarser(opened, task, labels)
    else:
        values = make(task.box)
        values = np.moveaxis(values, -1, 0) if opened.channels else values
    opened.write(task.level, task.box, values)


def _coarser(opened: store.Unfinished, task: Task, labels: bool) -> np.ndarray:
    """Return a box of a level, averaged from the level below, some planes at a time."""
    level = task.level - 1
    region = below(task.box, opened.shapes[level])
    _check_files(opened, level, region)
    (first, last), *across = region
    slabs = [(start, min(start + _SLAB, last)) for start in range(first, last, _SLAB)]
    parts = [
        halve_resolution(opened.read(level, (slab, *across)), labels=labels, axes=len(region))
        for slab in slabs
    ]
    return np.concatenate(parts, axis=-len(region))


def _check_files(opened: store.Unfinished, level: int, box: Box) -> None:
    """Raise where a file of a box is missing; zarr would give zeros for it."""
    missing = opened.missing(level, box)
    if missing:
        raise FileError(
            f"{len(missing)} files of {opened.place} were written and are not there, {missing[0]} "
            "among them: did another program remove them, or has a shared file system not shown "
            "them yet? The same run resumes from it"
        )


def _missing_tasks(opened: store.Unfinished, side: int) -> list[Task]:
    """Return the tasks of which a file is missing or cannot be read."""
    tasks = tasks_of(opened.shapes, side=side, chunk=opened.chunk)
    there = opened.place.files()
    return [task for task in tasks if not _is_there(opened, task, there)]


def _is_there(opened: store.Unfinished, task: Task, there: set[str]) -> bool:
    files = opened.files(task.level, task.box)
    if not there.issuperset(files):
        return False
    if opened.place.whole:
        return True
    # whatever a codec raises on a file that the disk spoiled: it is made again
    with suppress(Exception):
        opened.read(task.level, task.box)
        return True
    # At an end of the volume zarr would read them before it writes the part that holds voxels.
    opened.place.remove(files)
    return False


def digest_bytes(shape: Sequence[int], dtype: np.dtype) -> int:
    """Return the memory of the planes that are read at once for the digest of a finished volume."""
    return (
        _depth(shape, dtype, store.CHUNK) * dtype.itemsize * int(np.prod(shape[1:], dtype=np.int64))
    )


def part_bytes(shape: Sequence[int], block: Sequence[int], dtype: np.dtype) -> int:
    """Return the memory that a block takes beside its generation: its voxels, packed and coarser
    copies, and planes for the digest.
    """
    own = dtype.itemsize * int(np.prod(block, dtype=np.int64))
    coarser = 8 * min(own, dtype.itemsize * store.CHUNK ** len(block))
    return max(4 * own, coarser, 2 * digest_bytes(shape, dtype))


def _depth(shape: Sequence[int], dtype: np.dtype, chunk: int) -> int:
    """Return the number of planes that are read at once: those of a row of files, or a part of them
    that fits.
    """
    plane = max(1, dtype.itemsize * int(np.prod(shape[1:], dtype=np.int64)))
    depth = max(1, min(chunk, store.CHUNK, shape[0], _AT_ONCE // plane))
    while chunk % depth and depth < shape[0]:  # so that no slab reaches into a second row of files
        depth -= 1
    return depth


def _slabs(opened: store.Unfinished) -> Iterator[np.ndarray]:
    """Yield all voxels, some planes at a time."""
    shape, dtype = opened.shapes[0], opened.arrays[0].dtype
    length, *across = shape
    depth = _depth(shape, dtype, opened.chunk)
    for first in track(range(0, length, depth), "digest"):
        part = opened.read(
            0, ((first, min(first + depth, length)), *((0, side) for side in across))
        )
        yield np.moveaxis(part, 0, -1) if opened.channels else part
