"""Checkpoints of long runs: a loop offers its state between rounds, and the same run resumes from
it.

`kept_at` names the file, `running` declares the run (no other run uses its checkpoint), and a loop
calls `resume` before it starts and `offer` after every round. Without a file nothing is written or
read. A checkpoint is written at most every `EVERY` seconds, under a temporary name that is then
renamed, and is removed once the result is safe.

The result does not depend on an interruption as long as a round is a function of the arrays and
numbers in the state: random numbers come from seed, stage and round (core.seeds), so nothing else
has to be kept.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from glob import escape
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.errors import FileError
from trabecula.core.image import Image, describe_fields
from trabecula.core.progress import notify
from trabecula.core.recipe import digest, versions
from trabecula.core.request import Request
from trabecula.engine.files import UNREADABLE, read_npz, replacing, write_npz
from trabecula.engine.lock import hold_lock

EVERY = 15.0
"""Seconds between two states, at least."""

_SHARE = 20
"""A state that takes long to write is written so rarely that writing takes at most one part in this
many of the run.
"""

_ABOUT = "about"
_PREFIX = "state."  # so that no array's name collides with ours


@dataclass(frozen=True)
class Checkpoint:
    """The state of a loop after some rounds.

    Attributes
    ----------
    number : int
        Rounds that were done.
    arrays : dict of str to array
        What was offered after them; the caller's to write into.
    """

    number: int
    arrays: dict[str, np.ndarray]


@dataclass
class _Keeper:
    """The checkpoint file of a run, and when it is written next."""

    path: Path
    identity: str = ""
    step: Mapping[str, Any] = field(default_factory=dict)  # the request, as a recipe says it
    # what an earlier run's checkpoint says of itself, until it is used
    found: dict[str, Any] | None = None
    ours: bool = False  # the file on disk is a checkpoint of this run
    pause: float = 0.0
    saved: float = field(default_factory=time.monotonic)


_keeper: ContextVar[_Keeper | None] = ContextVar("trabecula_checkpoint", default=None)


@contextmanager
def kept_at(path: str | os.PathLike[str] | None) -> Iterator[None]:
    """Keep the state of what runs inside the block in the file `path`; None keeps nothing.

    The file is removed when the block ends without an error, so write the result inside it. A file
    of that name that another run left is replaced once there is a state to keep; one that is no
    state at all is left as it is.

    Raises
    ------
    FileError
        Another process keeps its state there.

    Examples
    --------
    >>> from trabecula.engine.checkpoint import kept_at
    >>> with kept_at(None):
    ...     pass  # material = model.generate(240); tb.write(material, "rock.zarr")
    """
    if path is None:
        yield
        return
    # Where its folder is still to be made nobody has left or keeps anything.
    with (
        hold_lock(Path(path)) if Path(path).absolute().parent.is_dir() else nullcontext(),
        _keeping(Path(path).absolute()),
    ):
        yield


@contextmanager
def _keeping(path: Path) -> Iterator[None]:
    keeper = _Keeper(path)
    token = _keeper.set(keeper)
    try:
        yield
    except KeyboardInterrupt:
        # else it is for whoever named the place to say
        if keeper.ours and keeper.path.suffix == ".part":
            result = keeper.path.name.removesuffix(".part")
            notify(
                f"interrupted: the same run resumes from {keeper.path.name} (generate --resume "
                f"{result})"
            )
        raise
    finally:
        _keeper.reset(token)
    if keeper.ours:  # and what a run that was killed in the middle of writing left
        unfinished = keeper.path.parent.glob(f".????????-{escape(keeper.path.name)}")
        for file in (keeper.path, *unfinished):
            with suppress(OSError):
                file.unlink(missing_ok=True)


@contextmanager
def running(
    method: str,
    settings: Mapping[str, Any],
    request: Request,
    exemplars: Sequence[Image],
    *,
    step: Callable[[], Mapping[str, Any]] = dict,
) -> Iterator[None]:
    """Declare the run inside the block: only a checkpoint of exactly the same run is used.

    `step` gives the request as plain JSON, for who finds the checkpoint (`step_in`).
    """
    keeper = _keeper.get()
    if keeper is None:
        yield
        return
    keeper.identity = identity_of(method, settings, request, exemplars)
    keeper.found = _find_own(keeper)
    keeper.step = step()
    try:
        yield
    finally:
        keeper.identity, keeper.found = "", None
        keeper.step = {}


def step_in(path: Path) -> dict[str, Any] | None:
    """Read the request of the run whose checkpoint is in a file; None where nothing tells."""
    return _about(path).get("step") or None


def identity_in(path: Path) -> str | None:
    """Read the identity of the run whose checkpoint is in a file; None where nothing tells."""
    return _about(path).get("identity")


def _about(path: Path) -> dict[str, Any]:
    """Read identity, stage, number and step of a checkpoint; nothing of a file that is none."""
    if not path.is_file():  # a pipe would be waited for
        return {}
    try:
        with np.load(path, allow_pickle=False) as stored:
            about = json.loads(bytes(stored[_ABOUT]))
            return {
                "identity": str(about["identity"]),
                "stage": str(about["stage"]),
                "number": int(about["number"]),
                "step": dict(about.get("step") or {}),
            }
    except UNREADABLE:
        return {}


def resume(stage: str) -> Checkpoint | None:
    """Return the checkpoint that an interrupted run of the same kind left in `stage`, or None: then
    the loop starts from nothing.

    There is one state, the last; with several stages ask for the last stage first. A damaged file
    is left aside, with a word.
    """
    keeper = _keeper.get()
    if keeper is None or keeper.found is None or keeper.found["stage"] != stage:
        return None
    number, keeper.found = int(keeper.found["number"]), None
    try:
        arrays = read_npz(keeper.path, _PREFIX)
    except UNREADABLE as error:
        notify(f"{keeper.path.name} is damaged ({error}): starting from the beginning")
        return None
    notify(f"resuming from {keeper.path.name}: {stage}, {number} rounds done")
    return Checkpoint(number, arrays)


def due() -> bool:
    """Return whether `offer` would write now, for a state that is expensive to put together."""
    keeper = _keeper.get()
    return (
        keeper is not None
        and bool(keeper.identity)
        and time.monotonic() - keeper.saved >= max(EVERY, keeper.pause)
    )


def offer(stage: str, number: int, /, **arrays: Any) -> None:
    """Write a checkpoint after `number` rounds of `stage`, where one is due.

    Parameters
    ----------
    stage : str
        Name of the loop.
    number : int
        Rounds done.
    **arrays : array or number
        All that the next round starts from. Not changed, and not held after the call.

    Notes
    -----
    Where the place cannot be written (a full disk) the run continues without checkpoints, with a
    word.
    """
    keeper = _keeper.get()
    if keeper is None or not due():
        return
    start = time.monotonic()
    try:
        about = {"identity": keeper.identity, "stage": stage, "number": number, "step": keeper.step}
        _write(keeper, about, arrays)
    except FileError as error:
        notify(f"the run cannot be resumed if it is interrupted: {error}")
        keeper.pause = math.inf
        return
    keeper.found, keeper.ours = None, True
    keeper.saved = time.monotonic()
    keeper.pause = _SHARE * (keeper.saved - start)


def _write(keeper: _Keeper, about: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    members = {_PREFIX + name: np.asarray(array) for name, array in arrays.items()}
    members[_ABOUT] = np.frombuffer(json.dumps(about).encode(), np.uint8)
    with replacing(keeper.path) as temporary:
        write_npz(temporary, members)


def _find_own(keeper: _Keeper) -> dict[str, Any] | None:
    """Return stage and number of the checkpoint on disk, where it is whole and of this run."""
    if not keeper.path.exists():
        return None
    about = _about(keeper.path)
    if not about:
        # Checkpoints are put in place whole: one that cannot be read is another program's file.
        notify(
            f"{keeper.path.name} is no state of a run, and is left as it is: this run cannot be "
            "resumed"
        )
        keeper.pause = math.inf
        return None
    if about["identity"] != keeper.identity:
        notify(f"{keeper.path.name} was left by another run: starting from the beginning")
        return None
    keeper.ours = True
    return about


def identity_of(
    method: str, settings: Mapping[str, Any], request: Request, exemplars: Sequence[Image]
) -> str:
    """Return the SHA-256 of everything that the voxels depend on."""
    parts = {
        "method": method,
        "settings": settings,
        "shape": request.shape,
        "seed": request.seed,
        "periodic": request.periodic,
        "arrays": [
            None if part is None else digest(part) for part in (request.mask, request.known)
        ],
        "target": {name: digest(np.asarray(value)) for name, value in request.target.items()},
        "images": [
            None if image is None else _image_identity(image)
            for image in (request.fixed, *exemplars)
        ],
        "versions": versions(),
    }
    if request.coarse is not None:  # named only then: unfinished runs of before resume
        parts["coarse"] = _image_identity(request.coarse)
    if request.like is not None:
        parts["like"] = _image_identity(request.like)
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=repr).encode()).hexdigest()


def _image_identity(image: Image) -> list[Any]:
    fields = {name: value for name, value in describe_fields(image).items() if name != "recipe"}
    return [fields, digest(image.values)]
