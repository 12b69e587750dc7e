"""Volumes made block by block into a store: a finished block is never made again, and an unfinished store says what it is.

The store grows under the name `part`, as whole chunks that are each put in place at once; a run that was killed leaves
it, and the same run goes on from it. When the last block is there the store gets its recipe and its own name.

The caller's `make` has to give the same voxels of a box whichever other boxes were made before it. Then how the volume is
cut does not matter.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.errors import FileError
from trabecula.core.progress import say, track
from trabecula.core.recipe import digest_of
from trabecula.engine import store
from trabecula.engine.files import put_in_place

Box = tuple[tuple[int, int], ...]
"""First voxel and the one after the last, along every axis."""

_AT_ONCE = 256 << 20
"""Bytes of the finished volume that are read at once for its digest."""


@dataclass(frozen=True)
class Volume:
    """What is to be made, and how it is described.

    Attributes
    ----------
    shape, dtype : of the voxels, (Z, Y, X)
    make : Box -> array of its voxels
    describe : SHA-256 of all voxels -> plain JSON kept in the store
    identity : str
        Of all that the voxels depend on: only a part of the same volume is gone on from.
    scale, unit : as for `store.save`
    """

    shape: tuple[int, ...]
    dtype: np.dtype
    make: Callable[[Box], np.ndarray]
    describe: Callable[[str], Mapping[str, Any]]
    identity: str
    scale: Sequence[float]
    unit: str | None


def boxes_of(shape: Sequence[int], side: int) -> list[Box]:
    """Blocks of `side` voxels that cover a shape, the last of an axis what is left.

    Examples
    --------
    >>> boxes_of((2, 5), 3)
    [((0, 2), (0, 3)), ((0, 2), (3, 5))]
    """
    cuts = [[(first, min(first + side, end)) for first in range(0, end, side)] for end in shape]
    return list(product(*cuts))


def slices_of(box: Box) -> tuple[slice, ...]:
    """The slices that cut a box out of an array."""
    return tuple(slice(first, last) for first, last in box)


def stream(volume: Volume, path: Path, *, part: Path, side: int) -> str:
    """Make a volume into a Zarr store, block by block.

    Parameters
    ----------
    volume : Volume
    path : Path
        The finished store; one that is there is replaced at the end.
    part : Path
        The unfinished store.
    side : int
        Edge of a block, a multiple of `store.CHUNK`, so that no chunk belongs to two.

    Returns
    -------
    str
        SHA-256 of type, shape and voxels.

    Raises
    ------
    FileError
        Something else lies at `part` or `path`, or the disk is full: what is finished stays.
    """
    if side % store.CHUNK:
        raise ValueError(f"blocks of {side} voxels would share chunks of {store.CHUNK}")
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        opened = _begun(volume, part, path.stem)
        for box in track(_to_do(volume, opened, side), "blocks"):
            opened.array[slices_of(box)] = volume.make(box)
        sha256 = digest_of(volume.dtype, volume.shape, _slabs(opened.array))
        opened.finish(volume.describe(sha256))
        put_in_place(part, path)
    except KeyboardInterrupt:
        say(f"interrupted: the same run goes on from {part.name}")
        raise
    except OSError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(
            f"cannot write {path}: {error.strerror or error}; the blocks that are finished stay in {part.name}, and the same "
            "run goes on from it"
        ) from error
    return sha256


def _begun(volume: Volume, part: Path, name: str) -> store.Unfinished:
    """The unfinished store: what the same run left, or a new one."""
    if part.exists():
        left = store.open_unfinished(part)
        if left is None:
            raise FileError(
                f"cannot write {part}: something else of that name is there; remove it, or choose another --out"
            )
        if left.identity == volume.identity and left.array.shape == volume.shape and left.array.dtype == volume.dtype:
            say(f"going on from {part.name}")
            for partial in part.rglob("*.partial"):  # chunks that a killed run was writing
                partial.unlink(missing_ok=True)
            return left
        say(f"{part.name} was left by another run: starting from the beginning")
        shutil.rmtree(part)
    return store.create_unfinished(
        part, volume.shape, volume.dtype, scale=volume.scale, unit=volume.unit, identity=volume.identity, name=name
    )


def _to_do(volume: Volume, opened: store.Unfinished, side: int) -> list[Box]:
    """The blocks of which a chunk is missing or cannot be read."""
    return [box for box in boxes_of(volume.shape, side) if not _is_there(opened, box)]


def _is_there(opened: store.Unfinished, box: Box) -> bool:
    if not all(opened.chunk(first).exists() for first in product(*(range(a, b, store.CHUNK) for a, b in box))):
        return False
    with suppress(Exception):  # whatever a codec raises on a chunk that the disk spoiled: it is made again
        _ = opened.array[slices_of(box)]
        return True
    return False


def digest_bytes(shape: Sequence[int], dtype: np.dtype) -> int:
    """Memory of the planes that are read at once for the digest of a finished volume."""
    return _depth(shape, dtype) * dtype.itemsize * int(np.prod(shape[1:], dtype=np.int64))


def _depth(shape: Sequence[int], dtype: np.dtype) -> int:
    """Planes that are read at once: those of a row of chunks, or a part of them that fits."""
    plane = max(1, dtype.itemsize * int(np.prod(shape[1:], dtype=np.int64)))
    depth = max(1, min(store.CHUNK, shape[0], _AT_ONCE // plane))
    while store.CHUNK % depth and depth < shape[0]:  # so that no slab reaches into a second row of chunks
        depth -= 1
    return depth


def _slabs(array: Any) -> Iterator[np.ndarray]:
    """All voxels, some planes at a time."""
    depth = _depth(array.shape, array.dtype)
    for first in track(range(0, array.shape[0], depth), "digest"):
        yield np.asarray(array[first : first + depth])
