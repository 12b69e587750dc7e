"""Zarr stores: the one home of zarr.

A store is a Zarr v3 group with the voxels as array "0" and coarser levels (engine.multiscale)
as "1", "2", ..., described as OME-Zarr 0.5 (axes, scale, units), and our fields under the attribute
"trabecula". Its `complete` is false until the last chunk is written, so a run that died leaves a
store that says so.

A file (or object: see engine.storage) of an array holds a cube of `CHUNK` voxels and is the unit
of writing (Zarr's shard); the cubes of half its edge in it are the unit of reading (Zarr's chunk).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.errors import FileError, InputError
from trabecula.engine.chunking import Box, cells_of, slices_of
from trabecula.engine.multiscale import (
    calibration,
    datasets_of,
    halve_resolution,
    ome_attribute,
    shapes_of,
)
from trabecula.engine.storage import AnyPath, Location, location_of

KEY = "trabecula"
CHUNK = 128  # voxels along an axis of a file: 2 MiB of labels, a unit that disks and networks like
_OF = "identity"
_EDGE, _SIDE = "chunk", "block"
# a chunk that is not there is then a chunk that was lost
_EVERY_CHUNK: Any = {"write_empty_chunks": True}
_MOST_CHUNKS = 10**7  # of 2 MiB each, 20 TB
_MOST_CRUMBS, _CRUMB = 10**4, 1024  # chunks that are smaller than their names
_LEVEL = 3  # of zstd: labels shrink 20-fold at 1 GB/s; higher levels gain little


@dataclass(frozen=True)
class Store:
    """An open store; none of its voxels is in memory yet. `fields` is empty, and `scale` may be,
    where another program wrote it.
    """

    place: Location
    array: Any
    fields: dict[str, Any]
    scale: tuple[float, ...]
    unit: str | None

    def check_whole(self) -> None:
        """Raise where a chunk is not there.

        Raises
        ------
        ValueError
            Chunks are missing; zarr itself would give zeros for them. Or they are so many and so
            small that reading them would not end.
        """
        count, size = _chunks(self.array)
        if count > _MOST_CHUNKS or (count > _MOST_CRUMBS and size < _CRUMB):
            raise ValueError(f"its header claims {count} chunks of {size} bytes")
        if self.fields:  # elsewhere a missing chunk means its fill value
            files = _files(self.array)
            missing = self.place.missing(files)
            if missing:
                raise ValueError(f"{len(missing)} of its {len(files)} chunks are missing")

    def read(self, index: Any) -> np.ndarray:
        """Read some of the voxels, as an index of the array says."""
        with self.place.explain_errors():
            return np.asarray(self.array[index])

    def load(self) -> np.ndarray:
        """Read all voxels of the level that was opened.

        Raises
        ------
        ValueError
            As `check_whole`.
        """
        self.check_whole()
        return self.read(...)


def save(
    path: AnyPath,
    values: np.ndarray,
    *,
    scale: Sequence[float],
    unit: str | None,
    fields: Mapping[str, Any],
) -> None:
    """Write voxels as a store that appears whole or not at all, with its coarser levels.

    Parameters
    ----------
    path : path or address
    values : (Z, Y, X) or (Y, X) array; channels first where there are any
    scale : sequence of float
        Edge of a voxel along every spatial axis.
    unit : str, optional
        OME-Zarr's name of its unit, such as "micrometer".
    fields : mapping
        Plain JSON, kept under "trabecula". Its `kind` tells labels from what has a mean.

    Raises
    ------
    FileError
        A folder that is no Zarr store is in the way, or the place cannot be written.
    """
    place = location_of(path)
    with place.appearing() as temporary:
        group, arrays = create(
            temporary,
            values.shape,
            values.dtype,
            scale=scale,
            unit=unit,
            fields=fields,
            name=place.stem,
        )
        for level, array in enumerate(arrays):
            if level:
                values = halve_resolution(
                    values, labels=fields.get("kind") == "labels", axes=len(scale)
                )
            array[...] = values
        finish(group)


def create(
    path: Path,
    shape: Sequence[int],
    dtype: np.dtype,
    *,
    scale: Sequence[float],
    unit: str | None,
    fields: Mapping[str, Any],
    name: str = "",
    chunk: int | None = None,
) -> tuple[Any, list[Any]]:
    """Create an unfinished store and the empty arrays of its levels; call `finish` after the last
    chunk.
    """
    import zarr
    from zarr.codecs import ZstdCodec

    edge = CHUNK if chunk is None else chunk
    axes = (["c"] if len(shape) > len(scale) else []) + ["z", "y", "x"][-len(scale) :]
    channels, space = tuple(shape[: -len(scale)]), shape[-len(scale) :]
    shapes = shapes_of(space, 2 * edge)
    group = zarr.create_group(
        str(path),
        attributes={
            "ome": ome_attribute(axes, scale, unit, name, len(shapes)),
            KEY: {**fields, "complete": False},
        },
    )
    arrays = []
    for level, sides in enumerate(shapes):
        file = (*channels, *(min(side, edge) for side in sides))
        read = (*channels, *map(_to_read, file[len(channels) :]))
        arrays.append(
            group.create_array(
                str(level),
                shape=(*channels, *sides),
                dtype=dtype,
                chunks=read,
                shards=None if read == file else file,
                compressors=[ZstdCodec(level=_LEVEL, checksum=True)],
                fill_value=0,
                dimension_names=axes,
                config=_EVERY_CHUNK,
            )
        )
    return group, arrays


def _to_read(side: int) -> int:
    """Return the edge of the cubes that are read alone, for that of a file; smaller ones would cost
    more than they spare.
    """
    return side // 2 if side % 2 == 0 and side >= 128 else side


def finish(group: Any) -> None:
    """Mark a store as complete."""
    group.attrs[KEY] = {**group.attrs[KEY], "complete": True}


@dataclass(frozen=True)
class Unfinished:
    """A store that is still being written.

    Attributes
    ----------
    place : Location
    group : its Zarr group
    arrays : of its levels, the finest first
    identity : str
        Of all that its voxels depend on.
    chunk : int
        Edge of the cubes that are a file each.
    block : int
        Edge of those that were made at once when it was begun.
    """

    place: Location
    group: Any
    arrays: tuple[Any, ...]
    identity: str
    chunk: int
    block: int

    @property
    def fields(self) -> dict[str, Any]:
        """Return the store's own metadata; the digest of its voxels is empty until the end."""
        return dict(self.group.attrs[KEY])

    @property
    def complete(self) -> bool:
        """Return whether the store was finished after all."""
        return self.group.attrs[KEY].get("complete") is True

    @property
    def channels(self) -> int:
        """Return the numbers of a voxel, along a first axis of the arrays; 0 for one number,
        without that axis.
        """
        finest = self.arrays[0]
        return finest.shape[0] if finest.metadata.dimension_names[0] == "c" else 0

    @property
    def shapes(self) -> list[tuple[int, ...]]:
        """Return the voxels of every level along its axes of space."""
        return [tuple(array.shape[1:] if self.channels else array.shape) for array in self.arrays]

    def files(self, level: int, box: Box) -> list[str]:
        """Return the names of the files that hold a box of a level."""
        first = (0,) if self.channels else ()  # all channels are in one file
        return [_file(level, (*first, *cell), self.chunk) for cell in cells_of(box, self.chunk)]

    def missing(self, level: int, box: Box) -> list[str]:
        """Return the names of those files of a box that are not there."""
        return self.place.missing(self.files(level, box))

    def read(self, level: int, box: Box) -> np.ndarray:
        """Read a box of a level, channels first where there are any."""
        with self.place.explain_errors(self._hint):
            return np.asarray(self.arrays[level][..., *slices_of(box)])

    def write(self, level: int, box: Box, values: np.ndarray) -> None:
        """Write the voxels of a box of a level, channels first where there are any."""
        with self.place.explain_errors(self._hint):
            self.arrays[level][..., *slices_of(box)] = values

    @property
    def _hint(self) -> str:
        return (
            "; what is finished stays, and the same run resumes from it (generate --resume "
            f"{self.place.name})"
        )

    def finish(self, fields: Mapping[str, Any]) -> None:
        """Mark the store as complete, with the fields that nobody knew before the last chunk."""
        # The identity stays, for a run that is killed before the store has its own name.
        with self.place.explain_errors(self._hint):
            self.group.attrs[KEY] = {
                **fields,
                **_run_fields(self.identity, self.chunk, self.block),
                "complete": True,
            }


