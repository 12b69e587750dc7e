"""Which of several fields a voxel belongs to, where each is to win a given number of them.

Each field is shifted until it is the largest in as many voxels as it should, one after the other
until no count is off by more than ties: the auction for a transport problem with few goods. What a
phase would have to bid for a voxel is a whole number, so the lowest winning bid comes from counts
of the bids and nothing is sorted.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs, sum_slabs
from trabecula.synth.shared.histogram import mix_with_neighbours

_ROUNDS = 20  # at most; a handful settle it
_BIDS = 2 * (1 << 16) - 1  # that there are between ranks


def assign_phases(
    fields: np.ndarray, counts: np.ndarray, inside: np.ndarray | None = None
) -> np.ndarray:
    """The largest of the fields (C, Z, Y, X) int16 at every voxel, (Z, Y, X) uint8, each shifted so
    that it wins `counts` (C,) of the voxels `inside`."""
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
    for_slabs(lambda start, stop: _settle(ranks, kept, winners, start, stop), len(winners))
    return winners


def _lowest_bid(
    ranks: np.ndarray, shifts: np.ndarray, phase: int, inside: np.ndarray, count: int
) -> int:
    """The shift that wins a phase `count` voxels, and one at least; 0 where there are none."""
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
    """What the phase has to be lifted by to be as large as its rivals, counted from `first`; empty
    `inside` means everywhere.
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
    """Of equals the first."""
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
def _settle(ranks, shifts, winners, start, stop):
    for z in range(start, stop):
        for y in range(ranks.shape[2]):
            for x in range(ranks.shape[3]):
                winners[z, y, x] = _winner(ranks, shifts, z, y, x)
