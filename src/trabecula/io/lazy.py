"""Volumes in a Zarr store that are read in part: some planes, or a coarser level."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import suppress
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
from trabecula.engine.memory import Plan, available_memory, check_budget, format_bytes
from trabecula.engine.storage import Remote, location_of, path_or_remote
from trabecula.io.guard import check_there, report_damage
from trabecula.io.meaning import interpret
from trabecula.io.metadata import FileContent, check_fields


def open_slabs(
    path: str | os.PathLike[str],
    *,
    kind: str | None = None,
    spacing: float | Sequence[float] | None = None,
    unit: str | None = None,
    phases: Sequence[str] | None = None,
    level: int = 0,
) -> Slabs:
    """Open a volume of labels in a Zarr store; no voxel is read yet.

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
            f"{path} is no Zarr store, and only those are read plane by plane: write it as .zarr "
            "first"
        )
    with report_damage(place, "Zarr"):
        voxels = _open(place, level)
        fields = (
            {**check_fields(voxels.opened.fields), "spacing": list(voxels.opened.scale)}
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
            f"{path} has more than {MAX_PHASES} levels: only labels are read plane by plane; "
            "segment it first"
        )
    # What a file's levels mean is said in one place, and for each alike: they stand for its voxels
    # there.
    content = FileContent(
        levels.reshape(1, 1, -1),
        spacing=voxels.opened.scale or None,
        unit=voxels.opened.unit,
        fields=fields,
    )
    meaning = interpret(content, source=os.fspath(path), options=options)
    if meaning.kind != "labels":
        raise InputError(
            f"{path} is {meaning.kind}: only labels are read plane by plane; segment it first "
            "(tb.segment)"
        )
    numbers = meaning.values.ravel()
    made = _slabs(
        voxels,
        meaning,
        voxels.read if np.array_equal(numbers, levels) else voxels.label_reader(levels, numbers),
    )
    return (
        made
        if ours and meaning.recipe == Recipe.from_json(fields and fields["recipe"])
        else _with_digest(made)
    )


def volume_shape(path: str | os.PathLike[str], *, level: int = 0) -> tuple[int, int, int] | None:
    """Return the voxels along z, y, x of a volume in a Zarr store; None where the path is no store,
    or holds no single volume.
    """
    place = path_or_remote(path)
    if not location_of(place).is_store():
        return None
    with report_damage(place, "Zarr"):
        return spatial_shape(store.open_finished(place, level))


def slabs_if_large(
    source: str | os.PathLike[str],
    *,
    need: Callable[[tuple[int, ...]], int],
    memory: int | None = None,
    **reading: Any,
) -> Slabs | None:
    """Open a volume in a Zarr store as `Slabs` where work on it would not fit into memory, else
    return None.

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
        f"{name} needs {format_bytes(need(shape))} as a whole, {format_bytes(budget)} may be used: "
        "it is read slab by slab"
    )
    return open_slabs(name, **reading)


@dataclass(frozen=True)
class _Voxels:
    """The voxels of a store along z, y, x, whatever axes of length one it has before these."""

    path: Path | Remote
    opened: store.Store
    shape: tuple[int, int, int]

    def read(self, box: Box) -> np.ndarray:
        """Return the voxels of a box."""
        array = self.opened.array
        with report_damage(self.path, "Zarr"):
            values = self.opened.read((0,) * (array.ndim - 3) + slices_of(box))
        return values.view(np.uint8) if values.dtype == bool else values

    def levels(self) -> np.ndarray | None:
        """Return the distinct values, rising; None where there are more than labels have."""
        found = np.empty(0, self.opened.array.dtype)
        for box in track(self._boxes(), "levels"):
            more = distinct_levels(self.read(box), limit=MAX_PHASES)
            found = np.union1d(found, more) if more is not None else np.arange(MAX_PHASES + 1)
            if len(found) > MAX_PHASES:
                return None
        return found

    def label_reader(self, levels: np.ndarray, numbers: np.ndarray) -> Callable[[Box], np.ndarray]:
        """Return a function like `read` that gives a label for every level."""
        return lambda box: numbers[np.searchsorted(levels, self.read(box))]

    def _boxes(self) -> list[Box]:
        depth, height, width = self.shape
        step = self.grain
        return [((z, min(z + step, depth)), (0, height), (0, width)) for z in range(0, depth, step)]

    @property
    def grain(self) -> int:
        """Return the planes of a chunk, which are read together."""
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
    """Return the sides along z, y, x; None where another axis is longer than one voxel."""
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
    """Record the digest of all voxels in the step that reads the file."""
    step = dict(volume.recipe.steps[-1])
    slabs = track(volume.slabs(volume.grain), "digest", total=-(-volume.shape[0] // volume.grain))
    step["sha256"] = digest_of(np.dtype(np.uint8), volume.shape, (slab.values for slab in slabs))
    return replace(volume, recipe=Recipe((*volume.recipe.steps[:-1], step)))


def level_that_fits(
    source: str | os.PathLike[str],
    *,
    need: Callable[[tuple[int, ...], int], int],
    memory: int | None = None,
    level: int | None = None,
) -> int:
    """Choose the finest level of a volume in a Zarr store that fits into memory; report it where it
    is not 0, which is that of other files.

    Parameters
    ----------
    source : path or str
    need : callable
        Shape and bytes of a voxel -> bytes needed in memory.
    memory : int, optional
        Bytes that may be used. Default: what is available.
    level : int, optional
        The level that is requested, if one is.

    Raises
    ------
    MemoryBudgetError
        Not even the coarsest fits, or the requested one does not.
    FileError
        As `read`.
    """
    budget = available_memory() if memory is None else memory
    needed = _bytes_by_level(source, need)
    if level is not None:
        if 0 <= level < len(needed):
            check_budget(
                Plan({"volume": needed[level]}), budget=budget, advice="show a coarser --level"
            )
        return level
    fits = [number for number, size in enumerate(needed) if size <= budget]
    if needed and not fits:
        coarsest = f", level {len(needed) - 1} is the coarsest" if len(needed) > 1 else ""
        check_budget(
            Plan({"volume": needed[-1]}),
            budget=budget,
            advice=f"show a smaller box (--crop){coarsest}",
        )
    if fits and fits[0]:
        need_text, may = format_bytes(needed[0]), format_bytes(budget)
        finest = f"{os.fspath(source)} needs {need_text}, {may} may be used"
        cube = "x".join([str(2 ** fits[0])] * 3)
        notify(
            f"{finest}: its level {fits[0]} is shown, a voxel for {cube} (--level, --crop or "
            "--memory choose)"
        )
    return fits[0] if fits else 0


def _bytes_by_level(
    source: str | os.PathLike[str], need: Callable[[tuple[int, ...], int], int]
) -> list[int]:
    """Return the bytes for every level of a volume in a store; empty where there is none."""
    place, found = path_or_remote(source), list[int]()
    if not location_of(place).is_store():
        return found
    with report_damage(place, "Zarr"), suppress(InputError):  # beyond the last level
        while True:
            opened = store.open_finished(place, len(found))
            shape = spatial_shape(opened)
            if shape is None:
                return found
            found.append(need(shape, opened.array.dtype.itemsize))
    return found
