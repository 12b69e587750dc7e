"""A volume that its method makes as a whole and that does not fit into memory: made in scratch
files, then read box by box.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.errors import FileError, MemoryBudgetError, TrabeculaError
from trabecula.core.progress import notify
from trabecula.core.request import Request
from trabecula.engine import checkpoint, memmap
from trabecula.engine.blocks import Box, part_bytes, slices_of
from trabecula.engine.files import remove, replacing
from trabecula.engine.lock import hold_lock
from trabecula.engine.memory import Plan, format_bytes
from trabecula.synth.api.method import Model

_FULL = 3
"""Arrays are cut for one part in this many of what may be resident: a system maps more pages than
are touched.
"""

_AT_ONCE = 1 << 24


def plan_whole(model: Model, request: Request, budget: int, chunk: int) -> Plan:
    """Forecast of making a request in scratch files within a budget of bytes, and writing it in
    blocks of `chunk` voxels.
    """
    plan = model.plan_mapped(request, budget)
    numbers = 3 if model.fields(request)["kind"] == "colour" else 1
    block = numbers * part_bytes(
        request.shape, [min(chunk, side) for side in request.shape], model.dtype
    )
    short = block - plan.memory["pages"] - plan.memory["slab"]  # writing comes when making is over
    return plan if short <= 0 else replace(plan, memory={**plan.memory, "block": short})


def pages_of(plan: Plan, *, at_once: int, each: int | None) -> int:
    """Bytes that may be resident where so many slabs are worked on `at_once`, by workers that have
    `each` so many bytes.

    Raises
    ------
    MemoryBudgetError
        Nothing is left of a worker's memory for its slab.
    """
    pages = plan.memory["pages"]
    if each is None:
        return pages
    own = plan.memory["interpreter and kernels"] + plan.memory["slab"]
    if each <= own:
        raise MemoryBudgetError(
            f"a worker needs about {format_bytes(own)} of memory beside its slab, {format_bytes(max(0, each))} may be used: use "
            "fewer --workers, larger ones, or raise --memory"
        )
    return min(pages, (each - own) * at_once)


class Whole:
    """The volume of a request, of which boxes can be had: the first makes all of it.

    What is made lies in a folder until `remove`, so that a run that was killed goes on from its
    last state, or where it ended from the voxels.

    Parameters
    ----------
    model : Model
        Whose large volumes are "memmap" or "memory".
    request : Request
    folder : Path
    memory : int
        Bytes that may be resident of the scratch files and of what is worked on.
    thickest : int, optional
        Planes that are worked on at once, at most.
    workers : memmap.MappedWorkers, optional
        Who does the work, where it is not this process alone.
    """

    def __init__(
        self,
        model: Model,
        request: Request,
        folder: Path,
        *,
        memory: int,
        thickest: int | None = None,
        workers: memmap.MappedWorkers | None = None,
    ) -> None:
        self._model, self._request, self._folder = model, request, folder
        self._spilled: dict[str, Any] = {
            "memory": memory // _FULL,
            "thickest": thickest,
            "workers": workers,
        }
        self._made: tuple[memmap.MappedFile, Mapping[str, Any]] | None = None

    @property
    def report(self) -> Mapping[str, Any]:
        """What there is to tell of how the voxels came to be (plain JSON)."""
        return self._finished()[1]

    def box(self, box: Box) -> np.ndarray:
        """The values of a box."""
        values = memmap.open_file(self._finished()[0])
        return np.array(values[slices_of(box)])

    def begin(self, size: int, *, state: Path | None = None) -> None:
        """See that there is room for `size` bytes, and take over the state that a run in memory
        left in a file.

        Raises
        ------
        FileError
            There is not.
        """
        if state is not None and checkpoint.identity_in(state) == self._model.identity(
            self._request
        ):
            self._folder.mkdir(parents=True, exist_ok=True)
            shutil.move(state, self._folder / _STATE)
        if self._left() is not None:
            return
        there = self._folder
        while not there.exists():
            there = there.parent
        free = shutil.disk_usage(there).free + sum(
            file.stat().st_size for file in self._folder.glob("*.raw")
        )
        if free < size:
            raise FileError(
                f"cannot make the volume in {self._folder}: about {size >> 20} MiB of scratch files are needed, {free >> 20} MiB "
                "are free; make room, or choose another folder with --scratch"
            )

    def remove(self) -> None:
        """Remove the scratch files."""
        remove(self._folder)

    def _finished(self) -> tuple[memmap.MappedFile, Mapping[str, Any]]:
        if self._made is None:
            found = self._left()
            if found is not None:
                notify("all voxels are made: going on with writing them")
            self._made = found or self._all()
        return self._made

    def _left(self) -> tuple[memmap.MappedFile, Mapping[str, Any]] | None:
        """What an earlier run made, where it ended."""
        try:
            told = json.loads((self._folder / _MADE).read_text(encoding="utf-8"))
            path = self._folder / str(told["file"])
            place = memmap.MappedFile(
                path, told["dtype"], tuple(told["shape"]), tuple(told["strides"])
            )
            whole = path.stat().st_size == np.dtype(place.dtype).itemsize * int(
                np.prod(place.shape, dtype=np.int64)
            )
            same = told["identity"] == self._model.identity(self._request)
            return (place, told["report"]) if whole and same else None
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def _all(self) -> tuple[memmap.MappedFile, Mapping[str, Any]]:
        """Make everything."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with (
                hold_lock(self._folder / _STATE),
                checkpoint.kept_at(self._folder / _STATE),
                memmap.map_large_arrays(self._folder, **self._spilled),
            ):
                for lost in self._folder.glob("*.raw"):  # of a run that was killed
                    lost.unlink()
                values, report = self._model.compute(self._request)
                return self._kept(values, report), report
        except OSError as error:
            if isinstance(error, TrabeculaError):
                raise
            raise FileError(
                f"cannot write to {self._folder}: {error.strerror or error}; the volume is made there before it is written: "
                "make room, or choose another folder with --scratch; the same run goes on from its last state"
            ) from error

    def _kept(self, values: np.ndarray, report: Mapping[str, Any]) -> memmap.MappedFile:
        """The voxels as a file that stays."""
        try:
            place = memmap.keep_file(values)
        except ValueError:  # in memory, or a part of another array
            place = memmap.keep_file(_copied(values))
        told = {"file": place.path.name, **asdict(place), "report": report}
        told.pop("path")
        told["identity"] = self._model.identity(self._request)
        with replacing(self._folder / _MADE) as temporary:
            temporary.write_text(json.dumps(told), encoding="utf-8")
        return place


_MADE, _STATE = "made.json", "state"


def clear_scratch(folder: Path) -> None:
    """Remove the scratch files of a volume that is written; a folder that is none of ours stays."""
    if (folder / _MADE).is_file():
        remove(folder)


def _copied(values: np.ndarray) -> np.ndarray:
    """Values in a scratch file of their own."""
    own = memmap.empty(values.shape, values.dtype, least=0)
    thick = max(1, _AT_ONCE * len(values) // max(1, values.nbytes))
    for first in range(0, len(values), thick):
        own[first : first + thick] = values[first : first + thick]
        memmap.release_pages()
    return own
