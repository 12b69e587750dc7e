"""The phase of every voxel of voted fields, with volume fractions that are met to the voxel.

Two phases: the brightest voxels of the one field, found in three passes. Counts of the ranks
(`histogram`) give the rank of the last of them, and all above it are taken; the sums over 3 x 3 x 3
voxels of those in that rank are counted; the largest of these sums are taken, the last ones in
raster order. Which of equal voxels are taken does not depend on the division of the work.

More phases: each field is shifted until it is the largest in as many voxels as it should, one after
the other, until no count is off by more than ties. This is the auction for a transport problem with
few goods. The bid of a phase for a voxel is a whole number, so the lowest winning bid comes from
counts of the bids and nothing is sorted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs, in_order, sum_slabs
from trabecula.synth.shared.content.histogram import mix_with_neighbours, rank_counts, row_of_ranks
from trabecula.synth.shared.slabs import count_true, for_plane_groups, make_by_slabs

_TIED = 2  # beside 0 and 1, until it is settled
_ROUNDS = 20  # at most; a handful settle it
_BIDS = 2 * (1 << 16) - 1  # that there are between ranks


def labels_of(
    fields: np.ndarray,
    present: tuple[int, ...],
    fractions: np.ndarray | None,
    inside: np.ndarray | None = None,
) -> np.ndarray:
    """Return labels (uint8) of voted fields (C, Z, Y, X) int16, with the given volume `fractions`
    of the phases.

    Without fractions two phases are split at zero, and more go to the largest field.
    Two phases are split where the fraction is met to the voxel. More go to the largest field, each
    shifted by a constant so that the fractions come out, but for ties: zeros alone need not agree
    where three phases meet. Where `inside` (Z, Y, X) bool is given, fractions are those of the
    voxels inside.
    """
    labels = np.asarray(present, np.uint8)
    if fractions is None:
        return make_by_slabs(
            lambda a, b: labels[_largest(fields[:, a:b])], fields.shape[1:], np.uint8
        )
    size = fields[0].size if inside is None else count_true(inside)
    if len(present) == 2:
        upper = brightest_voxels(fields[0], round(size * float(fractions[1])), inside)
        return labels_of_upper(upper, present)
    return _in_place(
        assign_phases(fields, np.rint(size * fractions).astype(np.int64), inside), labels
    )


def phases_of(labels: np.ndarray, present: tuple[int, ...]) -> np.ndarray:
    """Return the phases (Z, Y, X) uint8 of labels, counted from 0; the labels themselves where
    they are that already.
    """
    if present == tuple(range(len(present))):
        return labels
    place = places_of(present)
    return make_by_slabs(lambda a, b: place[labels[a:b]], labels.shape, np.uint8)


def places_of(present: Sequence[int]) -> np.ndarray:
    """Return the phase, counted from 0, of every label, (256,) uint8."""
    found = np.zeros(256, np.uint8)
    found[list(present)] = np.arange(len(present))
    return found


def labels_of_phases(phases: np.ndarray, present: tuple[int, ...]) -> np.ndarray:
    """Return the labels of phases (Z, Y, X) uint8, in their memory."""
    return _in_place(phases, np.asarray(present, np.uint8))


def labels_of_upper(upper: np.ndarray, present: tuple[int, ...]) -> np.ndarray:
    """Return labels (uint8) where the second of two phases is marked, (Z, Y, X) bool, in its
    memory.
    """
    return labels_of_phases(upper.view(np.uint8), present)


def _largest(fields: np.ndarray) -> np.ndarray:
    """Return the phase of each voxel of (C, Z, Y, X): the largest field."""
    return (fields[0] > 0).astype(np.intp) if len(fields) == 1 else fields.argmax(0)


def _in_place(phases: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Replace phases (Z, Y, X) uint8, counted from 0, by their labels, in place."""

    def work(start: int, stop: int) -> None:
        phases[start:stop] = labels[phases[start:stop]]

    if not np.array_equal(labels, np.arange(len(labels))):
        for_plane_groups(work, phases.shape)
    return phases


