"""From a model to a file: in memory where the result fits, else block by block into a store, by
this process or by workers; and the same from where an interrupted run stopped.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trabecula.core import progress
from trabecula.core.errors import FileError, NotReproducedError
from trabecula.core.image import describe_fields, outline
from trabecula.core.recipe import Recipe, versions
from trabecula.core.request import Request
from trabecula.engine import checkpoint
from trabecula.engine.blocks import Box, StoredVolume, stream
from trabecula.engine.memory import available_memory
from trabecula.engine.storage import Folder, Location, Remote, location_of, path_or_remote
from trabecula.engine.store import Unfinished, open_finished, open_unfinished
from trabecula.io import files
from trabecula.io.units import long_name
from trabecula.pipeline.out_of_core import ScratchVolume, clear_scratch, pages_of, plan_whole
from trabecula.pipeline.plan import (
    BlockPlan,
    budget_for,
    check_block_options,
    choose_blocks,
    find_unfinished,
)
from trabecula.pipeline.replay import model_and_request
from trabecula.synth.api.method import Model
from trabecula.synth.api.serialize import WorkerPayload
from trabecula.synth.api.windows import WindowModel, makes_boxes

if TYPE_CHECKING:
    from trabecula.engine.cluster import Cluster, Workers

_ITS_OWN = ("sha256", "versions", "report")  # of a step: no part of the request
_MAKING = 0.95  # of the time of a run: the rest is writing
_SCRATCH = "scratch"  # field of an unfinished store: the folder of its scratch files


@dataclass(frozen=True)
class Result:
    """A result that is stored in a file.

    Attributes
    ----------
    path : Path, or Remote at an address
    shape : tuple of int
    text : str
        A description in one line.
    recipe : Recipe
    """

    path: Path | Remote
    shape: tuple[int, ...]
    text: str
    recipe: Recipe

    @property
    def sha256(self) -> str:
        """Return the digest of the voxels."""
        return str(self.recipe.steps[-1]["sha256"])


def partial_path(path: str | os.PathLike[str]) -> Path:
    """Return the place of an unfinished run's state, beside its result: rock.zarr.part of
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
    """Make material into a file. An interrupted run is resumed from its state beside the file.

    Parameters
    ----------
    model : Model
    request : Request
    path : path or address
        The suffix chooses the format. A Zarr store also takes what does not fit into the budget,
        with the same voxels: a model of an unlimited material (a `WindowModel`) makes it block by
        block, another in scratch files, or in memory and then block by block.
    memory : int, optional
        Budget in bytes, of all workers together where there are any. Default: what the machine has
        available.
    chunks : int, optional
        Make it in blocks of this edge, voxels, whatever its size: a multiple of 16 from 16 to 1024,
        and the edge of the store's chunks. Default: blocks as large as fit, in chunks of 128.
    cluster : Cluster, optional
        Workers that make the blocks.
    scratch : path, optional
        Folder for scratch files. Default: that of the result; of one at an address the working
        directory.

    Raises
    ------
    MemoryBudgetError
        The forecast exceeds the budget.
    FileError
        The file cannot be written, or another run's state is in its place.
    InputError
        Chunks or workers for what is not made in blocks: of another method, or in another format.
    ClusterError
        The workers or their scheduler do not answer.
    """
    check_block_options(model, path, chunks, cluster)
    memory = budget_for(path, memory)
    with _connect(cluster, memory) as workers:
        blocks = choose_blocks(model, request, path, memory=memory, chunks=chunks, workers=workers)
        if blocks is not None:
            run = _BlockRun(model, request, location_of(path), blocks, workers)
            if makes_boxes(model):
                return _write_windows(run, model)
            return _write_out_of_core(
                run,
                memory=memory,
                chunks=chunks,
                scratch=None if scratch is None else Path(scratch),
            )
    if scratch is not None:
        progress.notify("no scratch files are needed: it is made in memory")
    return _write_in_memory(model, request, path, memory)


@dataclass(frozen=True)
class _BlockRun:
    """A run that writes a store block by block."""

    model: Model
    request: Request
    path: Location
    blocks: BlockPlan
    workers: Workers | None


def _write_in_memory(
    model: Model, request: Request, path: str | os.PathLike[str], memory: int | None
) -> Result:
    target = path_or_remote(path)
    if isinstance(target, Remote):
        target.check_free()
    with checkpoint.kept_at(None if isinstance(target, Remote) else partial_path(path)):
        with progress.part(0, _MAKING):
            material = model.generate(request, memory=memory)
        files.write(material, path)
    return Result(target, material.shape, repr(material), material.recipe)


def _write_windows(run: _BlockRun, model: WindowModel) -> Result:
    """Make each block alone, into a store."""
    request = run.request

    def make_here(box: Box) -> np.ndarray:
        return model.values_of(request, box)

    make = make_here if run.workers is None else WorkerPayload(model, request)
    return _stream(run, make, lambda sha256: model.recipe(request, sha256), workers=run.workers)


