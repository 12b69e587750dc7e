"""Work pickled for another process: memory-mapped arrays are sent as file names; large arrays in
memory are put into files first.
"""

from __future__ import annotations

import io
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np

from trabecula.engine import memmap

_LARGE = 1 << 20
"""Bytes of an array in memory that is sent by a file: once, not with every piece of work."""


class ReferencedFiles:
    """The files of the arrays that work was sent with."""

    def __init__(self) -> None:
        self._copies: dict[int, tuple[Any, np.ndarray]] = {}

    def dumps(self, work: Callable[..., object]) -> bytes:
        """Return work as bytes that `pickle.loads` reads in a process which sees the scratch
        folder.
        """
        import cloudpickle  # comes with Dask

        places = self

        class Pickler(cloudpickle.Pickler):
            def reducer_override(self, sent: Any) -> Any:
                if type(sent) is np.ndarray:
                    place = places.file_of(sent)
                    if place is not None:
                        return memmap.open_file, (place,)
                return super().reducer_override(sent)

        buffer = io.BytesIO()
        Pickler(buffer).dump(work)
        return buffer.getvalue()

    def file_of(self, array: np.ndarray) -> memmap.MappedFile | None:
        """Return the file of an array; None for one that is better sent itself."""
        place = memmap.file_of(array)
        if place is not None or array.nbytes < _LARGE or array.dtype.hasobject:
            return place
        number = id(array)
        if number not in self._copies:
            copy = memmap.empty(array.shape, array.dtype)
            copy[...] = array
            # The number is another array's as soon as this one is gone.
            self._copies[number] = (
                weakref.ref(array, lambda _: self._copies.pop(number, None)),
                copy,
            )
        return memmap.file_of(self._copies[number][1])
