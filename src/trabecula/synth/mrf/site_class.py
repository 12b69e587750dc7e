"""The sites that a sweep asks at once, plane by plane, and how work on them is shared out."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs, sum_slabs
from trabecula.synth.mrf.colouring import Classes, Name

T = TypeVar("T")

_FEW = 1 << 14
"""Sites of which light work is done before threads have begun."""

_MANY = 1 << 22
"""Voxels of which some may be resident wherever they lie."""

_SMALL = 1 << 20
"""Bytes of an array that is not worth a file."""

_ENOUGH = 256
"""Sites that are worth a thread where each has a density."""


@dataclass
class Members:
    """The sites of a class that are to be asked: found anew wherever they are needed, since their
    places would take more room than their levels do.

    `temperature` (Z, Y, X) float32, `held` bool: only sites that are warm or held are asked;
    without entries where that is nobody's business.
    """

    classes: Classes
    name: Name
    temperature: np.ndarray
    held: np.ndarray

    def sites(self, first: int, last: int) -> np.ndarray:
        """Flat places in the planes first .. last, rising."""
        sites = self.classes.sites(self.name, first, last)
        if not self.temperature.size:
            return sites
        warm = self.temperature.reshape(-1)[sites] > 0
        if self.held.size:
            warm |= self.held.reshape(-1)[sites]
        return sites[warm]

    @property
    def depth(self) -> int:
        """Planes of the lattice."""
        return self.classes.lattice.shape[0]

    @cached_property
    def starts(self) -> tuple[np.ndarray, np.ndarray]:
        """How many sites lie before each plane, and of these how many in the result: twice (Z + 1,)
        int64.
        """
        lattice = self.classes.lattice
        plane, counts = lattice.shape[1] * lattice.shape[2], np.zeros((2, self.depth + 1), np.int64)

        def work(first: int, last: int) -> None:
            sites = self.sites(first, last)
            z = sites // plane - first
            counts[0, first + 1 : last + 1] = np.bincount(z, minlength=last - first)
            counts[1, first + 1 : last + 1] = np.bincount(
                z[lattice.asks_for(sites)], minlength=last - first
            )

        if lattice.levels.size > _MANY:
            for_slabs(work, self.depth)
        else:
            work(0, self.depth)
        before, within = counts.cumsum(axis=1)
        return before, within

    @property
    def count(self) -> int:
        """How many there are."""
        return int(self.starts[0][-1])

    @property
    def asked(self) -> int:
        """How many of them lie in the result."""
        return int(self.starts[1][-1])

    @property
    def _are_few(self) -> bool:
        return self.count < _FEW and self.classes.lattice.levels.size <= _MANY

    def room(self, shape: Sequence[int], dtype: Any) -> np.ndarray:
        """An array of rows for sites, for `dear_over` to write; in memory where it is small: every
        visit has some.
        """
        small = self._are_few and math.prod(shape) * np.dtype(dtype).itemsize < _SMALL
        return np.empty(tuple(shape), dtype) if small else memmap.empty(shape, dtype, least=0)

    def over(self, work: Callable[[int, int], object]) -> None:
        """Light work on planes of them."""
        if self._are_few:
            work(0, self.depth)
        else:
            for_slabs(work, self.depth, least=self._planes(_FEW))

    def sum_over(self, work: Callable[[int, int], T]) -> T:
        """The sum of whole numbers over planes of them."""
        return (
            work(0, self.depth)
            if self._are_few
            else sum_slabs(work, self.depth, least=self._planes(_FEW))
        )

    def dear_over(self, work: Callable[[int, int], object]) -> None:
        """Dear work on planes of them, which other processes may do; it writes slabs of what `room`
        gave.
        """
        for_slabs(work, self.depth, least=self._planes(_ENOUGH), anywhere=not self._are_few)

    def _planes(self, sites: int) -> int:
        """Planes that hold so many sites."""
        return max(1, self.depth * sites // max(1, self.count))


def over_rows(work: Callable[[int, int], object], rows: int) -> None:
    """Light work on rows of numbers, one for each site."""
    if rows < _FEW:
        work(0, rows)
    else:
        for_slabs(work, rows, least=_FEW)


def sum_over_rows(work: Callable[[int, int], T], rows: int) -> T:
    """The sum of whole numbers over rows."""
    return work(0, rows) if rows < _FEW else sum_slabs(work, rows, least=_FEW)


def room_for_rows(rows: int) -> np.ndarray:
    """A whole number for every row (int64); in memory where that is little."""
    return np.empty(rows, np.int64) if rows < _FEW else memmap.empty(rows, np.int64)
