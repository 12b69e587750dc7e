"""How often patterns of labels occur, and how often they could: what new material is held to.

- **Chords**: runs of one phase along each axis, by their length; all that are longer than `REACH`
  together. A run counts where it begins.
- **Cubes** of 2 x 2 x 2 voxels, next to each other and `STRIDES` apart: every combination of
  phases. Surfaces, mean curvature and Euler numbers are sums over the nearest ones (Ohser and
  Muecklich 2000), pairs of voxels in 13 directions over all of them.
- **Neighbours**: how many of the 6, 12 and 8 voxels that share a face, an edge or a corner with a
  voxel have its phase. It tells a smooth interface from a rough one.
- **Balls** (where asked for): how full of a phase balls of two radii are (`balls`).

A pattern that a face of the volume cuts is not counted, and the places where it could lie are
counted beside it, so densities do not depend on the size.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from threading import Lock

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.chunking import Box, boxes_of
from trabecula.engine.parallel import for_each
from trabecula.measure.configurations import cube_euler
from trabecula.synth.shared.patterns.balls import FRACTIONS, RADII, UNIT, count_balls
from trabecula.synth.shared.patterns.kernels import (
    CHORDS,
    MARGIN,
    NEIGHBOURS,
    STRIDES,
    count_patterns,
    load,
)

BLOCK = 40
"""Voxels a side of the parts that are worked on at once."""

MOST_PHASES = 3
"""Cubes of more phases have too many combinations for an exemplar to tell their densities."""

LEAST_VOXELS = 36
"""Of an exemplar, for every combination of phases on a cube: of three phases 62^3. Where it has
fewer, flips fit its chance, and leave interfaces rough."""

ROOMS = 3 * CHORDS + len(STRIDES) + 1 + len(RADII)

_CONNECTIVITIES = (6, 26)


@dataclass(frozen=True)
class Bins:
    """Where the counts of every kind of pattern are, of so many phases; with those of balls or
    without.
    """

    phases: int
    with_balls: bool = False

    @property
    def cubes(self) -> int:
        """Return the first bin of the cubes."""
        return 3 * self.phases * CHORDS

    @property
    def combinations(self) -> int:
        """Return the number of cubes of one stride."""
        return int(self.phases**8)

    @property
    def neighbours(self) -> int:
        """Return the first bin of the neighbours."""
        return self.cubes + len(STRIDES) * self.combinations

    @property
    def balls(self) -> int:
        """Return the first bin of the balls."""
        return self.neighbours + self.phases * NEIGHBOURS

    @property
    def total(self) -> int:
        """Return the number of bins."""
        channels = 1 if self.phases == 2 else self.phases
        return self.balls + self.with_balls * len(RADII) * channels * len(FRACTIONS)

    @cached_property
    def units(self) -> np.ndarray:
        """Return what one of each bin counts, (bins,): balls are counted in parts."""
        return np.where(np.arange(self.total) < self.balls, 1.0, 1 / UNIT)

    @cached_property
    def rooms(self) -> np.ndarray:
        """Return for every bin which of the counted rooms it has, (bins,)."""
        lengths = np.arange(CHORDS)
        chords = [axis * CHORDS + np.tile(lengths, self.phases) for axis in range(3)]
        cubes = [np.full(self.combinations, 3 * CHORDS + n) for n in range(len(STRIDES))]
        last = np.full(self.phases * NEIGHBOURS, 3 * CHORDS + len(STRIDES))
        each = (self.total - self.balls) // len(RADII)
        balls = [np.full(each, 3 * CHORDS + len(STRIDES) + 1 + n) for n in range(len(RADII))]
        return np.concatenate([*chords, *cubes, last, *balls])

    @cached_property
    def euler(self) -> np.ndarray:
        """Return the share of the nearest cubes in Euler numbers, (numbers, combinations): of the
        second phase with 6 and 26 neighbours, of every phase where there are more than two.
        """
        codes = np.arange(self.combinations)
        places = self.phases ** np.arange(8)
        digits = codes[:, None] // places % self.phases
        corners = [[k >> 2 & 1, k >> 1 & 1, k & 1] for k in range(8)]
        assert corners[1] == [0, 0, 1]  # the order of `measure.configurations`
        chosen = [1] if self.phases == 2 else range(self.phases)
        cubes = [((digits == phase) << np.arange(8)).sum(axis=1) for phase in chosen]
        return np.array([cube_euler(n)[cube] for cube in cubes for n in _CONNECTIVITIES])


@dataclass(frozen=True)
class Patterns:
    """Counts (bins,) of the patterns of labels, and the rooms where they could lie."""

    bins: Bins
    counts: np.ndarray
    rooms: np.ndarray

    @classmethod
    def of(
        cls,
        phases: np.ndarray,
        count: int,
        *,
        wraps: Sequence[bool] = (False, False, False),
        valid: np.ndarray | None = None,
        balls: bool = False,
    ) -> Patterns:
        """Count the patterns of phases (Z, Y, X) uint8 below `count`, of those voxels that are
        `valid`.
        """
        blocks = boxes_of(phases.shape, BLOCK)
        one, bins = np.zeros(len(blocks), np.int64), Bins(count, balls)
        return cls.by_kind(phases, bins, blocks, one, wraps=wraps, valid=valid)[0]

    @classmethod
    def by_kind(
        cls,
        phases: np.ndarray,
        bins: Bins,
        blocks: Sequence[Box],
        kinds: np.ndarray,
        *,
        wraps: Sequence[bool] = (False, False, False),
        valid: np.ndarray | None = None,
    ) -> list[Patterns]:
        """Count those of blocks of each kind, which `kinds` number from 0."""
        lock, around = Lock(), np.array(wraps)
        counts = np.zeros((int(kinds.max()) + 1, bins.total), np.int64)
        rooms = np.zeros((len(counts), ROOMS), np.int64)
        where = np.empty((0, 0, 0), bool) if valid is None else valid

        def work(n: int) -> None:
            own, places = np.zeros(bins.total, np.int64), np.zeros(ROOMS, np.int64)
            local = cut_out(phases, where, blocks[n], around)
            count_patterns(local, bins.phases, own, places)
            if bins.with_balls:
                first = len(places) - len(RADII)
                count_balls(local, MARGIN, bins.phases, own[bins.balls :], places[first:])
            with lock:
                counts[kinds[n]] += own
                rooms[kinds[n]] += places

        for_blocks(work, blocks)
        return [cls(bins, *both) for both in zip(counts, rooms, strict=True)]

    def __add__(self, other: Patterns) -> Patterns:
        return Patterns(self.bins, self.counts + other.counts, self.rooms + other.rooms)

    @property
    def densities(self) -> np.ndarray:
        """Return how many there are of each in a room of it, (bins,)."""
        rooms = self.rooms[self.bins.rooms]
        return np.asarray(self.counts / np.maximum(rooms, 1))

    @property
    def chord_densities(self) -> np.ndarray:
        """Return those of the chords along each axis, (3, bins of an axis)."""
        return self.densities[: self.bins.cubes].reshape(3, -1)


def cut_out(phases: np.ndarray, valid: np.ndarray, box: Box, wraps: np.ndarray) -> np.ndarray:
    """Return a box with `MARGIN` voxels around it; what is beyond an open face, or not valid, is
    `OUTSIDE`.
    """
    sides = [stop - start + 2 * MARGIN for start, stop in box]
    local = np.empty(sides, np.uint8)
    load(phases, valid, np.array([start - MARGIN for start, _ in box]), wraps, local)
    return local


def for_blocks(work: Callable[[int], object], blocks: Sequence[Box]) -> None:
    """Call `work` with the number of every block, in threads, layer by layer."""

    starts = [n for n, box in enumerate(blocks) if n == 0 or box[0] != blocks[n - 1][0]]
    for first, stop in pairwise([*starts, len(blocks)]):
        for_each(work, range(first, stop))
        memmap.release_pages()