def _write_out_of_core(
    run: _BlockRun, *, memory: int | None, chunks: int | None, scratch: Path | None
) -> Result:
    """Make the whole volume in scratch files, then copy it from these into a store."""
    model, request = run.model, run.request
    unfinished = find_unfinished(model, request, run.path)
    budget = available_memory() if memory is None else memory
    plan = plan_whole(model, request, budget, run.blocks.chunk)
    pages = plan.memory["pages"]
    if run.workers is not None:
        pages = pages_of(plan, at_once=run.workers.at_once, each=run.workers.memory)
    folder = _scratch_folder(run.path, scratch, model.identity(request), unfinished)
    volume = ScratchVolume(
        model, request, folder, memory=pages, thickest=chunks, workers=run.workers
    )
    part = run.path.growing()
    volume.prepare(plan.scratch, state=part.path if isinstance(part, Folder) else None)
    # Once all blocks are in the store, the scratch files and their report may be gone.
    stored_report = None
    if unfinished is not None and unfinished.complete:
        stored_report = unfinished.fields["recipe"][-1].get("report", {})

    def recipe(sha256: str) -> Recipe:
        if not sha256:
            return model.recipe(request, sha256, {})
        report = volume.report if stored_report is None else stored_report
        return model.recipe(request, sha256, report)

    span = progress.current_span()

    def box_of(box: Box) -> np.ndarray:
        with progress.part(0, _MAKING, of=span):  # the first box takes the making of all
            return volume.box(box)

    result = _stream(run, box_of, recipe, unfinished_fields={_SCRATCH: os.fspath(folder)})
    volume.remove()
    return result


def _scratch_folder(
    path: Location, chosen: Path | None, identity: str, unfinished: Unfinished | None
) -> Path:
    """Return the folder of a result's scratch files: in the folder that was chosen, now or when the
    run began, or beside the result.
    """
    if chosen is not None:  # where another result of the same name may have its own
        return chosen.absolute() / f"{path.beside('').name}.{identity[:8]}.scratch"
    recorded = None if unfinished is None else unfinished.fields.get(_SCRATCH)
    return path.beside(".scratch") if recorded is None else Path(recorded)


def _stream(
    run: _BlockRun,
    make: Callable[[Box], np.ndarray],
    recipe: Callable[[str], Recipe],
    *,
    workers: Workers | None = None,
    unfinished_fields: Mapping[str, Any] | None = None,
) -> Result:
    """Write boxes into a store.

    Parameters
    ----------
    run : _Run
    make : callable
        Box -> its values.
    recipe : callable
        SHA-256 of the voxels, empty until they are known -> Recipe.
    workers : Workers, optional
        Workers that call `make`.
    unfinished_fields : mapping, optional
        Fields that the store has until it is finished.
    """
    model, request, blocks = run.model, run.request, run.blocks
    fields = model.fields(request)
    plain = {
        name: list(value) if isinstance(value, tuple) else value for name, value in fields.items()
    }

    def describe(sha256: str) -> dict[str, Any]:
        more = {} if sha256 else dict(unfinished_fields or {})
        return {**plain, **more, "recipe": recipe(sha256).to_json()}

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
    sha256 = stream(volume, run.path, side=blocks.side, chunk=blocks.chunk, workers=workers)
    text = outline(request.shape, **fields)
    return Result(path_or_remote(run.path), request.shape, text, recipe(sha256))


@contextmanager
def _connect(cluster: Cluster | None, memory: int | None) -> Iterator[Workers | None]:
    """Connect to the workers of a cluster, if there is one."""
    if cluster is None:
        yield None
        return
    from trabecula.engine.cluster import workers_of

    budget = available_memory() if memory is None and cluster.workers is not None else memory
    with workers_of(cluster, memory=budget) as workers:
        yield workers


def resume(
    path: str | os.PathLike[str],
    *,
    memory: int | None = None,
    cluster: Cluster | None = None,
    scratch: str | os.PathLike[str] | None = None,
    **moved: Any,
) -> Result:
    """Resume the run that was making a file when it was interrupted; describe a finished file.

    Parameters
    ----------
    path : path
        The result, or the unfinished one beside it (rock.zarr or rock.zarr.part).
    memory, cluster :
        As of `generate_to`; they need not be those with which the run began.
    scratch : path, optional
        As of `generate_to`. Default: that with which the run began.
    **moved : path
        The files that the run started from, where they have moved: exemplar, mask, fixed, known,
        coarse, target, model, as for `rerun`.

    Raises
    ------
    FileError
        There is no run to resume.
    NotReproducedError
        The exemplar, a part of the request or the versions are not those of the run.
    """
    target = location_of(os.fspath(path).removesuffix(".part"))
    if _is_finished(target):
        # Of a run that was killed after its last block and before it removed them.
        clear_scratch(target.beside(".scratch"))
        return _describe_result(target)
    step = _find_step(target)
    model, request = model_and_request(step, folder=target.folder, **moved)
    _check_same_run(model, request, target, step)
    return generate_to(model, request, target, memory=memory, cluster=cluster, scratch=scratch)