def brightest_voxels(field: np.ndarray, count: int, inside: np.ndarray | None = None) -> np.ndarray:
    """Mark the `count` brightest voxels of (Z, Y, X) int16 (of those `inside`), to the voxel.

    Ties of the mixed value are broken by the sum over 3 x 3 x 3 voxels, and what ties even there by
    raster order.
    """
    total = rank_counts(field, inside)
    above = np.cumsum(total[::-1])[::-1]  # voxels of this rank and all brighter ones
    # the rank of the last; -1 where there are too few
    level = int(np.searchsorted(-above, -count, side="right")) - 1
    missing = count - int(above[level + 1]) if 0 <= level < len(above) - 1 else count
    chosen = memmap.empty(field.shape, np.uint8)
    tied = np.zeros(len(field), np.int64)  # in every plane
    where = np.empty((0, 0, 0), bool) if inside is None else inside

    def split(start: int, stop: int) -> _Sums:
        _split(field, where, level, chosen, tied, start, stop)
        planes = start + np.flatnonzero(tied[start:stop])
        return sum(
            (_Sums.of(_sums_of_tied(field, chosen, z, int(tied[z]))) for z in planes), _Sums.of([])
        )

    sums = sum_slabs(split, len(field))
    if len(sums.values):
        _take_tied(field, chosen, tied, sums, missing)
    return chosen.view(bool)


@dataclass(frozen=True)
class _Sums:
    """How often each of some sums occurs."""

    values: np.ndarray  # rising
    counts: np.ndarray

    @classmethod
    def of(cls, sums: Any) -> _Sums:
        return cls(*np.unique(np.asarray(sums, np.int32), return_counts=True))

    def __add__(self, other: _Sums) -> _Sums:
        values, place = np.unique(np.concatenate([self.values, other.values]), return_inverse=True)
        counts = np.zeros(len(values), np.int64)
        counts[place[: len(self.values)]] = self.counts
        counts[place[len(self.values) :]] += other.counts
        return _Sums(values, counts)


def _take_tied(
    field: np.ndarray, chosen: np.ndarray, tied: np.ndarray, sums: _Sums, missing: int
) -> None:
    """Take as many of the tied voxels as are missing: the largest sums, and of equal ones the
    first.
    """
    above = np.cumsum(sums.counts[::-1])[::-1]  # voxels of this sum and all larger ones
    place = int(np.searchsorted(-above, -missing, side="right")) - 1
    last = int(sums.values[place])
    left = missing - (int(above[place + 1]) if place + 1 < len(above) else 0)

    def take(start: int, stop: int) -> None:
        nonlocal left
        for z in start + np.flatnonzero(tied[start:stop]):
            found = _sums_of_tied(field, chosen, z, int(tied[z]))
            equal = found == last
            taken = (found > last) | (equal & (np.cumsum(equal) <= left))
            left -= min(left, int(np.count_nonzero(equal)))
            plane = chosen[z].reshape(-1)
            plane[plane == _TIED] = taken

    in_order(take, len(field))


def _sums_of_tied(field: np.ndarray, chosen: np.ndarray, z: int, count: int) -> np.ndarray:
    sums = np.empty(count, np.int32)
    _sum_tied(field, chosen[z], z, sums)
    return sums


@kernel
def _split(field, inside, level, chosen, tied, start, stop):
    """Write 1 above a rank, `_TIED` in it, else 0 (an empty `inside` means everywhere); count the
    tied of each plane.
    """
    row = np.empty(field.shape[2], np.int32)
    for z in range(start, stop):
        count = 0
        for y in range(field.shape[1]):
            row_of_ranks(field, z, y, row)
            for x in range(len(row)):
                if inside.size > 0 and not inside[z, y, x]:
                    chosen[z, y, x] = 0
                elif row[x] == level:
                    chosen[z, y, x] = _TIED
                    count += 1
                else:
                    chosen[z, y, x] = 1 if row[x] > level else 0
        tied[z] = count


@kernel
def _sum_tied(field, marks, z, sums):
    """Sum over 3 x 3 x 3 voxels around the tied voxels of a plane, in raster order."""
    _, Y, X = field.shape
    n = 0
    for y in range(Y):
        for x in range(X):
            if marks[y, x] == _TIED:
                sums[n] = _around(field, z, y, x)
                n += 1


