"""Volumes made block by block into a store: a finished block is never made again, and an unfinished store says what it is.

The store grows under the name `part`, as whole files that are each put in place at once; a run that was killed leaves
it, and the same run goes on from it. A coarser level's cubes follow as soon as the blocks below them are there, and are read
from those. When the last is there the store gets its recipe and its own name.

The caller's `make` has to give the same voxels of a box whichever other boxes were made before it. Then how the volume is
cut does not matter, nor who makes which part of it: no file belongs to two blocks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from glob import escape
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from trabecula.core.errors import FileError, TrabeculaError
from trabecula.core.progress import say, track
from trabecula.core.recipe import digest_of
from trabecula.engine import store
from trabecula.engine.cuts import Box, Task, below, boxes_of, slices_of, sources_of, tasks_of
from trabecula.engine.files import put_in_place, remove
from trabecula.engine.levels import halved

__all__ = ["Box", "Hands", "Volume", "boxes_of", "digest_bytes", "do", "part_bytes", "slices_of", "stream"]

_AT_ONCE = 256 << 20
"""Bytes of the finished volume that are read at once for its digest."""

_SLAB = 64  # planes of the level below that are read at once


@dataclass(frozen=True)
class Volume:
    """What is to be made, and how it is described.

    Attributes
    ----------
    shape, dtype : of the voxels, (Z, Y, X)
    make : Box -> array of its voxels
    describe : SHA-256 of all voxels -> plain JSON kept in the store, of an unfinished one with an empty digest
    identity : str
        Of all that the voxels depend on: only a part of the same volume is gone on from.
    scale, unit : as for `store.save`
    labels : bool
        Whether the values are names, of which coarser levels hold the commonest, or have a mean.
    """

    shape: tuple[int, ...]
    dtype: np.dtype
    make: Callable[[Box], np.ndarray]
    describe: Callable[[str], Mapping[str, Any]]
    identity: str
    scale: Sequence[float]
    unit: str | None
    labels: bool = True


class Hands(Protocol):
    """Who makes the blocks, where it is not this process alone."""

    def make(
        self, volume: Volume, part: Path, tasks: Sequence[Task], sources: Sequence[Sequence[int]]
    ) -> Iterable[object]:
        """Do the tasks (see `do`), each after those whose places in the list are its sources; yield once after each."""


def stream(
    volume: Volume, path: Path, *, part: Path, side: int, chunk: int | None = None, hands: Hands | None = None
) -> str:
    """Make a volume into a Zarr store, block by block.

    Parameters
    ----------
    volume : Volume
    path : Path
        The finished store; one that is there is replaced at the end.
    part : Path
        The unfinished store.
    side : int
        Edge of a block, a multiple of `chunk`, so that no file belongs to two.
    chunk : int, optional
        Edge of the cubes that are a file each. Default: `store.CHUNK`.
    hands : Hands, optional
        Who makes the blocks. Default: this process, one after the other.

    Returns
    -------
    str
        SHA-256 of type, shape and voxels.

    Raises
    ------
    FileError
        Something else lies at `part` or `path`, another run's blocks among it, or the disk is full: what is finished stays.
    """
    chunk = store.CHUNK if chunk is None else chunk
    if side % chunk:
        raise ValueError(f"blocks of {side} voxels would share chunks of {chunk}")
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        opened = _begun(volume, part, path, chunk, side)
        tasks = _to_do(opened, side)
        for _ in track(_done(volume, opened, tasks, side, hands), "blocks", total=len(tasks)):
            pass
        for level, array in enumerate(opened.arrays):
            _check_files(opened, level, tuple((0, length) for length in array.shape))
        sha256 = digest_of(volume.dtype, volume.shape, _slabs(opened.arrays[0], chunk))
        opened.finish(volume.describe(sha256))
        put_in_place(part, path)
    except KeyboardInterrupt:
        say(f"interrupted: the same run goes on from {part.name} (generate --resume {path.name})")
        raise
    except OSError as error:
        if isinstance(error, TrabeculaError):
            raise
        raise FileError(
            f"cannot write {path}: {error.strerror or error}; the blocks that are finished stay in {part.name}, and the same "
            f"run goes on from it (generate --resume {path.name})"
        ) from error
    _tidy(path, part)
    return sha256


def _begun(volume: Volume, part: Path, path: Path, chunk: int, side: int) -> store.Unfinished:
    """The unfinished store: what the same run left, or a new one."""
    left = _left(volume, part, chunk)
    if left is None:
        number = len(boxes_of(volume.shape, side))
        say(f"making {path.name} in {number} block{'s' if number > 1 else ''} of {side} voxels")
        return store.create_unfinished(
            part,
            volume.shape,
            volume.dtype,
            scale=volume.scale,
            unit=volume.unit,
            fields=volume.describe(""),
            identity=volume.identity,
            name=path.stem,
            chunk=chunk,
            block=side,
        )
    say(f"going on from {part.name}")
    for partial in part.rglob("*.partial"):  # chunks that a killed run was writing
        partial.unlink(missing_ok=True)
    return left


def _left(volume: Volume, part: Path, chunk: int) -> store.Unfinished | None:
    if not part.exists():
        return None
    left = store.open_unfinished(part)
    if left is None:
        raise FileError(
            f"cannot write {part}: something else of that name is there; remove it, or choose another --out"
        )
    finest = left.arrays[0]
    if (left.identity, finest.shape, finest.dtype) != (volume.identity, volume.shape, volume.dtype):
        raise FileError(
            f"{part} holds the blocks of another run, of {'x'.join(map(str, finest.shape))} voxels: go on with that one "
            "(generate --resume), remove it, or choose another --out"
        )
    if left.chunk != chunk:
        raise FileError(
            f"{part} was begun in chunks of {left.chunk} voxels, not of {chunk}: give --chunks {left.chunk}"
        )
    return left


def _done(
    volume: Volume, opened: store.Unfinished, tasks: Sequence[Task], side: int, hands: Hands | None
) -> Iterable[object]:
    if hands is not None:
        shapes = [array.shape for array in opened.arrays]
        sources = sources_of(tasks, shapes, side=side, chunk=opened.chunk)
        return hands.make(volume, opened.path, tasks, sources)
    return _alone(volume, opened, tasks)


def _alone(volume: Volume, opened: store.Unfinished, tasks: Sequence[Task]) -> Iterator[None]:
    for task in tasks:
        do(task, opened, volume.make, labels=volume.labels)
        yield


def do(task: Task, opened: store.Unfinished, make: Callable[[Box], np.ndarray], *, labels: bool) -> None:
    """Make a box of a level of an unfinished store and write it there, from `make` or from the level below."""
    values = _coarser(opened, task, labels) if task.level else make(task.box)
    opened.arrays[task.level][slices_of(task.box)] = values


def _coarser(opened: store.Unfinished, task: Task, labels: bool) -> np.ndarray:
    """A box of a level from the one below, some planes at a time."""
    source = opened.arrays[task.level - 1]
    region = below(task.box, source.shape)
    _check_files(opened, task.level - 1, region)
    (first, last), *rest = region
    across = slices_of(tuple(rest))
    slabs = [(start, min(start + _SLAB, last)) for start in range(first, last, _SLAB)]
    return np.concatenate([halved(np.asarray(source[slice(*slab), *across]), labels=labels) for slab in slabs])


def _check_files(opened: store.Unfinished, level: int, box: Box) -> None:
    """Raise where a file of a box is missing; zarr would give zeros for it."""
    missing = [file for file in opened.files(level, box) if not file.exists()]
    if missing:
        raise FileError(
            f"{len(missing)} files of {opened.path} were written and are not there, {missing[0]} among them: did another "
            "program remove them, or has a shared file system not shown them yet? The same run goes on from it"
        )


def _to_do(opened: store.Unfinished, side: int) -> list[Task]:
    """The tasks of which a file is missing or cannot be read."""
    tasks = tasks_of([array.shape for array in opened.arrays], side=side, chunk=opened.chunk)
    if not any(opened.path.glob("*/c/**/*")):
        return tasks
    return [task for task in tasks if not _is_there(opened, task)]


def _is_there(opened: store.Unfinished, task: Task) -> bool:
    files = opened.files(task.level, task.box)
    if not all(file.exists() for file in files):
        return False
    with suppress(Exception):  # whatever a codec raises on a file that the disk spoiled: it is made again
        _ = opened.arrays[task.level][slices_of(task.box)]
        return True
    for file in files:  # which at an end of the volume zarr would read before it writes the part that holds voxels
        file.unlink(missing_ok=True)
    return False


def _tidy(path: Path, part: Path) -> None:
    """Remove what runs that were killed in the middle of giving a folder its name left under another."""
    for name in (path.name, part.name):
        for left in path.parent.glob(f".{'[0-9a-f]' * 8}-{escape(name)}"):
            remove(left)


def digest_bytes(shape: Sequence[int], dtype: np.dtype) -> int:
    """Memory of the planes that are read at once for the digest of a finished volume."""
    return _depth(shape, dtype, store.CHUNK) * dtype.itemsize * int(np.prod(shape[1:], dtype=np.int64))


def part_bytes(shape: Sequence[int], block: Sequence[int], dtype: np.dtype) -> int:
    """Memory that a block takes beside what its making does: as made and as packed, coarser, and planes for the digest."""
    own = dtype.itemsize * int(np.prod(block, dtype=np.int64))
    coarser = 8 * min(own, dtype.itemsize * store.CHUNK ** len(block))
    return max(4 * own, coarser, 2 * digest_bytes(shape, dtype))


def _depth(shape: Sequence[int], dtype: np.dtype, chunk: int) -> int:
    """Planes that are read at once: those of a row of files, or a part of them that fits."""
    plane = max(1, dtype.itemsize * int(np.prod(shape[1:], dtype=np.int64)))
    depth = max(1, min(chunk, store.CHUNK, shape[0], _AT_ONCE // plane))
    while chunk % depth and depth < shape[0]:  # so that no slab reaches into a second row of files
        depth -= 1
    return depth


def _slabs(array: Any, chunk: int) -> Iterator[np.ndarray]:
    """All voxels, some planes at a time."""
    depth = _depth(array.shape, array.dtype, chunk)
    for first in track(range(0, array.shape[0], depth), "digest"):
        yield np.asarray(array[first : first + depth])
