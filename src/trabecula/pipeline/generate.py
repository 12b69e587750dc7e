"""From a model to a file: in memory where the result fits, else block by block into a store, by
this process or by workers.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trabecula.core.errors import InputError, MemoryBudgetError, RequestError
from trabecula.core.image import outline
from trabecula.core.progress import notify
from trabecula.core.recipe import Recipe
from trabecula.core.request import Request
from trabecula.engine import checkpoint
from trabecula.engine.blocks import Box, StoredVolume, stream
from trabecula.engine.memory import Plan, available_memory, check_budget, format_bytes
from trabecula.engine.storage.location import (
    Folder,
    Location,
    Remote,
    is_address,
    location_of,
    path_or_remote,
)
from trabecula.engine.store import CHUNK, Unfinished, open_unfinished
from trabecula.engine.timing import seconds_of, seconds_of_whole
from trabecula.io import files
from trabecula.io.formats import suffix_of
from trabecula.io.units import long_name
from trabecula.pipeline.out_of_core import Whole, pages_of, plan_whole
from trabecula.pipeline.worker_payload import Shipped
from trabecula.synth.api.method import Model
from trabecula.synth.api.windows import WindowModel

if TYPE_CHECKING:
    from trabecula.engine.cluster import Cluster, Workers

CHUNKS = (16, 1024)
"""Edges that a store's chunks may have, voxels; a multiple of the first."""


@dataclass(frozen=True)
class Result:
    """A result that is in a file.

    Attributes
    ----------
    path : Path, or Remote at an address
    shape : tuple of int
    text : str
        What it is, in a line.
    recipe : Recipe
    sha256 : str
        Of its voxels.
    """

    path: Path | Remote
    shape: tuple[int, ...]
    text: str
    recipe: Recipe

    @property
    def sha256(self) -> str:
        """Digest of the voxels."""
        return str(self.recipe.steps[-1]["sha256"])


@dataclass(frozen=True)
class BlockPlan:
    """How a volume is cut: edges of the blocks that are made and of the chunks that are written,
    voxels.
    """

    side: int
    chunk: int


def partial_path(path: str | os.PathLike[str]) -> Path:
    """Where the state of an unfinished run is kept: beside its result, as rock.zarr.part of
    rock.zarr.
    """
    return location_of(path).beside(".part")


def generate_to(
    model: Model,
    request: Request,
    path: str | os.PathLike[str],
    *,
    memory: int | None = None,
    chunks: int | None = None,
    cluster: Cluster | None = None,
    scratch: str | os.PathLike[str] | None = None,
) -> Result:
    """Make material into a file. A run that was interrupted goes on from what it left beside it.

    Parameters
    ----------
    model : Model
    request : Request
    path : path or address
        The suffix chooses the format. Into a Zarr store goes what does not fit into the budget as
        well, with the same voxels: a model of an unlimited material (a `WindowModel`) makes it
        block by block, another in scratch files.
    memory : int, optional
        Budget in bytes, of all workers together where there are any. Default: what the machine has
        available.
    chunks : int, optional
        Make it in blocks of this edge, voxels, whatever its size: a multiple of 16 from 16 to 1024,
        and the edge of the store's chunks. Default: blocks as large as fit, in chunks of 128.
    cluster : Cluster, optional
        Workers that make the blocks.
    scratch : path, optional
        Folder for scratch files. Default: that of the result, of one at an address the working
        directory.

    Raises
    ------
    MemoryBudgetError
        The forecast exceeds the budget.
    FileError
        The file cannot be written, or what another run left is in its place.
    InputError
        Chunks or workers for what is not made in blocks: of another method, or in another format.
    ClusterError
        The workers or their scheduler do not answer.
    """
    _check_in_blocks(model, path, chunks, cluster)
    memory = _for_making(path, memory)
    with _workers(cluster, memory) as workers:
        cut = choose_blocks(model, request, path, memory=memory, chunks=chunks, workers=workers)
        if cut is not None and isinstance(model, WindowModel):
            return _in_blocks(model, request, location_of(path), cut, workers)
        if cut is not None:
            budgets = {"memory": memory, "chunks": chunks}
            folder = None if scratch is None else Path(scratch)
            return _as_a_whole(
                model, request, location_of(path), cut, workers, **budgets, scratch=folder
            )
    if scratch is not None:
        notify("no scratch files are needed: it is made in memory")
    target = path_or_remote(path)
    if isinstance(target, Remote):
        target.check_free()
    with checkpoint.kept_at(None if isinstance(target, Remote) else partial_path(path)):
        material = model.generate(request, memory=memory)
        files.write(material, path)
    return Result(target, material.shape, repr(material), material.recipe)


