"""A volume that its method makes as a whole and that does not fit into memory: made in scratch files, then read box by box."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.errors import FileError
from trabecula.core.progress import say
from trabecula.core.request import Request
from trabecula.engine import checkpoint, scratch
from trabecula.engine.blocks import Box, slices_of
from trabecula.engine.files import remove, replacing
from trabecula.synth.base import Model

_FULL = 5
"""Pages take one part in this many of what may be resident: work on a slab takes more than the slab."""

_AT_ONCE = 1 << 24


class Whole:
    """The volume of a request, of which boxes can be had: the first makes all of it.

    What is made lies in a folder until `remove`, so that a run that was killed goes on from its last state, or where it ended
    from the voxels.

    Parameters
    ----------
    model : Model
        That `spills`.
    request : Request
    folder : Path
    memory : int
        Bytes that may be resident of the scratch files and of what is worked on.
    thickest : int, optional
        Planes that are worked on at once, at most.
    hands : scratch.Hands, optional
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
        hands: scratch.Hands | None = None,
    ) -> None:
        self._model, self._request, self._folder = model, request, folder
        self._spilled: dict[str, Any] = {"memory": memory // _FULL, "thickest": thickest, "hands": hands}
        self._made: tuple[scratch.Place, Mapping[str, Any]] | None = None

    @property
    def report(self) -> Mapping[str, Any]:
        """What there is to tell of how the voxels came to be (plain JSON)."""
        return self._finished()[1]

    def box(self, box: Box) -> np.ndarray:
        """The values of a box."""
        values = scratch.opened(self._finished()[0])
        return np.array(values[slices_of(box)])

    def remove(self) -> None:
        """Remove the scratch files."""
        remove(self._folder)

    def _finished(self) -> tuple[scratch.Place, Mapping[str, Any]]:
        if self._made is None:
            self._made = self._left() or self._all()
        return self._made

    @property
    def _told(self) -> Path:
        return self._folder / "made.json"

    def _left(self) -> tuple[scratch.Place, Mapping[str, Any]] | None:
        """What an earlier run made, where it ended."""
        try:
            told = json.loads(self._told.read_text(encoding="utf-8"))
            place = scratch.Place(
                self._folder / "values.raw", told["dtype"], tuple(told["shape"]), tuple(told["strides"])
            )
            size = place.path.stat().st_size
        except (OSError, ValueError, KeyError, TypeError):
            return None
        whole = size == np.dtype(place.dtype).itemsize * int(np.prod(place.shape, dtype=np.int64))
        if not whole or told["identity"] != self._model.identity(self._request):
            return None
        say("all voxels are made: going on with writing them")
        return place, told["report"]

    def _all(self) -> tuple[scratch.Place, Mapping[str, Any]]:
        """Make everything."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            for lost in self._folder.glob("*.raw"):  # of a run that was killed
                lost.unlink()
            kept = checkpoint.kept_at(self._folder / "state")
            with kept, scratch.spilled(self._folder, **self._spilled):
                values, report = self._model.made(self._request)
                return self._kept(values, report), report
        except OSError as error:
            if isinstance(error, FileError):
                raise
            raise FileError(
                f"cannot write to {self._folder}: {error.strerror or error}; the volume is made there before it is written: "
                "make room, or choose another folder with --scratch; the same run goes on from its last state"
            ) from error

    def _kept(self, values: np.ndarray, report: Mapping[str, Any]) -> scratch.Place:
        """The voxels as a file that stays."""
        if not values.flags.c_contiguous or scratch.place_of(values) is None:
            values = _copied(values)
        place = scratch.kept(values, self._folder / "values.raw")
        told = {**asdict(place), "path": place.path.name, "report": report}
        told["identity"] = self._model.identity(self._request)
        with replacing(self._told) as temporary:
            temporary.write_text(json.dumps(told), encoding="utf-8")
        return place


def _copied(values: np.ndarray) -> np.ndarray:
    """Values in a scratch file of their own."""
    own = scratch.empty(values.shape, values.dtype, least=0)
    thick = max(1, _AT_ONCE * len(values) // max(1, values.nbytes))
    for first in range(0, len(values), thick):
        own[first : first + thick] = values[first : first + thick]
        scratch.let_go()
    return own
