"""A run before it starts: into which blocks it divides its volume, and what memory, disk and time
it takes. For the time, boxes of it are made for about a second, or small volumes for some seconds.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from math import prod
from typing import TYPE_CHECKING

import numpy as np

from trabecula.core.errors import InputError, MemoryBudgetError, RequestError
from trabecula.core.progress import silence
from trabecula.core.request import Request
from trabecula.engine.chunking import Box, boxes_of
from trabecula.engine.memory import Plan, available_memory, check_budget, format_bytes
from trabecula.engine.storage import is_address, location_of
from trabecula.engine.store import CHUNK, Unfinished, open_unfinished
from trabecula.io.formats import suffix_of
from trabecula.pipeline.out_of_core import plan_whole
from trabecula.synth.api.method import Model
from trabecula.synth.api.windows import WindowModel, makes_boxes

if TYPE_CHECKING:
    from trabecula.engine.cluster import Cluster, Workers

CHUNKS = (16, 1024)
"""Smallest and largest edge of a store's chunks, voxels; a multiple of the first."""

_LEAST = 16
"""Edge of the first box that is timed, voxels."""

_EDGES = (24, 36, 48, 72, 96, 144, 192, 288)
"""Of the volumes that are timed where no box can be made alone, voxels."""

_SECONDS = 1.0
"""After the second box the next is made where it is expected to take no longer than this."""

_WHOLE_SECONDS = 3.0
"""The same of volumes: small ones cost mostly what large ones do not."""

_WRITTEN = 30e-9
"""Seconds a voxel for packing, writing, coarser levels and digest, as measured of labels on a plain
processor.
"""


@dataclass(frozen=True)
class BlockPlan:
    """The division of a volume: edges of the blocks that are made and of the chunks that are
    written, voxels.
    """

    side: int
    chunk: int


def plan_to(
    model: Model,
    request: Request,
    path: str | os.PathLike[str],
    *,
    memory: int | None = None,
    chunks: int | None = None,
    trial: bool = False,
) -> Plan:
    """Forecast a `generate_to`.

    Parameters
    ----------
    model, request, path, memory, chunks :
        As of `generate_to`; an empty path where the format is open.
    trial : bool
        Forecast the seconds as well, from boxes that are made for about a second, or volumes for
        some seconds.

    Raises
    ------
    MemoryBudgetError, InputError
        As `generate_to`.
    """
    check_block_options(model, path, chunks, None)
    memory = budget_for(path, memory)
    blocks = None
    if os.fspath(path):
        blocks = choose_blocks(model, request, path, memory=memory, chunks=chunks)
    if blocks is None:
        plan = model.plan(request)
    elif makes_boxes(model):
        plan = model.plan_block(request, blocks.side)
    else:
        budget = available_memory() if memory is None else memory
        plan = plan_whole(model, request, budget, blocks.chunk)
    seconds = _try_seconds(model, request, blocks) if trial else None
    transfer = {"way to the address": location_of(path).memory} if is_address(path) else {}
    return replace(plan, memory={**plan.memory, **transfer}, seconds=seconds)


def choose_blocks(
    model: Model,
    request: Request,
    path: str | os.PathLike[str],
    *,
    memory: int | None = None,
    chunks: int | None = None,
    workers: Workers | None = None,
) -> BlockPlan | None:
    """Choose the blocks of a run; None where everything is made at once.

    Arguments and errors as of `generate_to`.
    """
    plan = model.plan(request)
    budget = available_memory() if memory is None else memory
    into_store = suffix_of(os.fspath(path)) == ".zarr"
    unfinished = find_unfinished(model, request, path) if into_store else None
    # At an address a run that can be resumed is worth more than the little that blocks cost.
    whole_allowed = not (makes_boxes(model) and is_address(path))
    free_choice = unfinished is None and chunks is None and workers is None
    if plan.peak <= budget and free_choice and whole_allowed:
        return None
    if not into_store:
        advice = "write a .zarr, which is made block by block; ask for a smaller --shape"
        check_budget(plan, budget=memory, advice=advice)
        return None
    chunk = chunks or (CHUNK if unfinished is None else unfinished.chunk)
    if not makes_boxes(model):
        advice = "use fewer --threads, smaller --chunks (64), ask for a smaller --shape"
        check_budget(plan_whole(model, request, budget, chunk), budget=budget, advice=advice)
        return BlockPlan(chunk, chunk)
    # A resumed run takes no larger blocks than before: parts of them would be made again.
    begun = model.block if unfinished is None else unfinished.block
    most = chunk if chunks else begun
    if workers is None:
        return _largest_blocks(model, request, budget, chunk, most)
    each = budget if workers.memory is None else workers.memory - location_of(path).memory
    return _largest_blocks(model, request, each, chunk, most, at_once=workers.at_once)


