"""Resuming an interrupted run from what it left beside its result."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trabecula.core.errors import FileError, NotReproducedError
from trabecula.core.image import describe_fields, outline
from trabecula.core.progress import notify
from trabecula.core.recipe import Recipe, versions
from trabecula.core.request import Request
from trabecula.engine import checkpoint
from trabecula.engine.storage.location import Folder, Location, location_of, path_or_remote
from trabecula.engine.store import open_finished, open_unfinished
from trabecula.io import files
from trabecula.pipeline.generate import Result, generate_to
from trabecula.pipeline.out_of_core import clear_scratch
from trabecula.pipeline.replay import model_and_request
from trabecula.synth.api.method import Model

if TYPE_CHECKING:
    from trabecula.engine.cluster import Cluster


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
        target, model, as for `rerun`.

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
    step = _interrupted_step(target)
    model, request = model_and_request(step, folder=target.folder, **moved)
    _check_same_run(model, request, target, step)
    return generate_to(model, request, target, memory=memory, cluster=cluster, scratch=scratch)


def _is_finished(target: Location) -> bool:
    part = target.growing()
    if isinstance(part, Folder):
        return target.is_there() and not part.is_there()
    # At an address the unfinished store is in the place of the result.
    unfinished = open_unfinished(part)
    return part.is_store() and (unfinished is None or unfinished.complete)


def _describe_result(target: Location) -> Result:
    """Describe what a finished run made; the voxels of a store are not read.

    Raises
    ------
    FileError
        It was not made by `generate_to`.
    """
    if target.is_store():
        opened = open_finished(target)
        fields, shape = dict(opened.fields), tuple(opened.array.shape)
        recipe = Recipe.from_json(fields.get("recipe"))
    else:
        image = files.read(target)
        fields, shape = dict(describe_fields(image)), image.shape
        recipe = image.recipe
    if not recipe or recipe.steps[-1]["verb"] != "generate":
        raise FileError(f"{target} was not made by generate: there is nothing to resume")
    notify(f"{target.name} is finished: there is nothing to resume")
    text = outline(shape, **{name: fields[name] for name in ("kind", "spacing", "unit", "phases")})
    return Result(path_or_remote(target), shape, text, recipe)


def _interrupted_step(target: Location) -> Mapping[str, Any]:
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
