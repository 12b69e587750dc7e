"""The last step of new material: single voxels change their phase until patterns occur as often as
in the exemplar.

Votes are means of neighbourhoods, and what these do not agree on is lost: thin joins, narrow pores,
the grain of an interface. Steps on the two-point function bring pairs of voxels back, no more. So
in the end voxels of interfaces change phase one by one, each where that brings the densities of
chords, cubes and neighbours (`counts`) and the Euler numbers nearer to the exemplar's, as Yeong and
Torquato (1998, doi:10.1103/PhysRevE.57.495) exchange voxels for the two-point function. What the
votes are sure of changes at a price, and small bodies, which were counted before, stay as they are.

Where a target varies, blocks of like targets are mended together, towards the densities that places
of the exemplar have whose fraction is theirs (`densities`).

The misfit is shared among blocks by their volume: each mends its share of it, and reads its
surroundings as they were before the round. So they are worked on at once, and the voxels do not
depend on the number of threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from threading import Lock
from typing import Any

import numpy as np

from trabecula.core.progress import track
from trabecula.core.seeds import key
from trabecula.engine import memmap
from trabecula.engine.chunking import Box, boxes_of, slices_of
from trabecula.engine.memory import Array, Stage
from trabecula.engine.parallel import thread_count
from trabecula.synth.shared.block_bounds import BlockBounds
from trabecula.synth.shared.local_offset import NARROWEST
from trabecula.synth.shared.patterns.counts import BLOCK, Patterns, cut_out, for_blocks
from trabecula.synth.shared.patterns.densities import PatternDensities
from trabecula.synth.shared.patterns.excess import (
    bounded_cells,
    cells_of,
    excess_of,
    kept_cells,
)
from trabecula.synth.shared.patterns.flip_block import flip_block
from trabecula.synth.shared.patterns.kernels import MARGIN
from trabecula.synth.shared.patterns.misfit import EFFORT, Misfit, VotePrice, steps_around
from trabecula.synth.shared.slabs import tally_by_slabs

_BANDS, _BLOCKS = 6, 8  # bands of a target that varies, at most, and blocks of each, at least
_EVERYWHERE = np.empty((0, 0, 0), bool)
_VOTES = 1 << 15
LOCAL = 16
"""Bytes of a voxel of a local array."""
_SUMS = 2  # more, for balls


@dataclass(frozen=True)
class FlipRegion:
    """Where voxels may change.

    Attributes
    ----------
    wraps : three bools
        Axes that continue at the opposite face.
    free : (Z, Y, X) bool, optional
        Voxels that may change.
    valid : (Z, Y, X) bool, optional
        Voxels of the material: the others belong to no pattern.
    graded : bool
        Whether patterns are those of places of the exemplar with the fraction that is here.
    fractions : (Z, Y, X) float32, optional
        Of the second of two phases, as a target has them that varies.
    window : int
        Voxels a side of the windows that are to have these fractions.
    bounds : BlockBounds, optional
        That blocks keep which keep them; in others fractions do not move away from them.
    """

    wraps: Sequence[bool] = (False, False, False)
    free: np.ndarray | None = None
    valid: np.ndarray | None = None
    graded: bool = False
    fractions: np.ndarray | None = None
    window: int = NARROWEST
    bounds: BlockBounds | None = None

    @property
    def fixed(self) -> np.ndarray | None:
        """Return the voxels of the material that may not change; None where all may."""
        if self.free is None or self.free is self.valid:
            return None
        return ~self.free if self.valid is None else self.valid & ~self.free


def flip_voxels(
    phases: np.ndarray,
    votes: np.ndarray,
    patterns: PatternDensities,
    place: FlipRegion,
    *,
    seed: int,
    rounds: int,
    unit: float,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Return phases with the exemplar's patterns, and a report: the voxels that changed, the share
    of all patterns that were off before and are off after, and the share of voxels that are left
    alone, since the exemplar has no place of their fraction.

    Every phase keeps its number of voxels in every block, or nearly that where smaller blocks have
    bounds. Where the target varies cells get as many as bring windows to their fractions.

    Parameters
    ----------
    phases : (Z, Y, X) uint8
        Counted from 0.
    votes : (C, Z, Y, X) int16
        Signed distances that they were made of, of every phase, or of the second of two.
    patterns : PatternDensities
        Of the exemplars.
    place : FlipRegion
    seed : int
        Of the request.
    rounds : int
        Over all voxels of interfaces.
    unit : float
        Of the votes in a voxel.
    """
    blocks = _blocks_of(phases.shape, place)
    bands, of_blocks, left = _bands(phases, patterns, place, blocks)
    level = _level(votes[0], phases, place.free) if len(votes) == 1 else 0.0
    before, changed = _share_off(bands), 0
    for number in track(range(rounds), "matching patterns"):
        given = votes, level, EFFORT / unit, key(seed, f"patterns/{number}")
        phases, count = _round(phases, bands, given, place, blocks, of_blocks)
        changed += count
    report = {"changed": changed, "off_before": before, "off_after": _share_off(bands)}
    return phases, {**report, "left": left} if left else report


