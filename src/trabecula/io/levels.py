"""Coarser levels of a store, where the finest does not fit into memory."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress

from trabecula.core.errors import InputError
from trabecula.core.progress import notify
from trabecula.engine import store
from trabecula.engine.memory import Plan, available_memory, check_budget, format_bytes
from trabecula.engine.storage.location import location_of, path_or_remote
from trabecula.io.guard import damaged
from trabecula.io.lazy import spatial_shape


def level_that_fits(
    source: str | os.PathLike[str],
    *,
    need: Callable[[tuple[int, ...], int], int],
    memory: int | None = None,
    level: int | None = None,
) -> int:
    """The finest level of a volume in a Zarr store that fits into memory, with a word where it is
    not 0, that of other files.

    Parameters
    ----------
    source : path or str
    need : callable
        Shape and bytes of a voxel -> bytes needed in memory.
    memory : int, optional
        Bytes that may be used. Default: what is available.
    level : int, optional
        The one that is asked for, if one is.

    Raises
    ------
    MemoryBudgetError
        Not even the coarsest fits, or the one that is asked for does not.
    FileError
        As `read`.
    """
    budget = available_memory() if memory is None else memory
    needed = _needed(source, need)
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
        finest = f"{os.fspath(source)} needs {format_bytes(needed[0])}, {format_bytes(budget)} may be used"
        cube = "x".join([str(2 ** fits[0])] * 3)
        notify(
            f"{finest}: its level {fits[0]} is shown, a voxel for {cube} (--level, --crop or --memory choose)"
        )
    return fits[0] if fits else 0


def _needed(
    source: str | os.PathLike[str], need: Callable[[tuple[int, ...], int], int]
) -> list[int]:
    """Bytes for every level of a volume in a store; empty where there is none."""
    place, found = path_or_remote(source), list[int]()
    if not location_of(place).is_store():
        return found
    with damaged(place, "Zarr"), suppress(InputError):  # beyond the last level
        while True:
            opened = store.open_finished(place, len(found))
            shape = spatial_shape(opened)
            if shape is None:
                return found
            found.append(need(shape, opened.array.dtype.itemsize))
    return found