def choose_blocks(
    model: Model,
    request: Request,
    path: str | os.PathLike[str],
    *,
    memory: int | None = None,
    chunks: int | None = None,
    workers: Workers | None = None,
) -> BlockPlan | None:
    """How a run cuts its volume; None where it makes everything at once. Arguments and errors as of
    `generate_to`.
    """
    plan = model.plan(request)
    if not _goes_in_blocks(model):
        return None
    budget = available_memory() if memory is None else memory
    store = suffix_of(os.fspath(path)) == ".zarr"
    left = _left_by(model, request, path) if store else None
    # At an address what could be gone on with is worth more than the little that blocks cost.
    at_once = not (isinstance(model, WindowModel) and is_address(path))
    if plan.peak <= budget and left is None and chunks is None and workers is None and at_once:
        return None
    if not store:
        check_budget(
            plan,
            budget=memory,
            advice="write a .zarr, which is made block by block; ask for a smaller --shape",
        )
        return None
    chunk = chunks or (CHUNK if left is None else left.chunk)
    if not isinstance(model, WindowModel):
        plan = plan_whole(model, request, budget, chunk)
        check_budget(
            plan,
            budget=budget,
            advice="use fewer --threads, smaller --chunks (64), ask for a smaller --shape",
        )
        return BlockPlan(chunk, chunk)
    # Of what was begun no larger blocks, of which a part would be made again.
    most = chunk if chunks else model.block if left is None else left.block
    if workers is None:
        return _fitting(model, request, budget, chunk, most)
    each = budget if workers.memory is None else workers.memory - location_of(path).memory
    return _fitting(model, request, each, chunk, most, at_once=workers.at_once)