def _run_fields(identity: str, chunk: int, block: int) -> dict[str, Any]:
    return {_OF: identity, _EDGE: chunk, _SIDE: block}


def create_unfinished(
    path: AnyPath,
    shape: Sequence[int],
    dtype: np.dtype,
    *,
    scale: Sequence[float],
    unit: str | None,
    fields: Mapping[str, Any],
    identity: str,
    name: str,
    chunk: int,
    block: int,
) -> Unfinished:
    """Create an empty store that says what will be in it, and `identity` of it, until it is
    finished.
    """
    more = {**fields, **_run_fields(identity, chunk, block)}
    with location_of(path).appearing() as temporary:
        create(temporary, shape, dtype, scale=scale, unit=unit, fields=more, name=name, chunk=chunk)
    made = open_unfinished(path)
    if made is None:
        raise FileError(
            f"cannot write {path}: what was written there cannot be read back; check the disk"
        )
    return made


def open_unfinished(path: AnyPath) -> Unfinished | None:
    """Open the store that `create_unfinished` left, finished or not; return None for something else
    or nothing.

    Raises
    ------
    FileError
        An address that cannot be reached.
    """
    import zarr

    place = location_of(path)
    if not place.is_store():
        return None
    try:
        group: Any = zarr.open_group(place.zarr(), mode="r+")
        ours = group.attrs[KEY]
        levels = len(group.attrs["ome"]["multiscales"][0]["datasets"])
        # Which chunks are written is no part of what a store says of itself, and open_array
        # overlooks its config.
        with zarr.config.set({f"array.{name}": value for name, value in _EVERY_CHUNK.items()}):
            arrays = tuple(group[str(level)] for level in range(levels))
        return Unfinished(place, group, arrays, str(ours[_OF]), int(ours[_EDGE]), int(ours[_SIDE]))
    except Exception:  # noqa: BLE001 (zarr raises anything on a folder of another program)
        return None


