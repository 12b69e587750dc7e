"""One class of sites at once: the scores of all levels, the shifts that make the expected shares
right, the draw.

1. Every site's scores, from the densities of its slices, the feedback and the couplings (`scored`).
2. The groups' shifts, and how far the levels within them move for the next class (`Shifts`).
3. New levels (`levels_for`), which the feedback counts (`count_into`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trabecula.synth.mrf import decision_rules
from trabecula.synth.mrf.bias_feedback import Tables
from trabecula.synth.mrf.couplings import Couplings
from trabecula.synth.mrf.feedback import count
from trabecula.synth.mrf.fraction_control import moved_levels, of_groups, shares_of, shifts_for
from trabecula.synth.mrf.site_class import Members
from trabecula.synth.mrf.slice_planes import Frame
from trabecula.synth.mrf.tables import LOGS, POWERS

_ROWS = 4096  # sites that get new levels at once


@dataclass(frozen=True)
class Step:
    """What a sweep does: its rule ("gibbs", "icm", "annealing"), temperature, key and number for
    random words, which of the frames it goes by, and whether it sees the pictures from behind."""

    rule: str
    heat: float
    key: np.uint64
    number: int
    frame: int = 0
    mirrored: bool = False


@dataclass(frozen=True)
class Scored:
    """What is known of the sites of a class, one row for each.

    Attributes
    ----------
    score : (S, L) int32
        Of all levels; without rows for h1a and h1b, which choose at once:
    chosen : (S,) uint8
        Else without entries.
    cells : (V, S, C) uint8
        Where the local sums lie; without rows where nothing is learnt of them.
    """

    score: np.ndarray
    chosen: np.ndarray
    cells: np.ndarray


@dataclass(frozen=True)
class Tally:
    """How many sites changed, and what the feedback counted."""

    changed: int
    tables: Tables

    def __add__(self, other: Tally) -> Tally:
        return Tally(
            self.changed + other.changed,
            [a + b for a, b in zip(self.tables, other.tables, strict=True)],
        )


def scored(
    members: Members,
    frame: Frame,
    *,
    heuristic: str,
    bias: Tables,
    temperature: np.ndarray,
    couplings: Couplings | None,
    mirrored: bool,
) -> Scored:
    """The scores of a class.

    Parameters
    ----------
    members : Members
    frame : Frame
    heuristic : str
        Setting `heuristic`.
    bias : list of (C, B, G) int64
        Of the feedback, in units; empty for none.
    temperature : (Z, Y, X) float32
        Of equation 8; without entries for none.
    couplings : Couplings, optional
    mirrored : bool
        Whether the pictures are seen from behind.
    """
    at_once = heuristic in ("h1a", "h1b")
    features, starts = frame.content.features, members.starts[0]
    score = members.room((0 if at_once else members.count, len(features)), np.int32)
    chosen = members.room((members.count if at_once else 0,), np.uint8)
    cells = members.room(
        (len(frame.faces), members.count if bias else 0, features.shape[1]), np.uint8
    )

    def work(first: int, last: int) -> None:
        sites, start = members.sites(first, last), int(starts[first])
        room = frame.scratch(len(sites))
        for begin in range(0, len(sites), frame.batch):
            asked = sites[begin : begin + frame.batch]
            rows = slice(start + begin, start + begin + len(asked))
            pulled = np.zeros((len(asked), len(features)), np.int64)
            log = frame.densities(
                asked, room, temperature, pulled, bias, cells[:, rows], mirrored=mirrored
            )
            if at_once:
                decision_rules.of_views(log, features, heuristic == "h1b", chosen[rows])
                continue
            if couplings is not None:
                couplings.pull(asked, pulled)
            frame.score(log, pulled, heuristic, score[rows])

    members.dear_over(work)
    return Scored(score, chosen, cells)


@dataclass
class Shifts:
    """What is added to the scores of groups of levels, and of levels within them, for the wanted
    shares.

    Attributes
    ----------
    groups : (L,) uint8
    wanted : (L,) float64
        Shares of the levels.
    of_groups, fine : (G,), (L,) int64
        In units; they go on from class to class.
    """

    groups: np.ndarray
    wanted: np.ndarray

    def __post_init__(self) -> None:
        self._by_group = np.bincount(self.groups, self.wanted)
        self.of_groups = np.zeros(len(self._by_group), np.int64)
        self.fine = np.zeros(len(self.wanted), np.int64)

    def settle(self, members: Members, score: np.ndarray, coldness: int) -> np.ndarray:
        """The shifts (L,) int32 that give the sites of a class the wanted shares where they lie in
        the result.
        """
        if not members.asked:
            return (self.of_groups[self.groups] + self.fine).astype(np.int32)
        energy = self._energy(members, score, coldness)
        self.of_groups = shifts_for(energy, self._by_group, coldness=coldness, start=self.of_groups)
        del energy
        shift = self.of_groups[self.groups] + self.fine
        if len(self._by_group) < len(self.wanted):
            self.fine = moved_levels(
                self._taken(members, score, shift, coldness),
                self.groups,
                self.wanted,
                count=members.asked,
                coldness=coldness,
                shift=self.fine,
            )
        return shift.astype(np.int32)

    def _energy(self, members: Members, score: np.ndarray, coldness: int) -> np.ndarray:
        """Scores (S', G) int64 of the groups at the sites in the result."""
        (rows, asked), asks_for = members.starts, members.classes.lattice.asks_for
        energy = members.room((members.asked, len(self._by_group)), np.int64)

        def work(first: int, last: int) -> None:
            kept = asks_for(members.sites(first, last))
            into = energy[asked[first] : asked[last]]
            of_groups(
                score[rows[first] : rows[last]],
                kept,
                self.fine,
                self.groups,
                coldness,
                LOGS,
                POWERS,
                into,
            )

        members.over(work)
        return energy

    def _taken(
        self, members: Members, score: np.ndarray, shift: np.ndarray, coldness: int
    ) -> np.ndarray:
        """How many of these sites every level is expected to take, (L,) float64."""
        rows, asks_for = members.starts[0], members.classes.lattice.asks_for
        # by plane: sums of floats that no slab touches
        totals = np.zeros((members.depth, len(shift)))

        def work(first: int, last: int) -> None:
            kept = asks_for(members.sites(first, last))
            for z in range(first, last):
                of_plane = kept[rows[z] - rows[first] : rows[z + 1] - rows[first]]
                shares_of(
                    score[rows[z] : rows[z + 1]], of_plane, shift, coldness, POWERS, totals[z]
                )

        members.over(work)
        return np.array([math.fsum(column) for column in totals.T])


def levels_for(
    score: np.ndarray, sites: np.ndarray, present: np.ndarray, step: Step, proposals: int
) -> np.ndarray:
    """New levels (S,) uint8 by the rule of a step, from scores (S, L) int32 with all shifts and the
    `present` levels.
    """
    chosen = np.empty(len(sites), np.uint8)
    if step.rule == "icm" or (step.rule == "gibbs" and step.heat == 0):
        decision_rules.greatest(score, chosen)
    elif step.rule == "gibbs":
        decision_rules.drawn(
            score, decision_rules.coldness(step.heat), POWERS, sites, step.key, step.number, chosen
        )
    else:
        heat = round(65536 * step.heat)
        decision_rules.proposed(
            score, heat, POWERS, present, proposals, sites, step.key, step.number, chosen
        )
    return chosen


def parts_of(count: int) -> list[slice]:
    """So many rows, a few at a time."""
    return [slice(first, min(first + _ROWS, count)) for first in range(0, count, _ROWS)]


def count_into(tables: Tables, cells: np.ndarray, frame: Frame, chosen: np.ndarray) -> None:
    """Count the levels chosen at some sites by cell (V, S, C)."""
    for face, cell in zip(frame.faces, cells, strict=True):
        count(cell, frame.content.groups, chosen, tables[face.learner])
