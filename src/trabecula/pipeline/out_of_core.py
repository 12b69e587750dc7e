"""Volumes that are made as a whole and do not fit into memory: made in scratch files, then read box
by box.
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

_HEADROOM = 3
"""Slabs are sized for one part in this many of the bytes that may be resident: a system maps more
pages than are touched.
"""

_COPY_BYTES = 1 << 24
_RESULT = "made.json"  # names the file of the voxels, once they are all made
_STATE = "state"  # the checkpoint of a run that still makes them


def plan_whole(model: Model, request: Request, budget: int, chunk: int) -> Plan:
    """Forecast making a request in scratch files within a budget of bytes, and writing it in blocks
    of `chunk` voxels.
    """
    plan = model.plan_mapped(request, budget)
    numbers = 3 if model.fields(request)["kind"] == "colour" else 1
    block = numbers * part_bytes(
        request.shape, [min(chunk, side) for side in request.shape], model.dtype
    )
    # Writing begins when making is over, so it may use the same bytes.
    short = block - plan.memory["pages"] - plan.memory["slab"]
    return plan if short <= 0 else replace(plan, memory={**plan.memory, "block": short})


def pages_of(plan: Plan, *, at_once: int, each: int | None) -> int:
    """Return the bytes of scratch files that may be resident.

    Parameters
    ----------
    plan : Plan
        Of `plan_whole`.
    at_once : int
        Slabs that workers work on at the same time.
    each : int, optional
        Bytes of memory of a worker, where it is known.

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
            f"a worker needs about {format_bytes(own)} of memory beside its slab, "
            f"{format_bytes(max(0, each))} may be used: use fewer --workers, larger ones, "
            "or raise --memory"
        )
    return min(pages, (each - own) * at_once)


class ScratchVolume:
    """The volume of a request in scratch files; reading the first box makes all of it.

    The files stay in their folder until `remove`, so that a run that was killed resumes from its
    last checkpoint, or from the finished voxels.

    Parameters
    ----------
    model : Model
        One whose large volumes are "memmap" or "memory".
    request : Request
    folder : Path
    memory : int
        Bytes that may be resident of the scratch files and of what is worked on.
    thickest : int, optional
        Planes that are worked on at once, at most.
    workers : MappedWorkers, optional
        Processes that do the work, where it is not this one alone.
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
        self._model, self._request = model, request
        self._folder = folder
        self._limits: dict[str, Any] = {
            "memory": memory // _HEADROOM,
            "thickest": thickest,
            "workers": workers,
        }
        self._result: tuple[memmap.MappedFile, Mapping[str, Any]] | None = None

    @property
    def report(self) -> Mapping[str, Any]:
        """Return what the method reports of making the voxels (plain JSON)."""
        return self._make_once()[1]

    def box(self, box: Box) -> np.ndarray:
        """Return the values of a box."""
        values = memmap.open_file(self._make_once()[0])
        return np.array(values[slices_of(box)])

    def prepare(self, size: int, *, state: Path | None = None) -> None:
        """Check that there is room for `size` bytes; take over the checkpoint of a run in memory.

        Parameters
        ----------
        size : int
        state : Path, optional
            File of the checkpoint; another run's is left alone.

        Raises
        ------
        FileError
            Too little room.
        """
        identity = self._model.identity(self._request)
        if state is not None and checkpoint.identity_in(state) == identity:
            self._folder.mkdir(parents=True, exist_ok=True)
            shutil.move(state, self._folder / _STATE)
        if self._find_result() is not None:
            return
        existing = self._folder
        while not existing.exists():
            existing = existing.parent
        own = sum(file.stat().st_size for file in self._folder.glob("*.raw"))
        free = shutil.disk_usage(existing).free + own
        if free < size:
            raise FileError(
                f"cannot make the volume in {self._folder}: about {size >> 20} MiB of scratch "
                f"files are needed, {free >> 20} MiB are free; make room, or choose another "
                "folder with --scratch"
            )

    def remove(self) -> None:
        """Remove the scratch files."""
        remove(self._folder)

    def _make_once(self) -> tuple[memmap.MappedFile, Mapping[str, Any]]:
        if self._result is None:
            found = self._find_result()
            if found is not None:
                notify("all voxels are made: only writing them is left")
            self._result = found or self._make()
        return self._result

    def _find_result(self) -> tuple[memmap.MappedFile, Mapping[str, Any]] | None:
        """Return the voxels that an earlier run made and their report; None where it made not all
        of them.
        """
        try:
            recorded = json.loads((self._folder / _RESULT).read_text(encoding="utf-8"))
            path = self._folder / str(recorded["file"])
            shape, strides = tuple(recorded["shape"]), tuple(recorded["strides"])
            file = memmap.MappedFile(path, recorded["dtype"], shape, strides)
            count = int(np.prod(shape, dtype=np.int64))
            whole = path.stat().st_size == np.dtype(file.dtype).itemsize * count
            same = recorded["identity"] == self._model.identity(self._request)
            return (file, recorded["report"]) if whole and same else None
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def _make(self) -> tuple[memmap.MappedFile, Mapping[str, Any]]:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            with (
                hold_lock(self._folder / _STATE),
                checkpoint.kept_at(self._folder / _STATE),
                memmap.map_large_arrays(self._folder, **self._limits),
            ):
                for lost in self._folder.glob("*.raw"):  # of a run that was killed
                    lost.unlink()
                values, report = self._model.compute(self._request)
                return self._record(values, report), report
        except OSError as error:
            if isinstance(error, TrabeculaError):
                raise
            raise FileError(
                f"cannot write to {self._folder}: {error.strerror or error}; the volume is made "
                "there before it is written: make room, or choose another folder with --scratch; "
                "the same run resumes from its last state"
            ) from error

    def _record(self, values: np.ndarray, report: Mapping[str, Any]) -> memmap.MappedFile:
        """Keep the file of the voxels, and record that they are all made."""
        try:
            file = memmap.keep_file(values)
        except ValueError:  # in memory, or a part of another array
            file = memmap.keep_file(_copy_to_scratch(values))
        record = {"file": file.path.name, **asdict(file), "report": report}
        record.pop("path")
        record["identity"] = self._model.identity(self._request)
        with replacing(self._folder / _RESULT) as temporary:
            temporary.write_text(json.dumps(record), encoding="utf-8")
        return file


def clear_scratch(folder: Path) -> None:
    """Remove the scratch files of a volume that is written; leave any other folder alone."""
    if (folder / _RESULT).is_file():
        remove(folder)


def _copy_to_scratch(values: np.ndarray) -> np.ndarray:
    own = memmap.empty(values.shape, values.dtype, least=0)
    thick = max(1, _COPY_BYTES * len(values) // max(1, values.nbytes))
    for first in range(0, len(values), thick):
        own[first : first + thick] = values[first : first + thick]
        memmap.release_pages()
    return own
