"""The finest level of a multigrid whose matrix is segments of runs along x."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Protocol

import numpy as np

from trabecula.measure.transport import segments
from trabecula.measure.transport.aggregation import (
    DIRECT,
    GraphLevel,
    RowsPart,
    build_levels,
    coarsen_parts,
)
from trabecula.measure.transport.graph import Graph
from trabecula.numerics.vectors import for_chunks

PART = 1 << 15
"""Slots, at least, of the nodes whose rows are held at once, or those of two planes."""

_NEIGHBOURS = 6


class Segments(Protocol):
    """A table of segments, see `segments`."""

    @property
    def table(self) -> np.ndarray:
        """Return first slot and length, and further columns."""

    @property
    def place(self) -> np.ndarray:
        """Return the voxel of the first."""

    @property
    def slots(self) -> int:
        """Return the number of slots before the zeros."""

    @property
    def length(self) -> int:
        """Return the length of a vector."""


class FinestLevel:
    """The finest level of a multigrid: its coarser one is that of a graph that is not kept.

    Parameters
    ----------
    part : Segments
    rows : callable
        Returns the rows of the nodes of some segments as a Graph: rows(number of the node by slot,
        first segment, last one).
    """

    def __init__(self, part: Segments, rows: Callable[[np.ndarray, int, int], Graph]) -> None:
        self.part = part
        number, nodes = segments.compact_numbers(part.table, part.length)
        self.x = np.zeros(0, np.float32)
        """Where the next result goes: of the part's length, zeros between runs."""
        self.alone: tuple[GraphLevel, np.ndarray] | None = None
        self.aggregate = np.zeros(0, np.int32)
        aggregate, levels = _build_levels(part, partial(rows, number), nodes)
        if aggregate is None:
            self.alone, self.below = (levels[0], np.flatnonzero(number >= 0)), []
        else:
            self.below = levels
            segments.take_by_slot(number, aggregate)
            self.aggregate = number
            self.coarse = np.zeros(len(levels[0].inverse), np.float32)

    def prolong(self, correction: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Add the correction of its aggregate to every node."""
        table = self.part.table
        for_chunks(
            lambda a, b: segments.prolong(table[a:b], self.aggregate, correction, x), len(table)
        )
        return x

    def solve(self, right: np.ndarray) -> np.ndarray:
        """Return the solution where this level is the coarsest as well."""
        assert self.alone is not None
        level, slots = self.alone
        self.x[slots] = level.solve(np.asarray(right[slots], np.float32))
        return self.x


def _build_levels(
    part: Segments, rows: Callable[[int, int], Graph], nodes: int
) -> tuple[np.ndarray | None, list[GraphLevel]]:
    """Return the aggregate of every node, and the levels below the finest; or None, and the finest
    one alone, where it has no coarser one.
    """
    if nodes > DIRECT:
        parts = []
        for a, b in pairwise(_bounds(part)):
            own = int(part.table[a:b, 1].sum())
            parts.append(RowsPart(partial(rows, a, b), own, _NEIGHBOURS * own))
        found = coarsen_parts(parts)
        if found is not None:
            return found[0], build_levels(found[1])
    levels = build_levels(rows(0, len(part.table)))
    return (levels[0].aggregate, levels[1:]) if len(levels) > 1 else (None, levels)


def _bounds(part: Segments) -> list[int]:
    """Return the segments at which parts begin, and their number: no block of 2x2x2 is cut."""
    plane = part.place[:, 0]
    even = np.searchsorted(plane, np.arange(0, int(plane[-1]) + 2, 2))
    slot = part.table[even[:-1], 0]
    bounds = [0]
    last = 0
    for begin, at in zip(even[1:-1].tolist(), slot[1:].tolist(), strict=True):
        if at - last >= PART:
            bounds.append(begin)
            last = at
    return [*bounds, len(part.table)]
