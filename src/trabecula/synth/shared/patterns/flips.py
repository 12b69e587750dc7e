"""The last step of new material: single voxels change their phase until patterns occur as often as
in the exemplar.

Votes are means of neighbourhoods, and what these do not agree on is lost: thin joins, narrow pores,
the grain of an interface. Steps on the two-point function bring pairs of voxels back, no more. So
in the end voxels of interfaces change phase one by one, each where that brings the densities of
chords, cubes and neighbours (`counts`) and the Euler numbers nearer to the exemplar's, as Yeong and
Torquato (1998, doi:10.1103/PhysRevE.57.495) exchange voxels for the two-point function. What the
votes are sure of changes at a price, and small bodies, which were counted before, stay as they are.

The misfit is shared among blocks by their volume: each mends its share of it, and reads its
surroundings as they were before the round. So they are worked on at once, and the voxels do not
depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.progress import track
from trabecula.core.seeds import key
from trabecula.engine import memmap
from trabecula.engine.chunking import boxes_of, slices_of
from trabecula.engine.memory import Array, Stage
from trabecula.engine.parallel import thread_count
from trabecula.synth.shared.patterns.counts import BLOCK, Patterns, cut_out, for_blocks
from trabecula.synth.shared.patterns.kernels import MARGIN, flip_block
from trabecula.synth.shared.slabs import count_true, tally_by_slabs

_NEIGHBOURS = 0.3  # weight of their misfit beside that of chords and cubes
_EULER = 20.0  # of that of Euler numbers
_EFFORT = 0.5  # of a voxel that the votes put a voxel away from the interface
_EVERYWHERE = np.empty((0, 0, 0), bool)
_VOTES = 1 << 15
_LOCAL = 15  # bytes of a voxel of a local array


@dataclass
class _Misfit:
    """What is missing of patterns and Euler numbers, of how many."""

    patterns: Patterns  # of the exemplars
    target: np.ndarray
    off: np.ndarray

    @classmethod
    def of(
        cls,
        phases: np.ndarray,
        patterns: Patterns,
        wraps: Sequence[bool],
        free: np.ndarray | None,
        valid: np.ndarray | None,
    ) -> _Misfit:
        """Measure it; patterns of voxels that may not change are what they are."""
        bins = patterns.bins
        found = Patterns.of(phases, bins.phases, wraps=wraps, valid=valid)
        target = patterns.densities * found.rooms[bins.rooms]
        if free is not None:
            known = ~free if valid is None else valid & ~free
            held = Patterns.of(phases, bins.phases, wraps=wraps, valid=known)
            target += held.counts - patterns.densities * held.rooms[bins.rooms]
        return cls(patterns, target, found.counts - target)

    @property
    def share(self) -> float:
        """Return all that is off over all that there is."""
        return round(float(np.abs(self.off).sum() / max(np.abs(self.target).sum(), 1)), 4)

    def of_block(self, share: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the slopes of the energy with a share of the misfit, and the misfit and weights of
        Euler numbers.
        """
        bins = self.patterns.bins
        weights = 1 / (np.maximum(self.target, 0) * share + 1)
        weights[bins.neighbours :] *= _NEIGHBOURS
        slopes = np.stack([2 * share * self.off * weights, weights], axis=1)
        cubes = slice(bins.cubes, bins.cubes + bins.combinations)
        wanted = np.abs(bins.euler @ self.target[cubes])
        return (
            slopes,
            bins.euler,
            share * (bins.euler @ self.off[cubes]),
            _EULER / (share * wanted + 1),
        )


