"""Counts along the three axes, plane after plane: pairs, segments, and crossings of the
interface.
"""

from __future__ import annotations

import numpy as np

from trabecula.measure.correlation.lagged_counts import (
    count_pairs_ending,
    count_segments_ending,
    pack_lines,
)
from trabecula.measure.thickness import crossings


class LineTally:
    """Pairs and segments of a phase along z, y and x, given plane after plane.

    Parameters
    ----------
    r_max : int
        Longest pair and segment, voxels.
    """

    def __init__(self, r_max: int) -> None:
        self._r_max = r_max
        self._last: np.ndarray | None = None  # packed
        self.pairs = np.zeros((3, r_max + 1))
        """(3, r_max + 1): along every axis, pairs of voxels of the phase r apart."""
        self.segments = np.zeros((3, r_max + 1))
        """(3, r_max + 1): along every axis, rows of r + 1 voxels of the phase."""

    def add(self, inside: np.ndarray) -> None:
        """Take the next planes: a bool array, (planes, Y, X)."""
        rows = pack_lines(inside, 0)
        lines = rows if self._last is None else np.concatenate([self._last, rows])
        self._count(0, lines, len(lines) - len(rows))
        self._last = lines[max(0, len(lines) - self._r_max) :].copy()
        for axis in (1, 2):
            self._count(axis, pack_lines(inside, axis), 0)

    def _count(self, axis: int, lines: np.ndarray, before: int) -> None:
        self.pairs[axis] += count_pairs_ending(lines, lines, self._r_max, before=before)
        self.segments[axis] += count_segments_ending(lines, self._r_max, before=before)


class CrossingTally:
    """Crossings of the interface of a phase by lines along z, y and x, given plane after plane."""

    def __init__(self) -> None:
        self._last: np.ndarray | None = None
        self._crossed = [0, 0, 0]
        self._steps = [0, 0, 0]

    def add(self, inside: np.ndarray) -> None:
        """Take the next planes: a bool array, (planes, Y, X)."""
        self._count(0, inside)
        if self._last is not None:
            self._count(0, np.concatenate([self._last, inside[:1]]))
        self._last = inside[-1:].copy()
        for axis in (1, 2):
            self._count(axis, inside)

    def _count(self, axis: int, inside: np.ndarray) -> None:
        crossed, steps = crossings(inside, None, axis, False)
        self._crossed[axis] += crossed
        self._steps[axis] += steps

    def rates(self, spacing: tuple[float, ...]) -> list[float]:
        """Return the crossings per length along every axis of the image that has steps to cross."""
        along = range(3 - len(spacing), 3)
        return [
            self._crossed[axis] / self._steps[axis] / edge
            for axis, edge in zip(along, spacing, strict=True)
            if self._steps[axis]
        ]