def find_result(
    model: Model,
    request: Request,
    path: str | os.PathLike[str],
    *,
    cut: Mapping[str, Any] | None = None,
) -> Result | None:
    """Describe the file of a run that is finished; None where there is none, or that of another
    run.

    Parameters
    ----------
    model : Model
    request : Request
    path : path
    cut : mapping, optional
        What the step of the recipe has that cut the file's part out of the result. Default: the
        file holds the whole.
    """
    target = location_of(path)
    if not target.is_there() or not _is_finished(target):
        return None
    try:
        result = _read_file(target)
    except FileError:  # damaged, or not ours: it is made anew
        return None
    asked = [model.recipe(request, "").steps[-1], *([] if cut is None else [cut])]
    steps = result.recipe.steps[-len(asked) :]
    same = len(steps) == len(asked) and all(
        step.get(name) == value
        for step, wanted in zip(steps, asked, strict=True)
        for name, value in wanted.items()
        if name not in _ITS_OWN
    )
    return result if same else None


def _is_finished(target: Location) -> bool:
    part = target.growing()
    if isinstance(part, Folder):
        return target.is_there() and not part.is_there()
    # At an address the unfinished store is in the place of the result.
    unfinished = open_unfinished(part)
    return part.is_store() and (unfinished is None or unfinished.complete)


def _describe_result(target: Location) -> Result:
    """Describe what a finished run made, and say so."""
    result = _read_result(target)
    progress.notify(f"{target.name} is finished: there is nothing to resume")
    return result


def _read_result(target: Location) -> Result:
    """Describe what a finished run made; the voxels of a store are not read.

    Raises
    ------
    FileError
        It was not made by `generate_to`.
    """
    result = _read_file(target)
    if not result.recipe or result.recipe.steps[-1]["verb"] != "generate":
        raise FileError(f"{target} was not made by generate: there is nothing to resume")
    return result


def _read_file(target: Location) -> Result:
    """Describe a file and its recipe; the voxels of a store are not read."""
    if target.is_store():
        opened = open_finished(target)
        fields, shape = dict(opened.fields), tuple(opened.array.shape)
        recipe = Recipe.from_json(fields.get("recipe"))
    else:
        image = files.read(target)
        fields, shape = dict(describe_fields(image)), image.shape
        recipe = image.recipe
    text = outline(shape, **{name: fields[name] for name in ("kind", "spacing", "unit", "phases")})
    return Result(path_or_remote(target), shape, text, recipe)


def _find_step(target: Location) -> Mapping[str, Any]:
    """Return the recipe's step of the run that was interrupted.

    Raises
    ------
    FileError
        There is none, or nothing records it.
    """
    part = target.growing()
    if not part.is_there():
        raise FileError(
            f"there is nothing to resume: no run that makes {target} was interrupted "
            f"(no {part.name})"
        )
    unfinished = open_unfinished(part)
    steps = [] if unfinished is None else unfinished.fields.get("recipe", [])
    if steps and steps[-1]["verb"] != "generate":
        verb = steps[-1]["verb"]
        raise FileError(
            f"{part} was left by {verb}: the same command (trabecula {verb} ...) resumes it"
        )
    if steps:
        return steps[-1]
    step = (
        checkpoint.step_in(part.path) if isinstance(part, Folder) and part.path.is_file() else None
    )
    if step is None:
        raise FileError(
            f"{part} does not say which run left it: give the whole command again, or remove it"
        )
    return step


def _check_same_run(
    model: Model, request: Request, target: Location, step: Mapping[str, Any]
) -> None:
    """Raise where the unfinished result is not of this model and request, which were made again
    from its step.
    """
    part = target.growing()
    unfinished = open_unfinished(part)
    identity = checkpoint.identity_in(Path(part)) if unfinished is None else unfinished.identity
    if identity == model.identity(request):
        return
    here, recorded = versions(), dict(step.get("versions") or {})
    differ = [
        f"{name} {number}, here {here.get(name)}"
        for name, number in recorded.items()
        if here.get(name) != number
    ]
    why = "its exemplar or a part of its request is another now"
    if differ:
        why = f"it was made with {', '.join(differ)}"
    raise NotReproducedError(
        f"{part.name} cannot be resumed, its voxels might not fit: {why}; give what it began "
        "with, or remove it"
    )
