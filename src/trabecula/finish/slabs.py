"""`finish_slabs`: operations out of core, from a store into a store.

1. Read the labels slab by slab into a memory-mapped array beside the result.
2. Apply every operation in place, slab by slab; components are stored as runs of voxels
   (`measure.runs`), memory-mapped as well.
3. Write the result block by block.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from math import prod
from pathlib import Path
from typing import Any, cast

import numpy as np

from trabecula.core.checks import check_name, check_type
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
from trabecula.engine.storage import Folder, Location, location_of
from trabecula.engine.store import CHUNK
from trabecula.finish.operations import OPERATIONS
from trabecula.io.units import long_name
from trabecula.measure.near_joins import search_bytes

Step = tuple[str, Mapping[str, Any]]
"""Name of an operation and its settings."""

IN_PLACE: dict[str, Callable[..., dict[str, int]]] = {
    name: operation.in_place
    for name, operation in OPERATIONS.items()
    if operation.in_place is not None
}
"""The operations that need no whole volume in memory, by name."""

_PAGES = 48 << 20
"""Least number of resident bytes of memory-mapped arrays."""


def in_core_bytes(shape: Sequence[int], operations: Sequence[str]) -> int:
    """Return about the memory of operations on a volume in memory."""
    return max(OPERATIONS[name].bytes_per_voxel for name in operations) * prod(shape)


def finish_slabs(
    volume: Slabs,
    path: str | os.PathLike[str],
    steps: Sequence[Step],
    *,
    memory: int | None = None,
    folder: str | os.PathLike[str] | None = None,
) -> Recipe:
    """Finish a volume that is read some planes at a time, into a store.

    Voxels and recipe are those of the operations on the whole volume.

    Parameters
    ----------
    volume : Slabs
    path : path
        `.zarr`. A run that was interrupted leaves the blocks that it wrote, and the same run
        resumes with the others.
    steps : sequence of (name, settings)
        `connect`, `remove_floaters` or `fill_trapped`, each on the result of the one before.
    memory : int, optional
        Bytes that may be used. Default: what is available.
    folder : path, optional
        Folder for scratch files, of up to six times the voxels. Default: beside the result.

    Returns
    -------
    Recipe
        The recipe of the result. Its last steps hold the reports.

    Raises
    ------
    InputError
        Another operation or suffix, no step; the errors of the operations.
    MemoryBudgetError
        Not even a slab of one plane fits.
    FileError
        The result or the scratch files cannot be written; another process writes this result.
    """
    check_type(volume, Slabs, name="volume", advice="tb.open_slabs gives one")
    target = location_of(path)
    if not target.name.lower().endswith(".zarr"):
        raise InputError(
            f"{path}: a volume that does not fit into memory is finished into a .zarr; name it so"
        )
    if not steps:
        raise InputError(f"nothing to do: name at least one of {', '.join(IN_PLACE)}")
    complete = [_complete(name, settings) for name, settings in steps]
    budget = available_memory() if memory is None else memory
    depth, pages = _slab_depth(volume, complete, budget)
    parent = target.folder if folder is None else Path(folder)
    scratch = parent / f".{target.beside('.finish').name}"
    partial = target.growing()
    if isinstance(target, Folder):
        target.check_replaceable()
    with hold_lock(partial.path) if isinstance(partial, Folder) else nullcontext():
        remove(scratch)  # left by a run that was killed
        try:
            with memmap.map_large_arrays(scratch, memory=pages):
                return _finish(volume, target, complete, depth)
        except OSError as error:
            if isinstance(error, TrabeculaError):
                raise
            raise FileError(
                f"cannot write to {parent}: {error.strerror or error}; scratch files of up to six "
                "times the voxels are stored there while a volume is finished: make room, or "
                "choose another folder (--scratch)"
            ) from error
        finally:
            remove(scratch)


def _complete(name: str, settings: Mapping[str, Any]) -> Step:
    """Return a step with all its settings; a mask is none, as it is not read in slabs."""
    check_name(name, IN_PLACE, name="operation in slabs")
    return name, OPERATIONS[name].complete(settings)


def _slab_depth(volume: Slabs, steps: Sequence[Step], budget: int) -> tuple[int, int]:
    """Return the planes of a slab, and the bytes of memory-mapped arrays that may be resident."""
    depth = min(volume.grain, volume.shape[0])
    while depth > 1 and forecast(volume, steps, depth).peak > budget:
        depth = (depth + 1) // 2
    plan = forecast(volume, steps, depth)
    check_budget(plan, budget=budget, advice="finish a coarser level (--level 1)")
    # Scattered accesses come on top of the slab in work, hence half of the rest.
    return depth, max(plan.memory["pages"], budget - plan.memory["work"]) // 2


def forecast(volume: Slabs, steps: Sequence[Step], depth: int) -> Plan:
    """Return the memory of `finish_slabs` where it reads `depth` planes at once."""
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
    # Two numbers of 8 bytes per row of voxels: the first run, and the count before it.
    rows = 16 * volume.shape[0] * volume.shape[1]
    return Plan(
        {
            "pages": min(_PAGES, 2 * plane * volume.shape[0]),
            "work": rows + max(4 * depth * plane, search, written),
        }
    )


def _finish(volume: Slabs, target: Location, steps: Sequence[Step], depth: int) -> Recipe:
    """Read the volume, apply the steps, and write the result."""
    values = memmap.empty(volume.shape, np.uint8)
    source = _read(volume, values, depth)
    recipe, last = volume.recipe, len(steps) - 1
    about: dict[str, Any] = {}
    for number, (name, settings) in enumerate(steps):
        # Beside the values, the operations read only the meaning of the labels from an Image.
        report = IN_PLACE[name](values, cast(Image, volume), **settings)
        about = {"operation": name, "settings": settings, "report": report}
        if number < last:  # the digest of the last one follows while it is written
            recipe = recipe.then_digest("finish", _digest(values, depth), **about)
    result = _result_volume(
        volume,
        values,
        lambda sha256: recipe.then_digest("finish", sha256, **about),
        _identity(volume, source, steps),
    )
    return recipe.then_digest("finish", stream(result, target, side=CHUNK), **about)


def _read(volume: Slabs, values: np.ndarray, depth: int) -> str:
    """Read the volume into an array; return the digest of its voxels."""

    def slabs() -> Iterator[np.ndarray]:
        first = 0
        for slab in track(volume.slabs(depth), "reading", total=-(-volume.shape[0] // depth)):
            values[first : first + len(slab.values)] = slab.values
            memmap.release_pages()
            yield slab.values
            first += len(slab.values)

    return digest_of(values.dtype, values.shape, slabs())


def _digest(values: np.ndarray, depth: int) -> str:
    """Return the digest of an array, read some planes at a time."""

    def slabs() -> Iterator[np.ndarray]:
        for first in range(0, len(values), depth):
            yield values[first : first + depth]
            memmap.release_pages()

    return digest_of(values.dtype, values.shape, slabs())


def _identity(volume: Slabs, source: str, steps: Sequence[Step]) -> str:
    """Return the digest of everything that the result depends on."""
    about = [source, volume.spacing, volume.unit, volume.phases, steps, versions()]
    return hashlib.sha256(json.dumps(about, default=str).encode()).hexdigest()


def _result_volume(
    volume: Slabs, values: np.ndarray, recipe: Callable[[str], Recipe], identity: str
) -> StoredVolume:
    """Return the volume to write: `values` with the spacing, unit and phases of the source."""

    def make(box: Box) -> np.ndarray:
        block = np.array(values[slices_of(box)])
        memmap.release_pages()
        return block

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
