"""`finish_slabs`: operations that need no volume in memory, from a store into a store.

1. The labels are read slab by slab into a scratch file beside the result.
2. Every operation writes into them, slab by slab; components are runs of voxels (measure.runs), in
scratch files as well.
3. The result is written block by block.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from math import prod
from pathlib import Path
from typing import Any, cast

import numpy as np

from trabecula.core.checks import check_name
from trabecula.core.errors import FileError, InputError, TrabeculaError
from trabecula.core.image import Image, describe_fields
from trabecula.core.progress import track
from trabecula.core.recipe import Recipe, digest_of, versions
from trabecula.engine import memmap
from trabecula.engine.blocks import StoredVolume, part_bytes, stream
from trabecula.engine.chunking import Box, slices_of
from trabecula.engine.files import remove
from trabecula.engine.lazy_volume import Slabs
from trabecula.engine.lock import hold_lock
from trabecula.engine.memory import Plan, available_memory, check_budget
from trabecula.engine.storage.location import Folder, Location, location_of
from trabecula.engine.store import CHUNK
from trabecula.finish.bridges import search_bytes
from trabecula.finish.closed_pores import fill_trapped, fill_trapped_in_place
from trabecula.finish.connect import connect, connect_in_place
from trabecula.finish.floaters import remove_floaters, remove_floaters_in_place
from trabecula.io.units import long_name

Step = tuple[str, Mapping[str, Any]]
"""Name of an operation and its settings."""

IN_PLACE: dict[str, tuple[Callable[..., Image], Callable[..., dict[str, int]]]] = {
    "connect": (connect, connect_in_place),
    "remove_floaters": (remove_floaters, remove_floaters_in_place),
    "fill_trapped": (fill_trapped, fill_trapped_in_place),
}
"""The operations that need no volume in memory: of an Image, and of labels that are written into.
"""

_IN_CORE = {
    "connect": 10,
    "remove_floaters": 5,
    "fill_trapped": 5,
    "smooth": 22,
    "thicken": 22,
    "prune": 50,
}
"""Bytes a voxel of an operation in memory, with what is read and what is written."""

_PAGES = 48 << 20
"""Bytes of scratch files that are resident at least."""


def in_core_bytes(shape: Sequence[int], operations: Sequence[str]) -> int:
    """About what operations on a volume in memory need."""
    return max(_IN_CORE[name] for name in operations) * prod(shape)


def finish_slabs(
    volume: Slabs,
    path: str | os.PathLike[str],
    steps: Sequence[Step],
    *,
    memory: int | None = None,
    folder: str | os.PathLike[str] | None = None,
) -> Recipe:
    """Finish a volume that is read some planes at a time, into a store: the voxels and the recipe
    that the operations give.

    Parameters
    ----------
    volume : Slabs
    path : path
        `.zarr`. A run that was interrupted leaves the blocks that it wrote, and the same run does
        not write them again.
    steps : sequence of (name, settings)
        `connect`, `remove_floaters` or `fill_trapped`, each on the result of the one before, with
        their settings.
    memory : int, optional
        Bytes that may be used. Default: what is available.
    folder : path, optional
        Where scratch files go, of up to six times the voxels. Default: beside the result.

    Returns
    -------
    Recipe
        Of the result. Its last steps hold the reports.

    Raises
    ------
    InputError
        Another operation or suffix, no step; as the operations.
    MemoryBudgetError
        Not even a slab of one plane fits.
    FileError
        The result or the scratch files cannot be written; another process writes this result.
    """
    target = location_of(path)
    if not target.name.lower().endswith(".zarr"):
        raise InputError(
            f"{path}: what does not fit into memory is finished into a .zarr; name it so"
        )
    if not steps:
        raise InputError(f"nothing to do: name at least one of {', '.join(IN_PLACE)}")
    settings = [_settings(name, given) for name, given in steps]
    depth, pages = _cut(volume, settings, available_memory() if memory is None else memory)
    place = (
        target.folder if folder is None else Path(folder)
    ) / f".{target.beside('.finish').name}"
    grown = target.growing()
    if isinstance(target, Folder):
        target.check_replaceable()
    with hold_lock(grown.path) if isinstance(grown, Folder) else nullcontext():
        remove(place)  # of a run that was killed
        try:
            with memmap.map_large_arrays(place, memory=pages):
                return _finished(volume, target, settings, depth)
        except OSError as error:
            if isinstance(error, TrabeculaError):
                raise
            raise FileError(
                f"cannot write to {place.parent}: {error.strerror or error}; scratch files of up to six times the voxels lie "
                "there while a volume is finished: make room, or choose another folder (--scratch)"
            ) from error
        finally:
            remove(place)


def _settings(name: str, given: Mapping[str, Any]) -> Step:
    """A step with all its settings."""
    check_name(name, IN_PLACE, name="operation in slabs")
    known = inspect.signature(IN_PLACE[name][0]).parameters.values()
    defaults = {
        each.name: each.default for each in known if each.kind is inspect.Parameter.KEYWORD_ONLY
    }
    defaults.pop("mask", None)  # an array of the volume's size, which nothing reads in slabs
    for setting in given:
        check_name(setting, defaults, name=f"setting of {name}")
    return name, {**defaults, **given}


def _cut(volume: Slabs, steps: Sequence[Step], budget: int) -> tuple[int, int]:
    """Planes that are read at once, and bytes of scratch files that may be resident."""
    depth = min(volume.grain, volume.shape[0])
    while depth > 1 and forecast(volume, steps, depth).peak > budget:
        depth = (depth + 1) // 2
    plan = forecast(volume, steps, depth)
    check_budget(plan, budget=budget, advice="finish a coarser level (--level 1)")
    # What is touched here and there comes on top of the slabs that are worked on.
    return depth, max(plan.memory["pages"], budget - plan.memory["work"]) // 2


def forecast(volume: Slabs, steps: Sequence[Step], depth: int) -> Plan:
    """What `finish_slabs` needs when it reads `depth` planes at once."""
    plane = prod(volume.shape[1:])
    search = max(
        (
            search_bytes(volume.shape, settings["reach"])
            for _, settings in steps
            if settings.get("reach") is not None
        ),
        default=0,
    )
    written = part_bytes(
        volume.shape, [min(side, CHUNK) for side in volume.shape], np.dtype(np.uint8)
    )
    # One number a row for the runs, and one while they are counted.
    rows = 16 * volume.shape[0] * volume.shape[1]
    return Plan(
        {
            "pages": min(_PAGES, 2 * plane * volume.shape[0]),
            "work": rows + max(4 * depth * plane, search, written),
        }
    )


def _finished(volume: Slabs, target: Location, steps: Sequence[Step], depth: int) -> Recipe:
    values = memmap.empty(volume.shape, np.uint8)
    read = _read(volume, values, depth)
    recipe, last = volume.recipe, len(steps) - 1
    about: dict[str, Any] = {}
    for number, (name, settings) in enumerate(steps):
        # What the labels mean is all that the operations ask of an Image, beside its values.
        report = IN_PLACE[name][1](values, cast(Image, volume), **settings)
        about = {"operation": name, "settings": settings, "report": report}
        if number < last:  # the last one's digest is that of what is written
            recipe = recipe.then_made("finish", _digest(values, depth), **about)
    made = _made(
        volume,
        values,
        lambda sha256: recipe.then_made("finish", sha256, **about),
        _identity(volume, read, steps),
    )
    return recipe.then_made("finish", stream(made, target, side=CHUNK), **about)


def _read(volume: Slabs, values: np.ndarray, depth: int) -> str:
    """Read everything into an array; the digest of what was read."""

    def slabs() -> Iterator[np.ndarray]:
        first = 0
        for slab in track(volume.slabs(depth), "reading", total=-(-volume.shape[0] // depth)):
            values[first : first + len(slab.values)] = slab.values
            memmap.release_pages()
            yield slab.values
            first += len(slab.values)

    return digest_of(values.dtype, values.shape, slabs())


def _digest(values: np.ndarray, depth: int) -> str:
    def slabs() -> Iterator[np.ndarray]:
        for first in range(0, len(values), depth):
            yield values[first : first + depth]
            memmap.release_pages()

    return digest_of(values.dtype, values.shape, slabs())


def _identity(volume: Slabs, read: str, steps: Sequence[Step]) -> str:
    """Of all that the result depends on."""
    about = [read, volume.spacing, volume.unit, volume.phases, steps, versions()]
    return hashlib.sha256(json.dumps(about, default=str).encode()).hexdigest()


def _made(
    volume: Slabs, values: np.ndarray, recipe: Callable[[str], Recipe], identity: str
) -> StoredVolume:
    """What is written: `values`, as the volume is described."""

    def make(box: Box) -> np.ndarray:
        made = np.array(values[slices_of(box)])
        memmap.release_pages()
        return made

    fields = describe_fields(cast(Image, volume))
    return StoredVolume(
        shape=volume.shape,
        dtype=values.dtype,
        make=make,
        describe=lambda sha256: {**fields, "recipe": recipe(sha256).to_json()},
        identity=identity,
        scale=volume.spacing,
        unit=long_name(volume.unit),
        resume_hint="by the same command",
    )