def open_finished(path: AnyPath, level: int = 0) -> Store:
    """Open a level of a store: of one that this package finished, or of anybody's with one array or
    a multiscale image in it.

    Raises
    ------
    FileError
        A store of ours whose run did not end; somebody else's in which it is open what to read.
    InputError
        It has no such level.
    """
    place = location_of(path)
    with place.explain_errors():
        return _open(place, level)


def _open(place: Location, level: int) -> Store:
    import zarr

    node: Any = zarr.open(place.zarr(), mode="r")
    fields = node.attrs.get(KEY)
    if isinstance(fields, Mapping) and fields.get("complete") is not True:
        name = str(place).removesuffix(".part")
        raise FileError(
            f"cannot read {place} as Zarr: the run that makes it did not finish; trabecula "
            f"generate --resume {name} resumes it"
        )
    ours = (
        {name: value for name, value in fields.items() if name != "complete"}
        if isinstance(fields, Mapping)
        else {}
    )
    found = node.attrs.get("ome", dict(node.attrs))
    datasets = datasets_of(found)
    if datasets is not None:
        _check_level(place, level, len(datasets))
        scale, unit = calibration(found, level)
        array = node[datasets[level]["path"]]
        if not isinstance(array, zarr.Array):
            raise ValueError(f"its level {level} is no array")
        return Store(place, array, ours, scale, unit)
    _check_level(place, level, 1)
    return Store(
        place, node if isinstance(node, zarr.Array) else _only_array(place, node), {}, (), None
    )


def _check_level(place: Location, level: int, count: int) -> None:
    if not 0 <= level < count:
        have = "one level, 0" if count == 1 else f"levels 0 (the finest) to {count - 1}"
        raise InputError(f"{place} has {have}: got level {level}")


def _only_array(place: Location, group: Any) -> Any:
    """Return the only array of another program's group."""
    arrays = [name for name, _ in group.arrays()]
    if len(arrays) != 1:
        names = ", ".join(sorted(arrays)) or "none"
        raise FileError(
            f"cannot read {place} as Zarr: one array is needed, it holds {names}; give the array's "
            "own path"
        )
    return group[arrays[0]]


def _chunks(array: Any) -> tuple[int, int]:
    """Return the files of an array, and the bytes of one before it is packed."""
    edges = array.shards or array.chunks
    sides = zip(array.shape, edges, strict=True)
    count = math.prod(-(-side // edge) for side, edge in sides)
    return count, math.prod(edges) * array.dtype.itemsize


def _files(array: Any) -> list[str]:
    """Return the name of every file of an array of ours."""
    edges = array.shards or array.chunks
    box = tuple((0, -(-side // edge)) for side, edge in zip(array.shape, edges, strict=True))
    return [_file(array.basename, cell, 1) for cell in cells_of(box, 1)]


def _file(level: int | str, voxel: Sequence[int], edge: int) -> str:
    return "/".join((str(level), "c", *(str(place // edge) for place in voxel)))