def _blocks_of(shape: Sequence[int], place: FlipRegion) -> list[Box]:
    """Return the blocks that are worked on at once; those that have bounds are not cut."""
    if place.bounds is None:
        return boxes_of(shape, BLOCK)
    cuts = []
    for end, side in zip(shape, place.bounds.sides, strict=True):
        step = side * max(1, BLOCK // side)
        cuts.append([(first, min(first + step, end)) for first in range(0, end, step)])
    return list(product(*cuts))


def _bands(
    phases: np.ndarray, patterns: PatternDensities, place: FlipRegion, blocks: Sequence[Box]
) -> tuple[list[Misfit | None], np.ndarray, float]:
    """Return the bands of equal target, None where the exemplar knows no such place; the band of
    every block, and the share of free voxels in those that are left.
    """
    wanted, sizes, solid = (np.zeros(len(blocks)) for _ in range(3))
    free, fractions = place.free, place.fractions

    def work(n: int) -> None:
        inside = slices_of(blocks[n])
        where = True if free is None else free[inside]
        sizes[n] = phases[inside].size if free is None else np.count_nonzero(where)
        solid[n] = np.count_nonzero((phases[inside] == 1) & where)
        if fractions is not None and sizes[n]:
            wanted[n] = fractions[inside].mean(dtype=np.float64, where=where)

    for_blocks(work, blocks)
    at = np.flatnonzero(sizes)
    count = max(1, min(_BANDS, len(at) // _BLOCKS)) if np.ptp(wanted[at]) else 1
    of_blocks = np.zeros(len(blocks), np.int64)
    of_blocks[at[np.argsort(wanted[at], kind="stable")]] = np.arange(len(at)) * count // len(at)
    bins = patterns.bins
    found: list[Misfit | None] = []
    given = (bins, blocks, of_blocks)
    made = Patterns.by_kind(phases, *given, wraps=place.wraps, valid=place.valid)
    fixed = place.fixed
    held = made
    if fixed is not None:
        held = Patterns.by_kind(phases, *given, wraps=place.wraps, valid=fixed)
    left = 0.0
    for band, (there, known) in enumerate(zip(made, held, strict=True)):
        own = of_blocks == band
        size, upper = sizes[own].sum(), solid[own].sum()
        densities = patterns.at(upper / max(size, 1)) if place.graded else patterns.own
        if densities is None:
            left += size / sizes.sum()
            found.append(None)
            continue
        rooms = there.rooms if fixed is None else there.rooms - known.rooms
        target = densities * rooms[bins.rooms]
        if fixed is not None:
            target += known.counts
        found.append(Misfit(bins, int(size), target, there.counts - target))
    return found, of_blocks, round(left, 4)


def _share_off(bands: Sequence[Misfit | None]) -> float:
    """Return all that is off over all that there is to be."""
    some = [band for band in bands if band is not None]
    off = sum(float(np.abs(band.off) @ band.bins.units) for band in some)
    return round(off / max(sum(float(band.target @ band.bins.units) for band in some), 1), 4)


def _round(
    phases: np.ndarray,
    bands: Sequence[Misfit | None],
    given: tuple[np.ndarray, float, float, np.uint64],
    place: FlipRegion,
    blocks: Sequence[Box],
    of_blocks: np.ndarray,
) -> tuple[np.ndarray, int]:
    """Return phases after one round, and how many voxels changed; bands follow."""
    made, lock, wraps = memmap.empty(phases.shape, np.uint8), Lock(), np.array(place.wraps)
    changes = [None if band is None else np.zeros(len(band.off), np.int64) for band in bands]
    counts = np.zeros(len(blocks), np.int64)
    free, valid = place.free, place.valid
    votes, level, effort, stage = given
    excess = None
    if place.bounds is not None:
        excess = place.bounds.excess(phases)
    elif place.fractions is not None:
        excess = excess_of(phases, place.fractions, free, window=place.window, wraps=place.wraps)

    def work(n: int) -> None:
        box, inside = blocks[n], slices_of(blocks[n])
        band, change = bands[of_blocks[n]], changes[of_blocks[n]]
        voxels = made[inside].size if free is None else np.count_nonzero(free[inside])
        if band is None or change is None or not voxels:
            made[inside] = phases[inside]
            return
        local = cut_out(phases, _EVERYWHERE if valid is None else valid, box, wraps)
        own = np.zeros(len(change), np.int64)
        core = tuple(slice(MARGIN, side - MARGIN) for side in local.shape)
        if excess is None:
            cells = kept_cells(local[core].shape, band.bins.phases, BLOCK)
        elif place.bounds is not None:
            cells = bounded_cells(excess, box, place.bounds.sides)
        else:
            cells = cells_of(excess, box)
        counts[n] = flip_block(
            local,
            band.bins.phases,
            _EVERYWHERE if free is None else np.ascontiguousarray(free[inside]),
            VotePrice(np.ascontiguousarray(votes[(slice(None), *inside)]), level, effort),
            (stage, n),
            band.of_block(voxels / band.size),
            steps_around(local.shape),
            cells,
            own,
        )
        found = local[core]
        made[inside] = found if valid is None else np.where(valid[inside], found, phases[inside])
        with lock:
            change += own

    for_blocks(work, blocks)
    for band, change in zip(bands, changes, strict=True):
        if band is not None and change is not None:
            band.off = band.off + change
    return made, int(counts.sum())


def _level(votes: np.ndarray, phases: np.ndarray, free: np.ndarray | None) -> float:
    """Return the value of votes (Z, Y, X) that as many free voxels exceed as are of the second
    phase.
    """

    def tally(start: int, stop: int) -> np.ndarray:
        there = votes[start:stop].astype(np.int32) + _VOTES
        upper = phases[start:stop] == 1
        which = slice(None) if free is None else free[start:stop]
        counts = np.bincount(there[which].ravel(), minlength=2 * _VOTES)
        return np.append(counts, np.count_nonzero(upper[which]))

    *counts, upper = tally_by_slabs(tally, votes.shape)
    brightest = np.cumsum(counts[::-1])
    return float(_VOTES - 1 - np.searchsorted(brightest, upper))


def pattern_stages(
    shape: Sequence[int], channels: int, *, free: bool, sides: Sequence[int] = (1, 1, 1)
) -> tuple[Stage, ...]:
    """Declare the arrays of the flips; blocks of `sides` voxels are not cut."""
    longest = [max(BLOCK, side) for side in sides]
    local = int(np.prod([min(*both) + 2 * MARGIN for both in zip(longest, shape, strict=True)]))
    arrays = {
        "votes": Array((channels, *shape), np.int16),
        "phases": Array(shape, np.uint8),
        "changed phases": Array(shape, np.uint8),
        "free": Array(shape, bool) if free else None,
        "known": Array(shape, bool) if free else None,
        "blocks": Array((LOCAL + _SUMS) * local * thread_count(), np.uint8, at_most=True),
    }
    return (Stage("patterns", arrays),)
