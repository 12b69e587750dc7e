"""From a model to a file: in memory where the result fits, else block by block into a store, by this process or by workers."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING

from trabecula.core.errors import InputError, MemoryBudgetError, RequestError
from trabecula.core.image import outline
from trabecula.core.recipe import Recipe
from trabecula.core.request import Request
from trabecula.engine import checkpoint
from trabecula.engine.blocks import Volume, stream
from trabecula.engine.plan import Plan, available_memory, check_budget, format_bytes
from trabecula.engine.store import CHUNK, Unfinished, open_unfinished
from trabecula.engine.trial import seconds_of, seconds_of_whole
from trabecula.io import files
from trabecula.io.formats import suffix_of
from trabecula.io.units import long_name
from trabecula.synth.base import Model
from trabecula.synth.shipped import Shipped
from trabecula.synth.whole import Whole
from trabecula.synth.windows import WindowModel

if TYPE_CHECKING:
    from trabecula.engine.cluster import Cluster, Workers

CHUNKS = (16, 1024)
"""Edges that a store's chunks may have, voxels; a multiple of the first."""


@dataclass(frozen=True)
class Written:
    """A result that is in a file.

    Attributes
    ----------
    path : Path
    shape : tuple of int
    text : str
        What it is, in a line.
    recipe : Recipe
    sha256 : str
        Of its voxels.
    """

    path: Path
    shape: tuple[int, ...]
    text: str
    recipe: Recipe

    @property
    def sha256(self) -> str:
        """Digest of the voxels."""
        return str(self.recipe.steps[-1]["sha256"])


@dataclass(frozen=True)
class Cut:
    """How a volume is cut: edges of the blocks that are made and of the chunks that are written, voxels."""

    side: int
    chunk: int


def part_of(path: str | os.PathLike[str]) -> Path:
    """Where the state of an unfinished run is kept: beside its result, as rock.zarr.part of rock.zarr."""
    target = Path(path).absolute()
    return target.with_name(target.name + ".part")


