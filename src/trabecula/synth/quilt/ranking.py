"""The candidates of a place by their distance d = alpha d_N + (1 - alpha) d_D (equations 4 to 6),
in whole numbers.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.random import philox
from trabecula.synth.quilt.bit_packing import Query, Words, mismatches
from trabecula.synth.quilt.candidate_pools import SCALE, WEIGHT, Descriptors, Pool, Pools

_PARTS = 1 << 44  # a distance of 1
_GOOD = 16  # candidates around which others are looked at
_FEW = 1024  # candidates that are not sifted
_KEPT = 8  # one in so many passes the sieve
_VARIED = 1 << 10  # steps in which a distance varies by chance
_REFUSED = np.iinfo(np.int64).max


@dataclass
class Ranked:
    """Candidates with their distances.

    Attributes
    ----------
    at : (n,) int32
        First voxel in the stack.
    mismatch : (n,) int32
        Voxels of the overlap that differ.
    difference : (n,) int64
        Weighted difference of descriptors, 0 .. SCALE * WEIGHT over what the exemplars hold.
    score : (n,) int64
        Distance; those that were taken off are at the end of the range.
    complete : bool
        Whether these are all candidates that there are.
    """

    at: np.ndarray
    mismatch: np.ndarray
    difference: np.ndarray
    score: np.ndarray
    complete: bool

    def least(self) -> int:
        """The least mismatch among all, in voxels."""
        return int(self.mismatch.min()) if len(self.mismatch) else 0

    def taken_off(self, count: int) -> np.ndarray:
        """The nearest `count` candidates that are left (of equals the first), which are left out
        from now on.
        """
        count = min(count, len(self.score))
        near = _smallest(self.score, count) if count else np.empty(0, np.int64)
        near = near[self.score[near] < _REFUSED]
        self.score[near] = _REFUSED
        return near


@dataclass(frozen=True)
class Ranker:
    """What the candidates of every place are ranked by."""

    words: Words
    pools: Pools
    descriptors: Descriptors
    alpha: float
    variety: float
    sieve: int
    stage: np.uint64
    strict: bool

    def ranked(
        self,
        query: Query,
        pool: Pool,
        asked: np.ndarray,
        *,
        place: int,
        count: int,
        before: tuple[np.ndarray, np.ndarray],
        without: Collection[int],
    ) -> Ranked:
        """The `count` candidates of a pool that are nearest in descriptors (of many, those that
        pass the sieve), those that go on with pieces laid `before` (first voxels and offsets), and
        what lies around the best of all these; where fields are asked for, only those that differ
        from them no more than the first do.
        """
        at, difference = pool.nearest(asked, self.descriptors.weights, count)
        complete = len(at) == len(pool.at)
        limit = int(difference.max()) if self.strict else _REFUSED
        if self.sieve > 1 and len(at) > _FEW and query.voxels:
            at, difference = self._sifted(query, at, difference)
        more, more_off = self._within(*self.pools.beside(*before), asked, limit)
        at, difference = np.concatenate([more, at]), np.concatenate([more_off, difference])
        mismatch = mismatches(self.words, query, at)
        score = self._scored(query, mismatch, difference)
        if query.voxels and len(self.pools.moves):
            best = at[_smallest(score, min(_GOOD, len(score)))]
            more, more_off = self._within(*self.pools.around(best), asked, limit)
            more_apart = mismatches(self.words, query, more)
            at, mismatch = np.concatenate([at, more]), np.concatenate([mismatch, more_apart])
            difference = np.concatenate([difference, more_off])
            score = np.concatenate([score, self._scored(query, more_apart, more_off)])
        if self.variety:
            _vary(score, at, self.stage, place, round(self.variety * _VARIED))
        if without:
            score[np.isin(at, np.fromiter(without, np.int64))] = _REFUSED
        return Ranked(at, mismatch, difference, score, complete)

    def _sifted(
        self, query: Query, at: np.ndarray, difference: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Those candidates, and their differences, that are nearest by a part of the overlap."""
        # so that words of one candidate are near those of the next in memory
        order = np.argsort(at)
        at, difference = at[order], difference[order]
        part = query.every(self.sieve)
        score = self._scored(part, mismatches(self.words, part, at), difference)
        kept = max(_FEW, len(at) // _KEPT)
        near = score <= np.partition(score, kept - 1)[kept - 1]
        return at[near], difference[near]

    def _within(
        self, at: np.ndarray, numbers: np.ndarray, asked: np.ndarray, limit: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Those of some candidates whose difference is at most `limit`, and their differences."""
        off = self.descriptors.differences(numbers, asked)
        near = off <= limit
        return at[near], off[near]

    def _scored(self, query: Query, mismatch: np.ndarray, difference: np.ndarray) -> np.ndarray:
        """Equation (4), int64."""
        by_mismatch = round(self.alpha * _PARTS / max(query.voxels, 1))
        by_difference = round((1 - self.alpha) * _PARTS / (SCALE * WEIGHT))
        return mismatch * np.int64(by_mismatch) + difference * by_difference


@kernel
def _smallest(score, count):
    """Where the smallest are, rising; of equals the first."""
    found = np.empty(count, np.int64)
    kept = np.empty(count, np.int64)
    held = 0
    for n in range(len(score)):
        if held == count and score[n] >= kept[held - 1]:
            continue
        k = held if held < count else held - 1
        while k > 0 and kept[k - 1] > score[n]:
            kept[k], found[k] = kept[k - 1], found[k - 1]
            k -= 1
        kept[k], found[k] = score[n], n
        held = min(held + 1, count)
    return found


@kernel
def _vary(score, at, stage, place, most):
    """Distances become greater by a random share."""
    for n in range(len(score)):
        by = np.int64((philox(stage, place, at[n], 0, 0)[0] * np.uint64(most)) >> np.uint64(32))
        score[n] += (score[n] >> 10) * by