def flip_voxels(
    phases: np.ndarray,
    votes: np.ndarray,
    patterns: Patterns,
    *,
    seed: int,
    rounds: int,
    unit: float,
    wraps: Sequence[bool] = (False, False, False),
    free: np.ndarray | None = None,
    valid: np.ndarray | None = None,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Return phases with the exemplar's patterns, and a report: the voxels that changed, and the
    share of all patterns that were off before and are off after.

    Every phase keeps its number of voxels.

    Parameters
    ----------
    phases : (Z, Y, X) uint8
        Counted from 0.
    votes : (C, Z, Y, X) int16
        Signed distances that they were made of, of every phase, or of the second of two.
    patterns : Patterns
        Of the exemplars.
    seed : int
        Of the request.
    rounds : int
        Over all voxels of interfaces.
    unit : float
        Of the votes in a voxel.
    wraps : three bools
        Axes that continue at the opposite face.
    free : (Z, Y, X) bool, optional
        Voxels that may change.
    valid : (Z, Y, X) bool, optional
        Voxels of the material: the others belong to no pattern.
    """
    misfit = _Misfit.of(phases, patterns, wraps, free, valid)
    level = _level(votes[0], phases, free) if len(votes) == 1 else 0.0
    report, changed = {"off_before": misfit.share}, 0
    for number in track(range(rounds), "matching patterns"):
        stage = key(seed, f"patterns/{number}")
        given = votes, level, unit, stage
        phases, change, count = _round(phases, misfit, given, np.array(wraps), free, valid)
        misfit.off = misfit.off + change
        changed += count
    return phases, {"changed": changed, **report, "off_after": misfit.share}


def _round(
    phases: np.ndarray,
    misfit: _Misfit,
    given: tuple[np.ndarray, float, float, np.uint64],
    wraps: np.ndarray,
    free: np.ndarray | None,
    valid: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return phases after one round, the change of their counts, and how many voxels changed."""
    blocks, bins = boxes_of(phases.shape, BLOCK), misfit.patterns.bins
    made = memmap.empty(phases.shape, np.uint8)
    size = phases.size if free is None else count_true(free)
    changes = np.zeros((len(blocks), bins.total), np.int32)
    counts = np.zeros(len(blocks), np.int64)
    moving = _EVERYWHERE if free is None else free
    votes, level, unit, stage = given

    def work(n: int) -> None:
        box, inside = blocks[n], slices_of(blocks[n])
        local = cut_out(phases, _EVERYWHERE if valid is None else valid, box, wraps)
        voxels = made[inside].size if free is None else np.count_nonzero(free[inside])
        if voxels:
            counts[n] = flip_block(
                *(local, bins.phases, moving, np.array([first for first, _ in box])),
                *(votes, level, unit, stage, n),
                *misfit.of_block(voxels / size),
                *(_EFFORT, changes[n]),
            )
        core = local[tuple(slice(MARGIN, side - MARGIN) for side in local.shape)]
        made[inside] = core if valid is None else np.where(valid[inside], core, phases[inside])

    for_blocks(work, blocks)
    return made, changes.sum(axis=0), int(counts.sum())


def _level(votes: np.ndarray, phases: np.ndarray, free: np.ndarray | None) -> float:
    """Return the value of votes (Z, Y, X) that as many free voxels exceed as are of the second
    phase.
    """

    def tally(start: int, stop: int) -> np.ndarray:
        there = votes[start:stop].astype(np.int64) + _VOTES
        upper = phases[start:stop] == 1
        if free is not None:
            there, upper = there[free[start:stop]], upper[free[start:stop]]
        found = np.bincount(there.ravel(), minlength=2 * _VOTES + 1)
        found[-1] = np.count_nonzero(upper)
        return found

    counts = tally_by_slabs(tally, votes.shape)
    above = np.cumsum(counts[-2::-1])
    return float(2 * _VOTES - 1 - np.searchsorted(above, counts[-1]) - _VOTES)


def pattern_stages(shape: Sequence[int], channels: int, *, free: bool) -> tuple[Stage, ...]:
    """Declare the arrays of the flips."""
    local = int(np.prod([min(BLOCK, side) + 2 * MARGIN for side in shape]))
    arrays = {
        "votes": Array((channels, *shape), np.int16),
        "phases": Array(shape, np.uint8),
        "changed phases": Array(shape, np.uint8),
        "free": Array(shape, bool) if free else None,
        "known": Array(shape, bool) if free else None,
        "blocks": Array(_LOCAL * local * thread_count(), np.uint8, at_most=True),
    }
    return (Stage("patterns", arrays),)