@inline
def _around(field, z, y, x):
    """Sum over 3 x 3 x 3 voxels; a face's voxel is repeated beyond it."""
    Z, Y, X = field.shape
    total = np.int32(0)
    for dz in range(-1, 2):
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                total += field[
                    min(max(z + dz, 0), Z - 1),
                    min(max(y + dy, 0), Y - 1),
                    min(max(x + dx, 0), X - 1),
                ]
    return total


def assign_phases(
    fields: np.ndarray, counts: np.ndarray, inside: np.ndarray | None = None
) -> np.ndarray:
    """Return the largest of the fields (C, Z, Y, X) int16 at every voxel, (Z, Y, X) uint8, each
    shifted so that it wins `counts` (C,) of the voxels `inside`.
    """
    ranks = memmap.empty(fields.shape, np.uint16)
    for field, to in zip(fields, ranks, strict=True):
        mix_with_neighbours(field, out=to)
    where = np.empty((0, 0, 0), bool) if inside is None else inside
    shifts = np.zeros(len(fields), np.int64)
    kept, least = shifts, np.inf
    for _ in range(_ROUNDS):
        for phase in range(len(fields)):
            shifts[phase] = _lowest_bid(ranks, shifts, phase, where, int(counts[phase]))
        excess = np.abs(_wins(ranks, shifts, where) - counts).max()
        if excess >= least:
            break
        kept, least = shifts.copy(), excess
    winners = memmap.empty(fields.shape[1:], np.uint8)
    for_slabs(lambda start, stop: _write_winners(ranks, kept, winners, start, stop), len(winners))
    return winners


def _lowest_bid(
    ranks: np.ndarray, shifts: np.ndarray, phase: int, inside: np.ndarray, count: int
) -> int:
    """Return the shift that wins a phase `count` voxels, and one at least; 0 where
    there are none.
    """
    highest = int(np.delete(shifts, phase).max())  # so that bids lie within 65535 of it

    def tally(start: int, stop: int) -> np.ndarray:
        bids = np.zeros(_BIDS, np.int64)
        _count_bids(ranks, shifts, phase, inside, highest - (1 << 16) + 1, bids, start, stop)
        return bids

    up_to = np.cumsum(sum_slabs(tally, ranks.shape[1]))
    if not up_to[-1]:
        return 0
    wins = min(max(count, 1), int(up_to[-1])) - 1
    return int(np.searchsorted(up_to, wins, side="right")) + highest - (1 << 16) + 1


def _wins(ranks: np.ndarray, shifts: np.ndarray, inside: np.ndarray) -> np.ndarray:
    def tally(start: int, stop: int) -> np.ndarray:
        wins = np.zeros(len(ranks), np.int64)
        _count_wins(ranks, shifts, inside, wins, start, stop)
        return wins

    return np.asarray(sum_slabs(tally, ranks.shape[1]))


@kernel
def _count_bids(ranks, shifts, phase, inside, first, bids, start, stop):
    """Count the shifts, from `first` on, that lift the phase to its rivals; empty `inside` means
    everywhere.
    """
    C, _, Y, X = ranks.shape
    for z in range(start, stop):
        for y in range(Y):
            for x in range(X):
                if inside.size > 0 and not inside[z, y, x]:
                    continue
                best = np.int64(-(2**62))
                for c in range(C):
                    if c != phase:
                        best = max(best, ranks[c, z, y, x] + shifts[c])
                bids[best - ranks[phase, z, y, x] - first] += 1


@inline
def _winner(ranks, shifts, z, y, x):
    """Return the phase with the largest shifted rank, of equals the first."""
    chosen, best = 0, ranks[0, z, y, x] + shifts[0]
    for c in range(1, len(ranks)):
        value = ranks[c, z, y, x] + shifts[c]
        if value > best:
            chosen, best = c, value
    return chosen


@kernel
def _count_wins(ranks, shifts, inside, wins, start, stop):
    for z in range(start, stop):
        for y in range(ranks.shape[2]):
            for x in range(ranks.shape[3]):
                if inside.size == 0 or inside[z, y, x]:
                    wins[_winner(ranks, shifts, z, y, x)] += 1


@kernel
def _write_winners(ranks, shifts, winners, start, stop):
    for z in range(start, stop):
        for y in range(ranks.shape[2]):
            for x in range(ranks.shape[3]):
                winners[z, y, x] = _winner(ranks, shifts, z, y, x)
