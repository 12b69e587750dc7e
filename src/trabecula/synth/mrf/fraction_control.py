"""Control of the levels' shares: every class of sites is drawn with the target shares.

A density that confirms itself acts like a magnet: the level with more voxels grows until it has
all, and a bias learned from sweep to sweep only drives it from one side to the other. So the scores
of each class are shifted before the draw, group of levels by group, just so far that the expected
shares of the class are the target.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.synth.mrf.density import LOGS, POWERS, UNIT, log_of, power_of
from trabecula.synth.mrf.site_update import COLD, SiteClass, allocate_rows, run_on_rows, sum_on_rows

SITE = 1 << 31
"""Steps of an expected number of sites."""

# through the groups, from the shifts of the class before; two groups are settled in one
_ROUNDS = 2

_NARROW, _WIDE = 2 * UNIT, np.int64(1) << 30

_FINE = 1 << 8

_MOST = 16 * UNIT

_LEVEL_STEP = 1.0  # factors of two that a level's shift moves in a class, at most


def group_shifts(
    energy: np.ndarray, wanted: np.ndarray, lead: np.ndarray, *, coldness: int, start: np.ndarray
) -> np.ndarray:
    """Return shifts (G,) int64 of the groups' scores, in units, the largest 0.

    Parameters
    ----------
    energy : (S, G) int64
        Scores of the groups (`group_scores`) at the sites of a class, in units.
    wanted : (G,) float64
        Target shares of the class, sum 1.
    lead : (S,) int64
        Overwritten.
    coldness : int
        1 / temperature in whole 4096ths.
    start : (G,) int64
        The shifts of the class before.
    """
    shift = start.copy()
    first, rounds = (1, 1) if len(wanted) == 2 else (0, _ROUNDS)
    for _ in range(rounds):
        for group in range(first, len(wanted)):

            def work(begin: int, end: int, group: int = group) -> None:
                score_leads(
                    energy[begin:end], shift, group, coldness, LOGS, POWERS, lead[begin:end]
                )

            run_on_rows(work, len(lead))
            shift[group] = _solve_shift(lead, float(wanted[group]), coldness, int(shift[group]))
    return shift - shift.max()


def level_shifts(
    taken: np.ndarray,
    groups: np.ndarray,
    wanted: np.ndarray,
    *,
    count: int,
    coldness: int,
    shift: np.ndarray,
) -> np.ndarray:
    """Return shifts (L,) int64 of the levels within their groups for the next class, from those of
    this class.

    Many levels are not solved for class by class: each moves once, by the logarithm of its target
    share over its expected share.

    Parameters
    ----------
    taken : (L,) float64
        Expected number of the class's `count` sites of every level (`add_expected_levels`), with
        all shifts.
    groups : (L,) uint8
    wanted : (L,) float64
    count : int
    coldness : int
    shift : (L,) int64
    """
    ratio = np.log2((wanted * count + 0.5) / (taken + 0.5))
    step = np.rint(np.clip(ratio, -_LEVEL_STEP, _LEVEL_STEP) * (UNIT * COLD / coldness)).astype(
        np.int64
    )
    moved = np.clip(shift + step, -_MOST, _MOST)
    for group in np.unique(groups):  # the common shift of a group is the group's own
        moved[groups == group] -= int(np.median(moved[groups == group]))
    return moved


def _solve_shift(lead: np.ndarray, wanted: float, coldness: int, near: int) -> int:
    """Find the shift of a group at which its expected share is `wanted`, by halving an interval
    around the last shift.
    """

    def expect(shift: int) -> int:
        """Return the expected number of sites of the group, in steps of 1 / `SITE`."""
        return int(
            sum_on_rows(lambda a, b: count_expected(lead[a:b], shift, coldness, POWERS), len(lead))
        )

    aim, room = wanted * len(lead) * SITE, int(_NARROW)
    low, high = near - room, near + room
    while low > -_WIDE and expect(low) > aim:
        low, high, room = low - 4 * room, low, 4 * room
    while high < _WIDE and expect(high) < aim:
        low, high, room = high, high + 4 * room, 4 * room
    while high - low > _FINE:
        middle = (low + high) // 2
        if expect(middle) < aim:
            low = middle
        else:
            high = middle
    return int(np.clip((low + high) // 2, -_WIDE, _WIDE))


@kernel
def group_scores(score, kept, added, groups, coldness, logs, powers, energy):
    """Compute scores of the groups (S', G) int64: the logarithm of the sum of their levels'
    weights, at this coldness.

    S' are the sites that are `kept` (S,) bool; `added` (L,) int64 is added to the score (S, L)
    int32.
    """
    G = energy.shape[1]
    top = np.empty(G, np.int64)
    total = np.empty(G, np.float64)
    row = 0
    for s in range(len(score)):
        if not kept[s]:
            continue
        top[:] = -(1 << 40)
        # one step of 2^-31: a group without weight is far below, not infinitely far
        total[:] = 1.0
        for level in range(len(groups)):
            top[groups[level]] = max(top[groups[level]], score[s, level] + added[level])
        for level in range(len(groups)):
            fall = ((score[s, level] + added[level] - top[groups[level]]) * coldness) >> 12
            total[groups[level]] += np.float64(power_of(fall, powers))
        bits = total.view(np.int64)
        for g in range(G):
            energy[row, g] = top[g] + ((log_of(bits[g], logs) - (31 << 16)) << 12) // coldness
        row += 1


@kernel
def score_leads(energy, shift, group, coldness, logs, powers, lead):
    """Compute by how much a group's score, without its own shift, exceeds that of all others
    together, (S,) int64.
    """
    total = np.empty(1, np.float64)
    bits = total.view(np.int64)
    for s in range(len(energy)):
        top = np.int64(-(1 << 60))
        for g in range(len(shift)):
            if g != group:
                top = max(top, energy[s, g] + shift[g])
        total[0] = 0.0
        for g in range(len(shift)):
            if g != group:
                total[0] += np.float64(
                    power_of(((energy[s, g] + shift[g] - top) * coldness) >> 12, powers)
                )
        lead[s] = energy[s, group] - top - ((log_of(bits[0], logs) - (31 << 16)) << 12) // coldness


@kernel
def count_expected(lead, shift, coldness, powers):
    """Return how many sites a group that leads by `lead` + `shift` is expected to take, in steps of
    1 / `SITE`: whole numbers, so that they may be summed in any order.
    """
    total = np.int64(0)
    for s in range(len(lead)):
        above = ((lead[s] + shift) * coldness) >> 12
        odds = np.float64(power_of(-abs(above), powers)) * 2.0**-31
        total += np.int64((1.0 if above >= 0 else odds) / (1.0 + odds) * 2.0**31 + 0.5)
    return total


@kernel
def add_expected_levels(score, kept, added, coldness, powers, total):
    """Add the expected number of sites of every level (L,) to `total`; sites and scores as in
    `group_scores`.
    """
    weight = np.empty(score.shape[1], np.float64)
    for s in range(len(score)):
        if not kept[s]:
            continue
        top = score[s, 0] + added[0]
        for level in range(len(weight)):
            top = max(top, score[s, level] + added[level])
        whole = 0.0
        for level in range(len(weight)):
            weight[level] = np.float64(
                power_of(((score[s, level] + added[level] - top) * coldness) >> 12, powers)
            )
            whole += weight[level]
        for level in range(len(weight)):
            total[level] += weight[level] / whole


@dataclass
class FractionShifts:
    """Shifts of the scores of groups of levels, and of levels within them, that give the target
    shares.

    Attributes
    ----------
    groups : (L,) uint8
    wanted : (L,) float64
        Shares of the levels.
    enough : int
        Sites of a class that give it its own shifts; of fewer the shifts move part of the way,
        since a few sites need not have the shares of all.
    by_group, by_level : (G,), (L,) int64
        In units; each class starts from those of the class before.
    """

    groups: np.ndarray
    wanted: np.ndarray
    enough: int = 1

    def __post_init__(self) -> None:
        self._wanted_groups = np.bincount(self.groups, self.wanted)
        self.by_group = np.zeros(len(self._wanted_groups), np.int64)
        self.by_level = np.zeros(len(self.wanted), np.int64)

    def update(self, site_class: SiteClass, score: np.ndarray, coldness: int) -> np.ndarray:
        """Return the shifts (L,) int32 that give the sites of a class the target shares inside the
        result.
        """
        if not site_class.count_in_result:
            return (self.by_group[self.groups] + self.by_level).astype(np.int32)
        work = site_class.work
        work.enter("score groups")
        self._score_groups(site_class, score, coldness)
        work.enter("shift groups")
        solved = group_shifts(
            work["energy"],
            self._wanted_groups,
            work.adopt("lead", allocate_rows(site_class.count_in_result)),
            coldness=coldness,
            start=self.by_group,
        )
        self.by_group = self._move(self.by_group, solved, site_class.count_in_result)
        work.enter("count levels")
        shift = self.by_group[self.groups] + self.by_level
        if len(self._wanted_groups) < len(self.wanted):
            moved = level_shifts(
                self._count_by_level(site_class, score, shift, coldness),
                self.groups,
                self.wanted,
                count=site_class.count_in_result,
                coldness=coldness,
                shift=self.by_level,
            )
            self.by_level = self._move(self.by_level, moved, site_class.count_in_result)
        return shift.astype(np.int32)

    def _move(self, before: np.ndarray, after: np.ndarray, sites: int) -> np.ndarray:
        """Return shifts moved from `before` towards `after`, as far as so many sites tell."""
        return before + (after - before) * min(sites, self.enough) // self.enough

    def _score_groups(self, site_class: SiteClass, score: np.ndarray, coldness: int) -> None:
        """Compute scores (S', G) int64 of the groups at the sites in the result."""
        (rows, asked), in_result = site_class.starts, site_class.classes.lattice.in_result
        energy = site_class.allocate(
            "energy", (site_class.count_in_result, len(self._wanted_groups)), np.int64
        )

        def work(first: int, last: int) -> None:
            kept = in_result(site_class.sites(first, last))
            into = energy[asked[first] : asked[last]]
            group_scores(
                score[rows[first] : rows[last]],
                kept,
                self.by_level,
                self.groups,
                coldness,
                LOGS,
                POWERS,
                into,
            )

        site_class.run_on_planes(work)

    def _count_by_level(
        self, site_class: SiteClass, score: np.ndarray, shift: np.ndarray, coldness: int
    ) -> np.ndarray:
        """Return how many of these sites every level is expected to take, (L,) float64."""
        rows, in_result = site_class.starts[0], site_class.classes.lattice.in_result
        # by plane: sums of floats that do not depend on slabs
        totals = np.zeros((site_class.depth, len(shift)))

        def work(first: int, last: int) -> None:
            kept = in_result(site_class.sites(first, last))
            for z in range(first, last):
                of_plane = kept[rows[z] - rows[first] : rows[z + 1] - rows[first]]
                add_expected_levels(
                    score[rows[z] : rows[z + 1]], of_plane, shift, coldness, POWERS, totals[z]
                )

        site_class.run_on_planes(work)
        return np.array([math.fsum(column) for column in totals.T])
