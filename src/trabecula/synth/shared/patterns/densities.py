"""Densities of patterns, and how they change with the local fraction: those of denser and sparser
places of the exemplar.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np

from trabecula.engine.chunking import boxes_of, slices_of
from trabecula.synth.shared.patterns.counts import Bins, Patterns

_BEYOND = 1.25
"""How far a fraction may be from the exemplar's, over the farthest that windows of it are."""

NEAREST = 0.01
"""Of a fraction that any exemplar has."""


@dataclass(frozen=True)
class PatternDensities:
    """Densities (bins,) of the exemplars, and by how much they rise with the fraction of the second
    phase; `below` and `above` the exemplars' `fraction` they are known.
    """

    bins: Bins
    own: np.ndarray
    slopes: np.ndarray | None = None
    fraction: float = 0.0
    below: float = 0.0
    above: float = 0.0

    @classmethod
    def of(
        cls, exemplars: Sequence[np.ndarray], count: int, *, balls: bool = False
    ) -> PatternDensities:
        """Measure exemplars, phases (Z, Y, X) uint8 below `count`, without slopes."""
        whole = reduce(add, (Patterns.of(phases, count, balls=balls) for phases in exemplars))
        return cls(whole.bins, whole.densities)

    @classmethod
    def by_fraction(
        cls, exemplars: Sequence[np.ndarray], count: int, width: int
    ) -> PatternDensities:
        """Measure windows of exemplars, and with them the slopes."""
        windows, fractions, bins = [], [], Bins(count)
        for phases in exemplars:
            boxes = boxes_of(phases.shape, width)
            windows += Patterns.by_kind(phases, bins, boxes, np.arange(len(boxes)))
            fractions += [float(np.mean(phases[slices_of(box)] == 1)) for box in boxes]
        whole = reduce(add, windows)
        sizes = np.array([window.rooms[bins.rooms[bins.neighbours]] for window in windows], float)
        mean = float(np.average(fractions, weights=sizes))
        far = np.array(fractions) - mean
        own = whole.densities
        slopes = np.zeros(bins.total)
        for window, apart in zip(windows, far, strict=True):
            slopes += apart * (window.counts - own * window.rooms[bins.rooms])
        rooms = sum(
            np.square(apart) * window.rooms for window, apart in zip(windows, far, strict=True)
        )
        slopes /= np.maximum(rooms[bins.rooms], 1e-9)
        return cls(bins, own, slopes, mean, float(-far.min()), float(far.max()))

    @property
    def euler(self) -> np.ndarray:
        """Return the Euler numbers a voxel, as `Bins.euler` numbers them."""
        bins = self.bins
        return bins.euler @ self.own[bins.cubes : bins.cubes + bins.combinations]

    def with_chords(self, along: Sequence[np.ndarray | None]) -> PatternDensities:
        """Return them with other chords along some axes, (bins of an axis,) each."""
        own = self.own.copy()
        chords = own[: self.bins.cubes].reshape(3, -1)
        for axis, found in enumerate(along):
            if found is not None:
                chords[axis] = found
        return replace(self, own=own)

    def without_balls(self) -> PatternDensities:
        """Return those of the other patterns."""
        return replace(self, bins=Bins(self.bins.phases), own=self.own[: self.bins.balls])

    def at(self, fraction: float) -> np.ndarray | None:
        """Return the densities of places with a fraction of the second phase; None where the
        exemplar tells nothing about them.
        """
        assert self.slopes is not None  # learnt `by_fraction`
        more = fraction - self.fraction
        if not -max(_BEYOND * self.below, NEAREST) <= more <= max(_BEYOND * self.above, NEAREST):
            return None
        return np.asarray(np.maximum(self.own + more * self.slopes, 0))
