"""Ensembles in files: one a member, made in several processes, and a manifest of all.

The same command resumes where an interrupted one stopped: members whose file has the recipe of
their request are kept, one that was begun resumes from its own state.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from trabecula.core import progress
from trabecula.core.errors import InputError
from trabecula.core.recipe import versions
from trabecula.core.request import Request
from trabecula.engine.files import replacing
from trabecula.engine.memory import available_memory
from trabecula.engine.parallel import thread_count, threads
from trabecula.engine.storage import is_address
from trabecula.pipeline.ensemble import Members
from trabecula.pipeline.generate import Result, find_result, generate_to
from trabecula.synth.api.model import Model
from trabecula.synth.api.serialize import decode_model

SEED = "{seed}"
"""The place of a member's seed in the name of its file."""

_NAME = "ensemble"  # in the manifest's name, in the place of the seed


@dataclass(frozen=True)
class StoredEnsemble:
    """The files of an ensemble.

    Attributes
    ----------
    manifest : Path
    members : tuple of Result
        In the order of their seeds.
    """

    manifest: Path
    members: tuple[Result, ...]

    def read(self) -> dict[str, Any]:
        """Return what the manifest says."""
        found: dict[str, Any] = json.loads(self.manifest.read_text())
        return found


def check_pattern(pattern: str) -> None:
    """Raise where the name of the members' files has no place for the seed, or is an address."""
    if SEED not in pattern:
        raise InputError(
            f"--out {pattern} names one file for all members: put {SEED} into it, such as "
            f"DIR/{SEED}.zarr"
        )
    if is_address(pattern):
        raise InputError(
            f"--out {pattern} is an address: an ensemble is written into files; copy them there"
        )


def member_path(pattern: str, request: Request) -> Path:
    """Return the place of a member's file."""
    return Path(pattern.replace(SEED, str(request.seed)))


def manifest_path(pattern: str) -> Path:
    """Return the place of the manifest: the pattern with "ensemble" for the seed, and .json."""
    return Path(pattern.replace(SEED, _NAME)).with_suffix(".json")


def generate_members(
    model: Model,
    members: Members,
    pattern: str,
    *,
    memory: int | None = None,
    **blocks: Any,
) -> StoredEnsemble:
    """Make an ensemble into files, as many members at once as there are threads and as fit.

    Parameters
    ----------
    model : Model
    members : Members
    pattern : str
        Path of a member's file, with {seed} in the place of its seed.
    memory : int, optional
        Budget in bytes of all that are made at once. Default: what the machine has available.
    **blocks
        Chunks, cluster and scratch of `generate_to`. With a cluster members are made one after the
        other.

    Raises
    ------
    InputError, FileError
        As `check_pattern` and `generate_to`.
    """
    check_pattern(pattern)
    paths = [member_path(pattern, request) for request in members.requests]
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
    found = {
        path: find_result(model, request, path)
        for path, request in zip(paths, members.requests, strict=True)
    }
    left = [
        (request, path)
        for request, path in zip(members.requests, paths, strict=True)
        if found[path] is None
    ]
    if len(left) < len(paths):
        progress.notify(f"{len(paths) - len(left)} of {len(paths)} members are there already")
    manifest = manifest_path(pattern)
    for path, result in progress.track(
        _make(model, left, memory, blocks), "members", total=len(left)
    ):
        found[path] = result
        _write_manifest(manifest, model, members, paths, found)
    done = _write_manifest(manifest, model, members, paths, found)
    return StoredEnsemble(manifest, tuple(done))


def _make(
    model: Model,
    left: list[tuple[Request, Path]],
    memory: int | None,
    blocks: Mapping[str, Any],
) -> Iterator[tuple[Path, Result]]:
    """Make members, here or in processes, and yield each when it is there."""
    if not left:
        return
    at_once = 1 if blocks.get("cluster") else _at_once(model, left, memory)
    if at_once == 1:
        for request, path in left:
            yield path, generate_to(model, request, path, memory=memory, **blocks)
        return
    budget = (available_memory() if memory is None else memory) // at_once
    share = max(1, thread_count() // at_once)
    data = model.to_bytes(history=dict(model.history), versions=versions())
    given = {name: value for name, value in blocks.items() if value is not None}
    context = get_context("spawn")  # threads and locks do not survive a fork
    pool = ProcessPoolExecutor(at_once, context, _open_model, (data, model.name, share))
    try:
        working = {
            pool.submit(_make_member, request, path, {"memory": budget, **given}): path
            for request, path in left
        }
        for one in as_completed(working):
            yield working[one], one.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _at_once(model: Model, left: list[tuple[Request, Path]], memory: int | None) -> int:
    """Return how many members fit beside each other, 1 at least."""
    budget = available_memory() if memory is None else memory
    fitting = int(budget // max(1, model.plan(left[0][0]).peak))
    return max(1, min(thread_count(), fitting, len(left)))


_worker: dict[str, Any] = {}  # of a process that makes members: its model and threads


def _open_model(data: bytes, name: str | None, share: int) -> None:
    """Restore the model in a process."""
    model = decode_model(data, Path(name or "the model that was sent"))
    model.name = name
    _worker.update(model=model, threads=share)


def _make_member(request: Request, path: Path, given: Mapping[str, Any]) -> Result:
    """Make one member, in a process that has the model."""
    with threads(_worker["threads"]):
        return generate_to(_worker["model"], request, path, **given)


def _write_manifest(
    place: Path,
    model: Model,
    members: Members,
    paths: list[Path],
    found: Mapping[Path, Result | None],
) -> list[Result]:
    """Write which members there are, and return them."""
    pairs = zip(members.requests, paths, strict=True)
    done = [(one, path, result) for one, path in pairs if (result := found[path]) is not None]
    text = json.dumps(
        {
            "method": model.capabilities.name,
            "shape": list(members.requests[0].shape),
            "count": len(paths),
            "fractions": None if members.spread is None else members.spread.to_json(),
            "note": members.note or None,
            "members": [
                {
                    "file": os.path.relpath(path, place.parent),
                    "seed": request.seed,
                    "target": dict(request.target),
                    "sha256": result.sha256,
                }
                for request, path, result in done
            ],
            "versions": versions(),
        },
        indent=1,
    )
    with replacing(place) as temporary:
        temporary.write_text(text)
    return [result for _, _, result in done]
