"""Ensembles in files: one a member, made in several processes, and a manifest of all.

The same command resumes where an interrupted one stopped: members whose file has the recipe of
their request are kept, one that was begun resumes from its own state. A volume that members are
parts of is a store beside them until all of them are written.
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
from trabecula.engine.files import remove, replacing
from trabecula.engine.memory import available_memory
from trabecula.engine.parallel import thread_count, threads
from trabecula.engine.storage import is_address
from trabecula.io import files
from trabecula.pipeline.ensemble import Member, Members
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


def member_path(pattern: str, seed: int) -> Path:
    """Return the place of a member's file."""
    return Path(pattern.replace(SEED, str(seed)))


def _volume_path(pattern: str, seed: int) -> Path:
    """Return the place of a volume that members are parts of: beside the first of these."""
    first = member_path(pattern, seed)
    return first.with_name(f"{first.stem}-volume.zarr")


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
    paths = {member.seed: member_path(pattern, member.seed) for member in members.members}
    for path in paths.values():
        path.parent.mkdir(parents=True, exist_ok=True)
    found: dict[int, Result] = {}
    left = []
    for request, parts in members.volumes():
        for member in parts:
            known = find_result(model, request, paths[member.seed], cut=_step_of(member))
            if known is not None:
                found[member.seed] = known
        missing = [member for member in parts if member.seed not in found]
        if missing:
            left.append(_Volume(request, _volume_path(pattern, request.seed), missing, paths))
    if found:
        progress.notify(f"{len(found)} of {len(paths)} members are there already")
    manifest = manifest_path(pattern)
    for results in progress.track(_make(model, left, memory, blocks), "members", total=len(left)):
        found |= results
        _write_manifest(manifest, model, members, paths, found)
    done = _write_manifest(manifest, model, members, paths, found)
    return StoredEnsemble(manifest, tuple(done))


@dataclass(frozen=True)
class _Volume:
    """What is made at once: a member, or a volume that several are parts of.

    Attributes
    ----------
    request : Request
    place : Path
        Of the volume while its members are not all written.
    members : list of Member
        That are to be written.
    paths : mapping
        Seed -> place of a member.
    """

    request: Request
    place: Path
    members: list[Member]
    paths: Mapping[int, Path]

    def make(self, model: Model, **given: Any) -> dict[int, Result]:
        """Make it, and write its members."""
        first = self.members[0]
        if first.corner is None:
            made = generate_to(model, self.request, self.paths[first.seed], **given)
            return {first.seed: made}
        if find_result(model, self.request, self.place) is None:
            generate_to(model, self.request, self.place, **given)
        volume, found = files.read(self.place), {}
        for member in self.members:
            part, path = member.cut(volume), self.paths[member.seed]
            files.write(part, path)
            found[member.seed] = Result(path, part.shape, repr(part), part.recipe)
        remove(self.place)
        return found


def _step_of(member: Member) -> Mapping[str, Any] | None:
    """Return the step of a member's recipe that cuts it out of its volume."""
    if member.corner is None:
        return None
    return {"verb": "crop", "size": list(member.shape), "corner": list(member.corner)}


def _make(
    model: Model, left: list[_Volume], memory: int | None, blocks: Mapping[str, Any]
) -> Iterator[dict[int, Result]]:
    """Make members, here or in processes, and yield those of each volume when they are there."""
    if not left:
        return
    at_once = 1 if blocks.get("cluster") else _at_once(model, left, memory)
    if at_once == 1:
        for volume in left:
            yield volume.make(model, memory=memory, **blocks)
        return
    budget = (available_memory() if memory is None else memory) // at_once
    share = max(1, thread_count() // at_once)
    data = model.to_bytes(history=dict(model.history), versions=versions())
    given = {name: value for name, value in blocks.items() if value is not None}
    context = get_context("spawn")  # threads and locks do not survive a fork
    pool = ProcessPoolExecutor(at_once, context, _open_model, (data, model.name, share))
    try:
        working = [pool.submit(_make_volume, one, {"memory": budget, **given}) for one in left]
        for one in as_completed(working):
            yield one.result()
    finally:
        pool.shutdown(cancel_futures=True)


def _at_once(model: Model, left: list[_Volume], memory: int | None) -> int:
    """Return how many fit beside each other, 1 at least."""
    budget = available_memory() if memory is None else memory
    fitting = int(budget // max(1, model.plan(left[0].request).peak))
    return max(1, min(thread_count(), fitting, len(left)))


_worker: dict[str, Any] = {}  # of a process that makes members: its model and threads


def _open_model(data: bytes, name: str | None, share: int) -> None:
    """Restore the model in a process."""
    model = decode_model(data, Path(name or "the model that was sent"))
    model.name = name
    _worker.update(model=model, threads=share)


def _make_volume(volume: _Volume, given: Mapping[str, Any]) -> dict[int, Result]:
    """Make members of one volume, in a process that has the model."""
    with threads(_worker["threads"]):
        return volume.make(_worker["model"], **given)


def _write_manifest(
    place: Path,
    model: Model,
    members: Members,
    paths: Mapping[int, Path],
    found: Mapping[int, Result],
) -> list[Result]:
    """Write which members there are, and return them."""
    done = [one for one in members.members if one.seed in found]
    text = json.dumps(
        {
            "method": model.capabilities.name,
            "shape": list(members.members[0].shape),
            "count": len(paths),
            "fractions": None if members.spread is None else members.spread.to_json(),
            "note": members.note or None,
            "members": [
                {
                    "file": os.path.relpath(paths[one.seed], place.parent),
                    "seed": one.seed,
                    "volume": _volume_of(one),
                    "target": dict(one.request.target),
                    "sha256": found[one.seed].sha256,
                }
                for one in done
            ],
            "versions": versions(),
        },
        indent=1,
    )
    with replacing(place) as temporary:
        temporary.write_text(text)
    return [found[one.seed] for one in done]


def _volume_of(member: Member) -> dict[str, Any] | None:
    """Return what a member is a part of; None where it is the whole."""
    if member.corner is None:
        return None
    return {
        "seed": member.request.seed,
        "shape": list(member.request.shape),
        "corner": list(member.corner),
    }