def _fitting(
    model: WindowModel, request: Request, budget: int, chunk: int, most: int, *, at_once: int = 1
) -> BlockPlan:
    """The largest block of an edge up to `most` that fits into the budget and leaves work for all."""
    sides = [*range(most // chunk * chunk, chunk, -chunk), chunk]
    for side in sides:
        enough = at_once == 1 or prod(-(-length // side) for length in request.shape) >= 2 * at_once
        if (enough or side == chunk) and model.plan_block(request, side).peak <= budget:
            return BlockPlan(side, chunk)
    need = model.plan_block(request, chunk).peak
    smaller = "" if chunk <= 64 else "smaller --chunks (64), "
    raise MemoryBudgetError(
        f"a block of {chunk} voxels needs about {format_bytes(need)} of memory, {format_bytes(budget)} may be used: use "
        f"{smaller}fewer --threads or --workers, or raise --memory"
    )


def plan_to(
    model: Model,
    request: Request,
    path: str | os.PathLike[str],
    *,
    memory: int | None = None,
    chunks: int | None = None,
    trial: bool = False,
) -> Plan:
    """Forecast of `generate_to`; with `trial` of its seconds too, from volumes or boxes that are
    made for about a second.
    """
    _check_in_blocks(model, path, chunks, None)
    memory = _for_making(path, memory)
    cut = (
        choose_blocks(model, request, path, memory=memory, chunks=chunks)
        if os.fspath(path)
        else None
    )
    if cut is None:
        plan = model.plan(request)
    elif isinstance(model, WindowModel):
        plan = model.plan_block(request, cut.side)
    else:
        plan = plan_whole(
            model, request, available_memory() if memory is None else memory, cut.chunk
        )
    seconds = _seconds_of(model, request, cut) if trial else None
    way = {"way to the address": location_of(path).memory} if is_address(path) else {}
    return replace(plan, memory={**plan.memory, **way}, seconds=seconds)


def _seconds_of(model: Model, request: Request, cut: BlockPlan | None) -> float | None:
    """Seconds that a run is expected to take, from boxes or small volumes that are made; None where
    nothing small can be.
    """
    with suppress(RequestError):  # settings with which no box can be made alone
        if isinstance(model, WindowModel):
            side = model.block if cut is None else cut.side
            return seconds_of(lambda box: model.values_of(request, box), request.shape, side)
    with suppress(RequestError):  # no volume that small
        if not request.is_tied:
            return seconds_of_whole(
                lambda shape: model.generate(replace(request, shape=shape)), request.shape
            )
    return None


def _for_making(path: str | os.PathLike[str], memory: int | None) -> int | None:
    """What of a budget is left when the way to an address has had its own."""
    if not is_address(path):
        return memory
    return max(0, (available_memory() if memory is None else memory) - location_of(path).memory)


def _check_in_blocks(
    model: Model, path: str | os.PathLike[str], chunks: int | None, cluster: Cluster | None
) -> None:
    """Raise where chunks or workers are asked for and there is nothing to be cut."""
    if chunks is None and cluster is None:
        return
    option = "--chunks" if cluster is None else "workers"
    if not _goes_in_blocks(model):
        raise InputError(
            f"method {model.capabilities.name!r} makes volumes in memory, {option} are for what is made in blocks: leave them out"
        )
    if suffix_of(os.fspath(path)) != ".zarr":
        raise InputError(
            f"{option} are for what is made in blocks, into a .zarr: leave them out, or write a .zarr"
        )
    if chunks is not None and (chunks % CHUNKS[0] or not CHUNKS[0] <= chunks <= CHUNKS[1]):
        raise InputError(
            f"--chunks {chunks} should be a multiple of {CHUNKS[0]} from {CHUNKS[0]} to {CHUNKS[1]}"
        )


def _goes_in_blocks(model: Model) -> bool:
    return isinstance(model, WindowModel) or model.spills


@contextmanager
def _workers(cluster: Cluster | None, memory: int | None) -> Iterator[Workers | None]:
    if cluster is None:
        yield None
        return
    from trabecula.engine.cluster import workers_of

    budget = available_memory() if memory is None and cluster.workers is not None else memory
    with workers_of(cluster, memory=budget) as found:
        yield found


def _left_by(model: Model, request: Request, path: str | os.PathLike[str]) -> Unfinished | None:
    """What an interrupted run of the same request left, made in blocks."""
    left = open_unfinished(location_of(path).growing())
    return left if left is not None and left.identity == model.identity(request) else None


def _in_blocks(
    model: WindowModel, request: Request, path: Location, cut: BlockPlan, workers: Workers | None
) -> Result:
    """Each block alone, into a store."""
    make = (
        (lambda box: model.values_of(request, box)) if workers is None else Shipped(model, request)
    )
    return _streamed(
        model, request, path, cut, make, lambda sha256: model.recipe(request, sha256), workers=workers
    )


def _as_a_whole(
    model: Model,
    request: Request,
    path: Location,
    cut: BlockPlan,
    workers: Workers | None,
    *,
    memory: int | None,
    chunks: int | None,
    scratch: Path | None,
) -> Result:
    """All of it in scratch files, then from these into a store."""
    left, identity = _left_by(model, request, path), model.identity(request)
    plan = plan_whole(model, request, available_memory() if memory is None else memory, cut.chunk)
    pages = plan.memory["pages"]
    if workers is not None:
        pages = pages_of(plan, at_once=workers.at_once, each=workers.memory)
    folder = _scratch_of(path, scratch, identity, left)
    whole = Whole(model, request, folder, memory=pages, thickest=chunks, workers=workers)
    grown = path.growing()
    whole.begin(plan.scratch, state=grown.path if isinstance(grown, Folder) else None)
    complete = (
        left.fields["recipe"][-1].get("report", {}) if left is not None and left.complete else None
    )

    def recipe(sha256: str) -> Recipe:
        report = {} if not sha256 else whole.report if complete is None else complete
        return model.recipe(request, sha256, report)

    written = _streamed(
        model, request, path, cut, whole.box, recipe, meanwhile={_SCRATCH: os.fspath(folder)}
    )
    whole.remove()
    return written


_SCRATCH = "scratch"  # in an unfinished store: where its scratch files are


def _scratch_of(
    path: Location, chosen: Path | None, identity: str, left: Unfinished | None
) -> Path:
    """Where scratch files of a result go: into the folder that was chosen, now or when it was
    begun, or beside it.
    """
    if chosen is not None:  # where another result of the same name may have its own
        return chosen.absolute() / f"{path.beside('').name}.{identity[:8]}.scratch"
    recorded = None if left is None else left.fields.get(_SCRATCH)
    return path.beside(".scratch") if recorded is None else Path(recorded)


def _streamed(
    model: Model,
    request: Request,
    path: Location,
    cut: BlockPlan,
    make: Callable[[Box], np.ndarray],
    recipe: Callable[[str], Recipe],
    *,
    workers: Workers | None = None,
    meanwhile: Mapping[str, Any] | None = None,
) -> Result:
    """Boxes into a store, with the recipe by the digest of its voxels, and until it is finished
    with what is said `meanwhile`.
    """
    fields = model.fields(request)
    plain = {
        name: list(value) if isinstance(value, tuple) else value for name, value in fields.items()
    }

    def describe(sha256: str) -> dict[str, Any]:
        return {
            **plain,
            **({} if sha256 or meanwhile is None else meanwhile),
            "recipe": recipe(sha256).to_json(),
        }

    volume = StoredVolume(
        shape=request.shape,
        dtype=model.dtype,
        make=make,
        describe=describe,
        identity=model.identity(request),
        scale=fields["spacing"],
        unit=long_name(fields["unit"]),
        labels=fields["kind"] == "labels",
        channels=3 if fields["kind"] == "colour" else 0,
    )
    sha256 = stream(volume, path, side=cut.side, chunk=cut.chunk, workers=workers)
    return Result(path_or_remote(path), request.shape, outline(request.shape, **fields), recipe(sha256))