def generate_to(
    model: Model,
    request: Request,
    path: str | os.PathLike[str],
    *,
    memory: int | None = None,
    chunks: int | None = None,
    cluster: Cluster | None = None,
    scratch: str | os.PathLike[str] | None = None,
) -> Written:
    """Make material into a file. A run that was interrupted goes on from what it left beside it.

    Parameters
    ----------
    model : Model
    request : Request
    path : path
        The suffix chooses the format. Into a Zarr store goes what does not fit into the budget as well, with the same voxels: a
        model of an unlimited material (a `WindowModel`) makes it block by block, another in scratch files.
    memory : int, optional
        Budget in bytes, of all workers together where there are any. Default: what the machine has available.
    chunks : int, optional
        Make it in blocks of this edge, voxels, whatever its size: a multiple of 16 from 16 to 1024, and the edge of the
        store's chunks. Default: blocks as large as fit, in chunks of 128.
    cluster : Cluster, optional
        Workers that make the blocks.
    scratch : path, optional
        Folder for scratch files. Default: that of the result.

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
    with _workers(cluster, memory) as workers:
        cut = cut_for(model, request, path, memory=memory, chunks=chunks, workers=workers)
        if cut is not None:
            place = None if scratch is None else Path(scratch)
            return _streamed(model, request, Path(path), cut, workers, memory=memory, chunks=chunks, scratch=place)
    with checkpoint.kept_at(part_of(path)):
        material = model.generate(request, memory=memory)
        files.write(material, path)
    return Written(Path(path), material.shape, repr(material), material.recipe)


def cut_for(
    model: Model,
    request: Request,
    path: str | os.PathLike[str],
    *,
    memory: int | None = None,
    chunks: int | None = None,
    workers: Workers | None = None,
) -> Cut | None:
    """How a run cuts its volume; None where it makes everything at once. Arguments and errors as of `generate_to`."""
    plan = model.plan(request)
    if not _goes_in_blocks(model):
        return None
    budget = available_memory() if memory is None else memory
    store = suffix_of(os.fspath(path)) == ".zarr"
    left = _left_by(model, request, path) if store else None
    if plan.peak <= budget and left is None and chunks is None and workers is None:
        return None
    if not store:
        check_budget(
            plan, budget=memory, advice="write a .zarr, which is made block by block; ask for a smaller --shape"
        )
        return None
    chunk = chunks or (CHUNK if left is None else left.chunk)
    if not isinstance(model, WindowModel):
        check_budget(
            model.plan_spilled(request, budget), budget=budget, advice="use fewer --threads, ask for a smaller --shape"
        )
        return Cut(chunk, chunk)
    # Of what was begun no larger blocks, of which a part would be made again.
    most = chunk if chunks else model.block if left is None else left.block
    if workers is None:
        return _fitting(model, request, budget, chunk, most)
    return _fitting(model, request, workers.memory or budget, chunk, most, at_once=workers.at_once)


def _fitting(model: WindowModel, request: Request, budget: int, chunk: int, most: int, *, at_once: int = 1) -> Cut:
    """The largest block of an edge up to `most` that fits into the budget and leaves work for all."""
    sides = [*range(most // chunk * chunk, chunk, -chunk), chunk]
    for side in sides:
        enough = at_once == 1 or prod(-(-length // side) for length in request.shape) >= 2 * at_once
        if (enough or side == chunk) and model.plan_block(request, side).peak <= budget:
            return Cut(side, chunk)
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
    """Forecast of `generate_to`; with `trial` of its seconds too, from volumes or boxes that are made for about a second."""
    _check_in_blocks(model, path, chunks, None)
    cut = cut_for(model, request, path, memory=memory, chunks=chunks) if os.fspath(path) else None
    if cut is None:
        plan = model.plan(request)
    elif isinstance(model, WindowModel):
        plan = model.plan_block(request, cut.side)
    else:
        plan = model.plan_spilled(request, available_memory() if memory is None else memory)
    seconds = None
    with suppress(RequestError):  # settings with which no box can be made alone, no small volume
        if trial and isinstance(model, WindowModel):
            side = model.block if cut is None else cut.side
            seconds = seconds_of(lambda box: model.values_of(request, box), request.shape, side)
        elif trial and not request.is_tied:
            seconds = seconds_of_whole(lambda shape: model.generate(replace(request, shape=shape)), request.shape)
    return replace(plan, seconds=seconds)


def _check_in_blocks(model: Model, path: str | os.PathLike[str], chunks: int | None, cluster: Cluster | None) -> None:
    """Raise where chunks or workers are asked for and there is nothing to be cut."""
    if chunks is None and cluster is None:
        return
    option = "--chunks" if cluster is None else "workers"
    if not _goes_in_blocks(model):
        what = "colour volumes" if model.spills else "volumes"
        raise InputError(
            f"method {model.spec.name!r} makes {what} in memory, {option} are for what is made in blocks: leave them out"
        )
    if suffix_of(os.fspath(path)) != ".zarr":
        raise InputError(f"{option} are for what is made in blocks, into a .zarr: leave them out, or write a .zarr")
    if chunks is not None and (chunks % CHUNKS[0] or not CHUNKS[0] <= chunks <= CHUNKS[1]):
        raise InputError(f"--chunks {chunks} should be a multiple of {CHUNKS[0]} from {CHUNKS[0]} to {CHUNKS[1]}")


def _goes_in_blocks(model: Model) -> bool:
    return isinstance(model, WindowModel) or (model.spills and model.facts[0].kind != "colour")


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
    part = part_of(path)
    left = open_unfinished(part) if part.is_dir() else None
    return left if left is not None and left.identity == model.identity(request) else None


def _streamed(
    model: Model,
    request: Request,
    path: Path,
    cut: Cut,
    workers: Workers | None,
    *,
    memory: int | None,
    chunks: int | None,
    scratch: Path | None,
) -> Written:
    fields = model.fields(request)
    plain = {name: list(value) if isinstance(value, tuple) else value for name, value in fields.items()}
    whole = None
    if isinstance(model, WindowModel):
        make = (lambda box: model.values_of(request, box)) if workers is None else Shipped(model, request)
    else:
        pages = model.plan_spilled(request, available_memory() if memory is None else memory).memory["pages"]
        if workers is not None and workers.memory is not None:
            pages = min(pages, workers.memory * workers.at_once)
        whole = Whole(model, request, _scratch_of(path, scratch), memory=pages, thickest=chunks, hands=workers)
        make, workers = whole.box, None

    def recipe(sha256: str) -> Recipe:
        return model.recipe(request, sha256, None if whole is None or not sha256 else whole.report)

    volume = Volume(
        shape=request.shape,
        dtype=model.dtype,
        make=make,
        describe=lambda sha256: {**plain, "recipe": recipe(sha256).to_json()},
        identity=model.identity(request),
        scale=fields["spacing"],
        unit=long_name(fields["unit"]),
        labels=fields["kind"] == "labels",
    )
    sha256 = stream(volume, path, part=part_of(path), side=cut.side, chunk=cut.chunk, hands=workers)
    written = Written(path, request.shape, outline(request.shape, **fields), recipe(sha256))
    if whole is not None:
        whole.remove()
    return written


def _scratch_of(path: Path, folder: Path | None) -> Path:
    """Where scratch files of a result go."""
    name = Path(path).absolute().name + ".scratch"
    return Path(path).absolute().with_name(name) if folder is None else folder / name
