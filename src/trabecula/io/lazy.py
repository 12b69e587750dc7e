"""`open_slabs`: labels in a Zarr store whose planes are read when they are asked for."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import MAX_PHASES, Image, distinct_levels
from trabecula.core.progress import notify, track
from trabecula.core.recipe import Recipe, digest_of
from trabecula.engine import store
from trabecula.engine.chunking import Box, slices_of
from trabecula.engine.lazy_volume import Slabs
from trabecula.engine.memory import available_memory, format_bytes
from trabecula.engine.storage.location import Remote, location_of, path_or_remote
from trabecula.io.guard import check_there, damaged
from trabecula.io.meaning import interpret
from trabecula.io.metadata import Content, checked


def open_slabs(
    path: str | os.PathLike[str],
    *,
    kind: str | None = None,
    spacing: float | Sequence[float] | None = None,
    unit: str | None = None,
    phases: Sequence[str] | None = None,
    level: int = 0,
) -> Slabs:
    """A volume of labels in a Zarr store, of which nothing is in memory yet.

    Parameters
    ----------
    path : path or address
        A Zarr store. One of another program is read once, to find its levels.
    kind, spacing, unit, phases, level
        As in `read`.

    Returns
    -------
    Slabs

    Raises
    ------
    FileError, UnknownNameError
        As `read`.
    InputError
        No Zarr store, not three axes, or no labels.

    Examples
    --------
    >>> import tempfile, numpy as np, trabecula as tb
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = tb.write(np.ones((4, 3, 2), np.uint8), f"{folder}/block.zarr")
    ...     open_slabs(path).planes(1, 3)
    <Image 2x3x2 labels, voxel 1x1x1 voxel, phases void/solid>
    """
    given = {
        "kind": kind,
        "spacing": spacing,
        "unit": unit,
        "phases": phases,
        "level": level or None,
    }
    options = {name: value for name, value in given.items() if value is not None}
    place = path_or_remote(path)
    check_there(place)
    if not location_of(place).is_store():
        raise InputError(
            f"{path} is no Zarr store, and only those are read plane by plane: write it as .zarr first"
        )
    with damaged(place, "Zarr"):
        voxels = _open(place, level)
        fields = (
            {**checked(voxels.opened.fields), "spacing": list(voxels.opened.scale)}
            if voxels.opened.fields
            else None
        )
        ours = (
            fields is not None
            and fields["kind"] == "labels"
            and options.get("kind", "labels") == "labels"
        )
        levels = (
            np.arange(len(fields["phases"]), dtype=np.uint8) if fields and ours else voxels.levels()
        )
    if levels is None:
        raise InputError(
            f"{path} has more than {MAX_PHASES} levels: only labels are read plane by plane; segment it first"
        )
    # What a file's levels mean is said in one place, and for each alike: they stand for its voxels
    # there.
    content = Content(
        levels.reshape(1, 1, -1),
        spacing=voxels.opened.scale or None,
        unit=voxels.opened.unit,
        fields=fields,
    )
    meaning = interpret(content, source=os.fspath(path), options=options)
    if meaning.kind != "labels":
        raise InputError(
            f"{path} is {meaning.kind}: only labels are read plane by plane; segment it first (tb.segment)"
        )
    numbers = meaning.values.ravel()
    made = _slabs(
        voxels,
        meaning,
        voxels.read if np.array_equal(numbers, levels) else voxels.numbered(levels, numbers),
    )
    return (
        made
        if ours and meaning.recipe == Recipe.from_json(fields and fields["recipe"])
        else _with_digest(made)
    )


def volume_shape(path: str | os.PathLike[str], *, level: int = 0) -> tuple[int, int, int] | None:
    """Voxels along z, y, x of what lies in a Zarr store; `None` where the path is none, or holds no
    single volume.
    """
    place = path_or_remote(path)
    if not location_of(place).is_store():
        return None
    with damaged(place, "Zarr"):
        return spatial_shape(store.open_finished(place, level))


def slabs_if_large(
    source: str | os.PathLike[str],
    *,
    need: Callable[[tuple[int, ...]], int],
    memory: int | None = None,
    **reading: Any,
) -> Slabs | None:
    """A volume in a Zarr store as `Slabs`, where what is to be done with it would not fit into
    memory; else `None`.

    Parameters
    ----------
    source : path or str
    need : callable
        Shape -> bytes needed in memory.
    memory : int, optional
        Bytes that may be used. Default: what is available.
    **reading
        kind, spacing, unit, phases, level: as in `read`.

    Raises
    ------
    InputError, FileError
        As `open_slabs`.
    """
    name = os.fspath(source)
    shape = volume_shape(name, level=reading.get("level", 0))
    budget = available_memory() if memory is None else memory
    if shape is None or need(shape) <= budget:
        return None
    notify(
        f"{name} needs {format_bytes(need(shape))} as a whole, {format_bytes(budget)} may be used: it is read slab by slab"
    )
    return open_slabs(name, **reading)


@dataclass(frozen=True)
class _Voxels:
    """The voxels of a store along z, y, x, whatever axes of length one it has before these."""

    path: Path | Remote
    opened: store.Store
    shape: tuple[int, int, int]

    def read(self, box: Box) -> np.ndarray:
        array = self.opened.array
        with damaged(self.path, "Zarr"):
            values = self.opened.read((0,) * (array.ndim - 3) + slices_of(box))
        return values.view(np.uint8) if values.dtype == bool else values

    def levels(self) -> np.ndarray | None:
        """The distinct values, rising, or None where there are more than labels have."""
        found = np.empty(0, self.opened.array.dtype)
        for box in track(self._boxes(), "levels"):
            more = distinct_levels(self.read(box), limit=MAX_PHASES)
            found = np.union1d(found, more) if more is not None else np.arange(MAX_PHASES + 1)
            if len(found) > MAX_PHASES:
                return None
        return found

    def numbered(self, levels: np.ndarray, numbers: np.ndarray) -> Callable[[Box], np.ndarray]:
        """As `read`, with a label for every level."""
        return lambda box: numbers[np.searchsorted(levels, self.read(box))]

    def _boxes(self) -> list[Box]:
        depth, height, width = self.shape
        step = self.grain
        return [((z, min(z + step, depth)), (0, height), (0, width)) for z in range(0, depth, step)]

    @property
    def grain(self) -> int:
        """Planes of a chunk that is read alone."""
        return int(self.opened.array.chunks[-3])


def _open(path: Path | Remote, level: int) -> _Voxels:
    opened = store.open_finished(path, level)
    opened.check_whole()
    shape = spatial_shape(opened)
    if shape is None:
        raise InputError(
            f"{path} is no single volume, its shape is {opened.array.shape}: give 3 axes (z, y, x)"
        )
    return _Voxels(path, opened, shape)


def spatial_shape(opened: store.Store) -> tuple[int, int, int] | None:
    """The sides along z, y, x; None where there are others that are longer than one voxel."""
    *extra, depth, height, width = (1, 1, 1, *(int(side) for side in opened.array.shape))
    if opened.array.ndim < 3 or len(opened.scale) not in (0, 3) or any(side != 1 for side in extra):
        return None
    return depth, height, width


def _slabs(voxels: _Voxels, meaning: Image, read: Callable[[Box], np.ndarray]) -> Slabs:
    fields: dict[str, Any] = {
        name: getattr(meaning, name) for name in ("spacing", "unit", "phases", "recipe")
    }
    return Slabs(voxels.shape, read, grain=voxels.grain, **fields)


def _with_digest(volume: Slabs) -> Slabs:
    """The step that reads the file bears the digest of all voxels."""
    step = dict(volume.recipe.steps[-1])
    slabs = track(volume.slabs(volume.grain), "digest", total=-(-volume.shape[0] // volume.grain))
    step["sha256"] = digest_of(np.dtype(np.uint8), volume.shape, (slab.values for slab in slabs))
    return replace(volume, recipe=Recipe((*volume.recipe.steps[:-1], step)))
