"""Zarr stores: the one home of zarr.

A store is a Zarr v3 group with the voxels as array "0", described as OME-Zarr 0.5 (axes, scale, units), and our fields
under the attribute "trabecula". Its `complete` is false until the last chunk is written, so a run that died leaves
a store that says so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.errors import FileError
from trabecula.engine.files import replacing

KEY = "trabecula"
ARRAY = "0"
CHUNK = 128  # voxels along an axis: 2 MiB of labels, a unit that disks and networks like
_OF = "identity"
_EVERY_CHUNK: Any = {"write_empty_chunks": True}  # a chunk that is not there is then a chunk that was lost
_LEVEL = 3  # of zstd: labels shrink 20-fold at 1 GB/s; higher levels gain little


@dataclass(frozen=True)
class Store:
    """A store, opened; nothing of its voxels is in memory yet. `fields` is empty and `scale` may be where it is not ours."""

    path: Path
    array: Any
    fields: dict[str, Any]
    scale: tuple[float, ...]
    unit: str | None

    def load(self) -> np.ndarray:
        """All voxels.

        Raises
        ------
        ValueError
            Chunks are missing; zarr itself would give zeros for them.
        """
        missing = self.array.nchunks - self.array.nchunks_initialized
        if missing and self.fields:  # elsewhere a missing chunk means its fill value
            raise ValueError(f"{missing} of its {self.array.nchunks} chunks are missing")
        return np.asarray(self.array[...])


def save(
    path: Path, values: np.ndarray, *, scale: Sequence[float], unit: str | None, fields: Mapping[str, Any]
) -> None:
    """Write voxels as a store that appears whole or not at all.

    Parameters
    ----------
    path : Path
    values : (Z, Y, X) or (Y, X) array; channels first where there are any
    scale : sequence of float
        Edge of a voxel along every spatial axis.
    unit : str, optional
        OME-Zarr's name of its unit, such as "micrometer".
    fields : mapping
        Plain JSON, kept under "trabecula".

    Raises
    ------
    FileError
        A folder that is no Zarr store is in the way, or the place cannot be written.
    """
    if path.is_dir() and any(path.iterdir()) and not (path / "zarr.json").exists():
        raise FileError(f"cannot write {path}: a folder that is no Zarr store is there; choose another name")
    with replacing(path) as temporary:
        group, array = create(
            temporary, values.shape, values.dtype, scale=scale, unit=unit, fields=fields, name=path.stem
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
) -> tuple[Any, Any]:
    """An unfinished store and its empty array; call `finish` after the last chunk."""
    import zarr
    from zarr.codecs import ZstdCodec

    axes = (["c"] if len(shape) > len(scale) else []) + ["z", "y", "x"][-len(scale) :]
    group = zarr.create_group(
        str(path), attributes={"ome": _ome(axes, scale, unit, name), KEY: {**fields, "complete": False}}
    )
    array = group.create_array(
        ARRAY,
        shape=tuple(shape),
        dtype=dtype,
        chunks=tuple(side if axis == "c" else min(side, CHUNK) for axis, side in zip(axes, shape, strict=True)),
        compressors=[ZstdCodec(level=_LEVEL, checksum=True)],
        fill_value=0,
        dimension_names=axes,
        config=_EVERY_CHUNK,
    )
    return group, array


def finish(group: Any) -> None:
    """Mark a store as complete."""
    group.attrs[KEY] = {**group.attrs[KEY], "complete": True}


@dataclass(frozen=True)
class Unfinished:
    """A store that is still being written, and of what."""

    path: Path
    group: Any
    array: Any
    identity: str

    def chunk(self, voxel: Sequence[int]) -> Path:
        """The file of the chunk that holds a voxel."""
        return self.path.joinpath(ARRAY, "c", *(str(place // CHUNK) for place in voxel))

    def finish(self, fields: Mapping[str, Any]) -> None:
        """Mark the store as complete, with the fields that nobody knew before the last chunk."""
        # The identity stays, for a run that is killed before the store has its own name.
        self.group.attrs[KEY] = {**fields, _OF: self.identity, "complete": True}


def create_unfinished(
    path: Path,
    shape: Sequence[int],
    dtype: np.dtype,
    *,
    scale: Sequence[float],
    unit: str | None,
    identity: str,
    name: str,
) -> Unfinished:
    """An empty store that says `identity` of what will be in it, until it is finished."""
    with replacing(path) as temporary:
        create(temporary, shape, dtype, scale=scale, unit=unit, fields={_OF: identity}, name=name)
    made = open_unfinished(path)
    if made is None:
        raise FileError(f"cannot write {path}: what was written there cannot be read back; check the disk")
    return made


def open_unfinished(path: Path) -> Unfinished | None:
    """What `create_unfinished` left, whether or not it was finished; None where something else is there."""
    import zarr

    try:
        group: Any = zarr.open_group(str(path), mode="r+")
        # Which chunks are written is no part of what a store says of itself, and open_array overlooks its config.
        with zarr.config.set({f"array.{name}": value for name, value in _EVERY_CHUNK.items()}):
            array = group[ARRAY]
        return Unfinished(path, group, array, str(group.attrs[KEY][_OF]))
    except Exception:  # noqa: BLE001 (zarr raises what it likes on a folder that is none of its own)
        return None


def open_finished(path: Path) -> Store:
    """Open a store: one that this package finished, or anybody's with one array or a multiscale image in it.

    Raises
    ------
    FileError
        A store of ours whose run did not end; somebody else's in which it is open what to read.
    """
    import zarr

    node: Any = zarr.open(str(path), mode="r")
    fields = node.attrs.get(KEY)
    if not isinstance(fields, Mapping):
        return _open_foreign(path, node)
    if fields.get("complete") is not True:
        raise FileError(f"cannot read {path} as Zarr: the run that wrote it did not finish; run it again")
    scale, unit = _calibration(node.attrs["ome"])
    plain = {name: value for name, value in fields.items() if name != "complete"}
    return Store(path, node[ARRAY], plain, scale, unit)


def _open_foreign(path: Path, node: Any) -> Store:
    """Somebody else's: an array, a multiscale image (OME-Zarr 0.4 or 0.5; its finest level), or a group of one array."""
    import zarr

    if isinstance(node, zarr.Array):
        return Store(path, node, {}, (), None)
    ome = node.attrs.get("ome", node.attrs)
    if "multiscales" in ome:
        scale, unit = _calibration(ome)
        return Store(path, node[ome["multiscales"][0]["datasets"][0]["path"]], {}, scale, unit)
    arrays = [name for name, _ in node.arrays()]
    if len(arrays) != 1:
        names = ", ".join(sorted(arrays)) or "none"
        raise FileError(f"cannot read {path} as Zarr: one array is needed, it holds {names}; give the array's own path")
    return Store(path, node[arrays[0]], {}, (), None)


def _ome(axes: Sequence[str], scale: Sequence[float], unit: str | None, name: str) -> dict[str, Any]:
    length = {} if unit is None else {"unit": unit}
    described = [
        {"name": axis, "type": "channel"} if axis == "c" else {"name": axis, "type": "space", **length} for axis in axes
    ]
    factors = [1.0] * (len(axes) - len(scale)) + [float(edge) for edge in scale]
    datasets = [{"path": ARRAY, "coordinateTransformations": [{"type": "scale", "scale": factors}]}]
    return {"version": "0.5", "multiscales": [{"name": name, "axes": described, "datasets": datasets}]}


def _calibration(ome: Any) -> tuple[tuple[float, ...], str | None]:
    multiscale = ome["multiscales"][0]
    space = [index for index, axis in enumerate(multiscale["axes"]) if axis["type"] == "space"]
    factors = multiscale["datasets"][0]["coordinateTransformations"][0]["scale"]
    scale = tuple(float(factors[index]) for index in space)
    if not all(math.isfinite(edge) and edge > 0 for edge in scale):
        raise ValueError(f"its scale {scale} is not positive")
    return scale, multiscale["axes"][space[0]].get("unit")
