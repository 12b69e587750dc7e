"""Going on with a run that was interrupted, from what it left beside its result."""

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
from trabecula.pipeline.replay import asked
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
    """Go on with the run that was making a file when it was interrupted; of a file that is
    finished, tell what it is.

    Parameters
    ----------
    path : path
        The result, or the unfinished one beside it (rock.zarr or rock.zarr.part).
    memory, cluster :
        As of `generate_to`; they need not be those that the run began with.
    scratch : path, optional
        As of `generate_to`. Default: that with which the run began.
    **moved : path
        Where the files that the run started from lie now, if they have moved: exemplar, mask,
        fixed, known, target, model, as for `rerun`.

    Raises
    ------
    FileError
        There is nothing to go on from.
    NotReproducedError
        The exemplar, a part of the request or the versions are not those of the run.
    """
    target = location_of(os.fspath(path).removesuffix(".part"))
    if _is_finished(target):
        clear_scratch(
            target.beside(".scratch")
        )  # of a run that was killed between writing the last block and removing them
        return _finished(target)
    step = _begun(target)
    model, request = asked(step, folder=target.folder, **moved)
    _check_same_run(model, request, target, step)
    return generate_to(model, request, target, memory=memory, cluster=cluster, scratch=scratch)


def _is_finished(target: Location) -> bool:
    grown = target.growing()
    if isinstance(grown, Folder):
        return target.is_there() and not grown.is_there()
    left = open_unfinished(grown)
    return grown.is_store() and (left is None or left.complete)


def _begun(target: Location) -> Mapping[str, Any]:
    """What the run that left something was asked for: the step of its recipe.

    Raises
    ------
    FileError
        There is nothing to go on from, or it does not tell.
    """
    part = target.growing()
    if not part.is_there():
        raise FileError(
            f"there is nothing to go on from: no run that makes {target} was interrupted (no {part.name})"
        )
    left = open_unfinished(part)
    steps = [] if left is None else left.fields.get("recipe", [])
    if left is not None and steps:
        if steps[-1]["verb"] != "generate":
            verb = steps[-1]["verb"]
            raise FileError(
                f"{part} was left by {verb}: the same command (trabecula {verb} ...) goes on with it"
            )
        return steps[-1]
    step = checkpoint.step_in(part.path) if isinstance(part, Folder) and part.path.is_file() else None
    if step is not None:
        return step
    raise FileError(
        f"{part} does not tell what run left it: give the whole command again, or remove it"
    )


def _finished(target: Location) -> Result:
    """What lies there, made by a run that has ended; of a store the voxels are not read.

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
        fields, shape, recipe = dict(describe_fields(image)), image.shape, image.recipe
    if not recipe or recipe.steps[-1]["verb"] != "generate":
        raise FileError(f"{target} was not made by generate: there is nothing to go on with")
    notify(f"{target.name} is finished: there is nothing to go on with")
    text = outline(shape, **{name: fields[name] for name in ("kind", "spacing", "unit", "phases")})
    return Result(path_or_remote(target), shape, text, recipe)


def _check_same_run(
    model: Model, request: Request, target: Location, step: Mapping[str, Any]
) -> None:
    """Raise where what was left is not of this model and request, which were made from its step."""
    part = target.growing()
    left = open_unfinished(part)
    identity = checkpoint.identity_in(Path(part)) if left is None else left.identity
    if identity == model.identity(request):
        return
    have, had = versions(), dict(step.get("versions") or {})
    differ = [
        f"{name} {number}, here {have.get(name)}"
        for name, number in had.items()
        if have.get(name) != number
    ]
    why = (
        f"it was made with {', '.join(differ)}"
        if differ
        else "its exemplar or a part of its request is another now"
    )
    raise NotReproducedError(
        f"{part.name} cannot be gone on with, its voxels might not fit: {why}; give what it began with, or remove it"
    )
