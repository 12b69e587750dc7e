"""Update of one class of sites at once.

1. The scores of every site, from the densities of its slices, the feedback and the couplings
   (`score_class`).
2. The shifts that give the target shares (`fraction_control`).
3. New levels by draw, mode or proposal (`choose_levels`), which the feedback counts
   (`count_local`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import kernel
from trabecula.engine.memory import Array, Stage, Workspace
from trabecula.engine.parallel import for_slabs, sum_slabs, thread_count
from trabecula.engine.random import below, philox
from trabecula.synth.mrf.config import MrfConfig
from trabecula.synth.mrf.density import POWERS, UNIT, power_of
from trabecula.synth.mrf.lattice import ClassName, SiteClasses
from trabecula.synth.mrf.picture_levels import PictureLevels
from trabecula.synth.mrf.random_order import RandomTurns
from trabecula.synth.mrf.slice_planes import (
    SliceView,
    ViewSet,
    batch_bytes,
    best_level,
    level_of_views,
)
from trabecula.synth.mrf.statistics_feedback import BiasTables, PairCouplings, count_cells

T = TypeVar("T")

_FEW = 1 << 14
"""Sites below which cheap work is done before threads have started."""

_MANY = 1 << 22
"""Voxels of a lattice whose arrays may be resident."""

_SMALL = 1 << 20
"""Bytes below which an array is not worth a file."""

_ENOUGH = 256
"""Sites that are worth a thread where each needs a density."""


def class_stages(
    shape: Sequence[int],
    view_sets: Sequence[Sequence[SliceView]],
    content: PictureLevels,
    config: MrfConfig,
    *,
    masked: bool,
) -> tuple[Stage, ...]:
    """Declare the arrays of a class of sites of a lattice, one row a site; `masked` says whether
    the result has a form.
    """
    width, views = config.neighbourhood, len(view_sets[0])
    (levels, channels), groups = content.features.shape, int(content.groups.max()) + 1
    depth, *across = shape
    sites = (depth, _most_in_plane(across, width // 2 + 1, config.order))
    planes = -(-_FEW // sites[1])  # of a thread's cheap work

    def rows(dtype: Any, *more: int) -> Array:
        return Array((*sites, *more), dtype, at_most=True)

    at_once = config.heuristic in ("h1a", "h1b")
    found = {"sites": rows(np.int64)}
    marked = {**found, "coordinates": rows(np.int64, 8 if masked else 5)}
    scores = {
        "score": None if at_once else rows(np.int32, levels),
        "chosen": rows(np.uint8) if at_once else None,
        "cells": rows(np.uint8, views * channels)
        if config.setting_for("feedback", content.sort)
        else None,
    }
    batch = max(batch_bytes(slice_views, content.features, width) for slice_views in view_sets)
    stages = [
        Stage("find sites", marked, planes=planes),
        Stage("score", {**scores, **found}, thread_count() * batch),
        Stage(
            "choose",
            {**scores, **found},
            thread_count() * ROWS_AT_ONCE * (4 * levels + 4),
            planes,
        ),
    ]
    if config.shares and not at_once:
        energy = {"energy": rows(np.int64, groups)}
        stages += [
            Stage("score groups", {**scores, **energy, **marked}, planes=planes),
            Stage("shift groups", {**scores, **energy, "lead": rows(np.int64)}, planes=planes),
            Stage("count levels", {**scores, **marked}, planes=planes),
        ]
    return tuple(stages)


def _most_in_plane(shape: Sequence[int], block: int, order: str | None) -> int:
    """Return how many sites of a plane (Y, X) may be updated at once: in every square of `block`
    voxels there is one at most.
    """
    down, across = (max(1, side // block) for side in shape)
    if order == "classes":
        return down * across
    height, width = shape
    return max(1, min(height * across, width * down) // block)  # in any arrangement


@dataclass
class SiteClass:
    """Sites of a class that a sweep visits, plane by plane. They are found anew wherever they are
    needed, since their places would take more memory than their levels.

    `temperature` (Z, Y, X) float32, `held` bool: only sites that are warm or held are visited;
    without entries all are. `work` has the arrays of `class_stages`.
    """

    classes: SiteClasses | RandomTurns
    name: ClassName
    temperature: np.ndarray
    held: np.ndarray
    work: Workspace

    def sites(self, first: int, last: int) -> np.ndarray:
        """Return flat places in the planes first .. last, rising."""
        sites = self.classes.sites(self.name, first, last)
        if not self.temperature.size:
            return sites
        warm = self.temperature.reshape(-1)[sites] > 0
        if self.held.size:
            warm |= self.held.reshape(-1)[sites]
        return sites[warm]

    @property
    def depth(self) -> int:
        """Return the planes of the lattice."""
        return self.classes.lattice.shape[0]

    @cached_property
    def starts(self) -> tuple[np.ndarray, np.ndarray]:
        """Count the sites before each plane, and those of them in the result: twice (Z +
        1,) int64.
        """
        lattice = self.classes.lattice
        plane, counts = lattice.shape[1] * lattice.shape[2], np.zeros((2, self.depth + 1), np.int64)

        def work(first: int, last: int) -> None:
            sites = self.sites(first, last)
            z = sites // plane - first
            counts[0, first + 1 : last + 1] = np.bincount(z, minlength=last - first)
            counts[1, first + 1 : last + 1] = np.bincount(
                z[lattice.in_result(sites)], minlength=last - first
            )

        if lattice.levels.size > _MANY:
            for_slabs(work, self.depth)
        else:
            work(0, self.depth)
        before, within = counts.cumsum(axis=1)
        return before, within

    @property
    def count(self) -> int:
        """Return the number of sites."""
        return int(self.starts[0][-1])

    @property
    def count_in_result(self) -> int:
        """Return the number of sites in the result."""
        return int(self.starts[1][-1])

    @property
    def _are_few(self) -> bool:
        """Return whether threads are not worth their start."""
        return self.count < _FEW and self.classes.lattice.levels.size <= _MANY

    def allocate(self, name: str, shape: Sequence[int], dtype: Any) -> np.ndarray:
        """Allocate an array of rows for sites, for `run_expensive` to write; in memory where it is
        small, since every visit allocates some.
        """
        size = math.prod(shape) * np.dtype(dtype).itemsize
        if not size or (self._are_few and size < _SMALL):
            rows = np.empty(tuple(shape), dtype)
        else:
            rows = memmap.empty(shape, dtype, least=0)
        return self.work.adopt(name, rows) if size else rows

    def run_on_planes(self, work: Callable[[int, int], object]) -> None:
        """Run cheap work on planes of sites."""
        if self._are_few:
            work(0, self.depth)
        else:
            for_slabs(work, self.depth, least=self._planes_with(_FEW))

    def sum_on_planes(self, work: Callable[[int, int], T]) -> T:
        """Sum whole numbers over planes of sites."""
        return (
            work(0, self.depth)
            if self._are_few
            else sum_slabs(work, self.depth, least=self._planes_with(_FEW))
        )

    def run_expensive(self, work: Callable[[int, int], object]) -> None:
        """Run expensive work on planes of sites, also in other processes; it writes slabs of arrays
        from `allocate`.
        """
        for_slabs(work, self.depth, least=self._planes_with(_ENOUGH), anywhere=not self._are_few)

    def _planes_with(self, sites: int) -> int:
        """Return how many planes hold so many sites."""
        return max(1, self.depth * sites // max(1, self.count))


ROWS_AT_ONCE = 4096  # sites that get new levels at once


def run_on_rows(work: Callable[[int, int], object], rows: int) -> None:
    """Run cheap work on rows of numbers, one row a site."""
    if rows < _FEW:
        work(0, rows)
    else:
        for_slabs(work, rows, least=_FEW)


def sum_on_rows(work: Callable[[int, int], T], rows: int) -> T:
    """Sum whole numbers over rows."""
    return work(0, rows) if rows < _FEW else sum_slabs(work, rows, least=_FEW)


def allocate_rows(rows: int) -> np.ndarray:
    """Allocate a whole number for every row (int64); in memory where that is little."""
    return np.empty(rows, np.int64) if rows < _FEW else memmap.empty(rows, np.int64)


@dataclass(frozen=True)
class SweepStep:
    """One sweep: its rule ("gibbs", "icm", "annealing"), temperature, key and number for random
    words, the number of its view set, and whether it sees the pictures mirrored.
    """

    rule: str
    heat: float
    key: np.uint64
    number: int
    view_set: int = 0
    mirrored: bool = False


@dataclass(frozen=True)
class ClassScores:
    """Scores of the sites of a class, one row a site.

    Attributes
    ----------
    score : (S, L) int32
        Of all levels; without rows for h1a and h1b, which choose at once.
    chosen : (S,) uint8
        Levels chosen by h1a and h1b; otherwise without entries.
    cells : (V, S, C) uint8
        Cells of the local sums; without rows where the feedback is off.
    """

    score: np.ndarray
    chosen: np.ndarray
    cells: np.ndarray


@dataclass(frozen=True)
class SweepTally:
    """The number of changed sites, and the counts of the feedback."""

    changed: int
    tables: BiasTables

    def __add__(self, other: SweepTally) -> SweepTally:
        """Add two tallies."""
        return SweepTally(
            self.changed + other.changed,
            [a + b for a, b in zip(self.tables, other.tables, strict=True)],
        )


def score_class(
    site_class: SiteClass,
    view_set: ViewSet,
    *,
    heuristic: str,
    bias: BiasTables,
    temperature: np.ndarray,
    couplings: PairCouplings | None,
    mirrored: bool,
) -> ClassScores:
    """Compute the scores of all levels at the sites of a class.

    Parameters
    ----------
    site_class : SiteClass
    view_set : ViewSet
    heuristic : str
        Setting `heuristic`.
    bias : list of (C, B, G) int64
        Of the feedback, in units; empty for none.
    temperature : (Z, Y, X) float32
        Of equation 8; without entries for none.
    couplings : PairCouplings, optional
    mirrored : bool
        Whether the pictures are seen from behind.
    """
    at_once = heuristic in ("h1a", "h1b")
    features, starts = view_set.content.features, site_class.starts[0]
    site_class.work.enter("score")
    score = site_class.allocate(
        "score", (0 if at_once else site_class.count, len(features)), np.int32
    )
    chosen = site_class.allocate("chosen", (site_class.count if at_once else 0,), np.uint8)
    cells = site_class.allocate(
        "cells",
        (len(view_set.slice_views), site_class.count if bias else 0, features.shape[1]),
        np.uint8,
    )

    def work(first: int, last: int) -> None:
        sites, start = site_class.sites(first, last), int(starts[first])
        room = view_set.product_buffer(len(sites))
        for begin in range(0, len(sites), view_set.batch):
            asked = sites[begin : begin + view_set.batch]
            rows = slice(start + begin, start + begin + len(asked))
            pulled = np.zeros((len(asked), len(features)), np.int64)
            log = view_set.log_densities(
                asked, room, temperature, pulled, bias, cells[:, rows], mirrored=mirrored
            )
            if at_once:
                level_of_views(log, features, heuristic == "h1b", chosen[rows])
                continue
            if couplings is not None:
                couplings.add_to_scores(asked, pulled)
            view_set.combine(log, pulled, heuristic, score[rows])

    site_class.run_expensive(work)
    return ClassScores(score, chosen, cells)


def choose_levels(
    score: np.ndarray, sites: np.ndarray, present: np.ndarray, step: SweepStep, proposals: int
) -> np.ndarray:
    """Choose new levels (S,) uint8 by the rule of a step, from scores (S, L) int32 with all shifts
    and the `present` levels.
    """
    chosen = np.empty(len(sites), np.uint8)
    if step.rule == "icm" or (step.rule == "gibbs" and step.heat == 0):
        most_probable_levels(score, chosen)
    elif step.rule == "gibbs":
        draw_levels(score, coldness(step.heat), POWERS, sites, step.key, step.number, chosen)
    else:
        heat = round(65536 * step.heat)
        propose_levels(
            score, heat, POWERS, present, proposals, sites, step.key, step.number, chosen
        )
    return chosen


def row_slices(count: int) -> list[slice]:
    """Split so many rows into slices."""
    return [
        slice(first, min(first + ROWS_AT_ONCE, count)) for first in range(0, count, ROWS_AT_ONCE)
    ]


def count_local(
    tables: BiasTables, cells: np.ndarray, view_set: ViewSet, chosen: np.ndarray
) -> None:
    """Count the levels chosen at some sites by cell (V, S, C)."""
    for slice_view, cell in zip(view_set.slice_views, cells, strict=True):
        count_cells(cell, view_set.content.groups, chosen, tables[slice_view.learner])


COLD = 4096
"""The coldness of temperature 1."""

COLDEST = 64 * COLD
"""The coldness that stands for the mode; colder, differences of scores times it would not fit into
64 bits.
"""


def coldness(heat: float) -> int:
    """Return 1 / heat in whole 4096ths, `COLDEST` at most."""
    return max(1, round(min(COLDEST, COLD / heat)))


@kernel
def most_probable_levels(score, chosen):
    """Choose the level of the greatest score; of equals the first."""
    for s in range(len(score)):
        chosen[s] = best_level(score[s])


@kernel
def draw_levels(score, coldness, powers, sites, key, sweep, chosen):
    """Draw a level with probability proportional to 2^(score coldness / 2^16 / 2^12); coldness 4096
    is temperature 1.
    """
    weight = np.empty(score.shape[1], np.int64)
    for s in range(len(score)):
        top = score[s, best_level(score[s])]
        total = np.int64(0)
        for level in range(len(weight)):
            weight[level] = power_of(((score[s, level] - top) * coldness) >> 12, powers)
            total += weight[level]
        word = philox(key, sites[s], sites[s] >> 32, sweep, 0)[0]
        at = np.int64(np.float64(word) * 2.0**-32 * np.float64(total))
        level = 0
        while level + 1 < len(weight) and at >= weight[level]:
            at -= weight[level]
            level += 1
        chosen[s] = level


@kernel
def propose_levels(score, temperature, powers, present, tries, sites, key, sweep, chosen):
    """Propose levels at random (figure 1): one replaces the present level where p > 1 or p t > q, p
    being the ratio of their densities and q random.

    `temperature` in 0 .. 2^16; `tries` proposals one after another, each with a q of its own.
    """
    for s in range(len(score)):
        level = np.int64(present[s])
        for trial in range(tries):
            first, second, _, _ = philox(key, sites[s], sites[s] >> 32, sweep, trial)
            other = below(first, score.shape[1])
            ratio = score[s, other] - score[s, level]
            if ratio > 0:
                level = other
            else:
                weight = power_of(max(ratio, -31 * UNIT), powers)  # p times 2^31
                if (np.float64(weight) * np.float64(temperature) * 2.0**-47) > np.float64(
                    second
                ) * 2.0**-32:
                    level = other
        chosen[s] = level