def _largest_blocks(
    model: WindowModel, request: Request, budget: int, chunk: int, most: int, *, at_once: int = 1
) -> BlockPlan:
    """Return the largest block of an edge up to `most` that fits into the budget and leaves work
    for all workers.
    """
    for side in [*range(most // chunk * chunk, chunk, -chunk), chunk]:
        count = prod(-(-length // side) for length in request.shape)
        enough = at_once == 1 or count >= 2 * at_once
        if (enough or side == chunk) and model.plan_block(request, side).peak <= budget:
            return BlockPlan(side, chunk)
    need = model.plan_block(request, chunk).peak
    smaller = "" if chunk <= 64 else "smaller --chunks (64), "
    raise MemoryBudgetError(
        f"a block of {chunk} voxels needs about {format_bytes(need)} of memory, "
        f"{format_bytes(budget)} may be used: use {smaller}fewer --threads or --workers, "
        "or raise --memory"
    )


def check_block_options(
    model: Model, path: str | os.PathLike[str], chunks: int | None, cluster: Cluster | None
) -> None:
    """Raise where chunks or workers are given and the volume cannot be divided."""
    if chunks is None and cluster is None:
        return
    option = "--chunks" if cluster is None else "workers"
    if cluster is not None and model.capabilities.large == "memory":
        raise InputError(
            f"method {model.capabilities.name!r} makes volumes in memory, {option} are for what is "
            "made in blocks: leave them out"
        )
    if suffix_of(os.fspath(path)) != ".zarr":
        raise InputError(
            f"{option} are for what is made in blocks, into a .zarr: leave them out, "
            "or write a .zarr"
        )
    if chunks is not None and (chunks % CHUNKS[0] or not CHUNKS[0] <= chunks <= CHUNKS[1]):
        raise InputError(
            f"--chunks {chunks} should be a multiple of {CHUNKS[0]} from {CHUNKS[0]} to {CHUNKS[1]}"
        )


def budget_for(path: str | os.PathLike[str], memory: int | None) -> int | None:
    """Return the budget in bytes, less what the transfer to an address needs."""
    if not is_address(path):
        return memory
    return max(0, (available_memory() if memory is None else memory) - location_of(path).memory)


def find_unfinished(
    model: Model, request: Request, path: str | os.PathLike[str]
) -> Unfinished | None:
    """Return the unfinished store of an interrupted run of the same model and request, if any."""
    unfinished = open_unfinished(location_of(path).growing())
    if unfinished is not None and unfinished.identity == model.identity(request):
        return unfinished
    return None


def _try_seconds(model: Model, request: Request, blocks: BlockPlan | None) -> float | None:
    """Extrapolate the seconds of a run from boxes or small volumes; None where nothing small can be
    made.
    """
    with suppress(RequestError):  # settings with which no box can be made alone
        if makes_boxes(model):
            side = model.block if blocks is None else blocks.side
            return seconds_of(lambda box: model.values_of(request, box), request.shape, side)
    with suppress(RequestError):  # no volume that small
        if not request.is_tied:
            return seconds_of_whole(
                lambda shape: _try_shape(model, replace(request, shape=shape)), request.shape
            )
    return None


def _try_shape(model: Model, request: Request) -> None:
    """Make a volume for its seconds alone: what is said of larger ones than the first, which loads
    kernels, is said of no result.
    """
    first = max(request.shape) <= _EDGES[0]
    with nullcontext() if first else silence():
        model.generate(request)


def seconds_of(
    make: Callable[[Box], np.ndarray],
    shape: Sequence[int],
    side: int,
    *,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Return the seconds that making a volume in blocks takes on this machine, as it is now.

    Parameters
    ----------
    make : Box -> array
        Makes any box of the volume.
    shape : sequence of int
        Of the volume.
    side : int
        Edge of the blocks.
    clock : function, optional
        Gives seconds.

    Notes
    -----
    A box of side s needs what is around it as well, so its time is close to c (s + h)^3. Boxes of
    sides 16, 32, ... up to the block's are timed, two at least, as long as the next one can be
    expected to take a second; c and h follow from the last two (h = 0 where the larger box was as
    expensive a voxel). Beside the boxes, what the very first call does once, and 30 ns a voxel for
    writing.
    """
    blocks = boxes_of(shape, side)
    block = max(last - first for first, last in blocks[0])
    start = clock()
    make(_box(shape, 8))
    once = clock() - start  # kernels are loaded, tables are made
    timed: list[tuple[int, float]] = []
    edge = min(_LEAST, block)
    while True:
        start = clock()
        make(_box(shape, edge))
        timed.append((edge, max(clock() - start, 1e-6)))
        if edge == block or (len(timed) > 1 and 8 * timed[-1][1] > _SECONDS):
            break
        edge = min(2 * edge, block)
    total = sum(_estimate(timed, shape, box) for box in blocks)
    return once + total + _WRITTEN * prod(shape)


def seconds_of_whole(
    make: Callable[[tuple[int, ...]], object],
    shape: Sequence[int],
    *,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Return the seconds that making a volume as a whole takes on this machine, as it is now.

    Parameters
    ----------
    make : shape -> anything
        Makes a volume of any shape.
    shape : sequence of int
        Of the volume.
    clock : function, optional
        Gives seconds.

    Notes
    -----
    Volumes of edge 24, 36, 48, 72, ... are timed, two at least, as long as the next one can be
    expected to take three seconds; what a further voxel costs follows from the last two. Coarse
    levels that only large volumes have add little.
    """
    make(_cube(shape, _EDGES[0]))  # kernels are loaded, tables are made
    timed: list[tuple[int, float]] = []
    for edge in _EDGES:
        sides = _cube(shape, edge)
        start = clock()
        make(sides)
        timed.append((prod(sides), max(clock() - start, 1e-6)))
        if sides == tuple(shape) or (len(timed) > 1 and 3 * timed[-1][1] > _WHOLE_SECONDS):
            break
    (voxels, seconds), more = timed[-1], timed[-1][1] / timed[-1][0]
    if len(timed) > 1 and voxels > timed[-2][0]:
        more = max((seconds - timed[-2][1]) / (voxels - timed[-2][0]), 0.5 * more)
    return seconds + more * (prod(shape) - voxels) + _WRITTEN * prod(shape)


def _cube(shape: Sequence[int], edge: int) -> tuple[int, ...]:
    return tuple(min(edge, length) for length in shape)


def _box(shape: Sequence[int], edge: int) -> Box:
    """Return a box in the middle of a shape."""
    return tuple(
        ((length - min(edge, length)) // 2, (length + min(edge, length)) // 2) for length in shape
    )


def _estimate(timed: Sequence[tuple[int, float]], shape: Sequence[int], box: Box) -> float:
    """Return the seconds of a box, from those of boxes that were timed."""
    sides = [last - first for first, last in box]
    (edge, seconds), around = timed[-1], 0.0
    if len(timed) > 1 and len(shape) == 3 and min(shape) >= edge:
        before, quicker = timed[-2]
        ratio = (seconds / quicker) ** (1 / 3)
        if 1 < ratio < edge / before:
            around = (edge - ratio * before) / (ratio - 1)
    return seconds * prod(
        (side + around) / (min(edge, length) + around)
        for side, length in zip(sides, shape, strict=True)
    )
