"""Counting what is voted for: a plain function on arrays."""

from __future__ import annotations

from trabecula.engine.compile import kernel


@kernel
def count_bins(votes, free, counts, start, stop):
    """How many voxels of planes start..stop of (C, Z, Y, X) int16 lie in each of 16 equal bins,
    added to counts (C, 16).

    Only those that are `free` (Z, Y, X) bool count; empty means all.
    """
    for c in range(votes.shape[0]):
        for z in range(start, stop):
            for y in range(votes.shape[2]):
                for x in range(votes.shape[3]):
                    if free.size == 0 or free[z, y, x]:
                        counts[c, (votes[c, z, y, x] >> 12) + 8] += 1
