"""Candidates of a place: patches of the exemplars, pooled by phase and sorted by descriptors, and
ranked by their distance d = alpha d_N + (1 - alpha) d_D (equations 4 to 6) in whole numbers.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.seeds import key
from trabecula.engine.compile import kernel
from trabecula.engine.random import philox
from trabecula.synth.quilt.patch_library import OverlapQuery, PackedLabels, PatchLibrary, mismatches
from trabecula.synth.quilt.period import positions_in_phase

SCALE = 65535
"""Whole range of a descriptor in the exemplars, as a number."""

WEIGHT = 1024
"""Sum of the weights of all descriptors."""

HELD = 6
"""Times all candidates that pools hold together, at most, about."""

_AROUND = 2  # voxels around a good candidate

_FAR = 8  # ranges beyond the exemplars' at which a target is taken as that far


@dataclass(frozen=True)
class CandidateDescriptors:
    """Descriptors of every candidate, in whole numbers.

    values : (k, n) uint16, 0 .. SCALE over the range of the candidates; the most important first.
    """

    names: tuple[str, ...]
    weights: np.ndarray  # (k,) int64
    low: np.ndarray  # (k,) range of the candidates
    high: np.ndarray
    values: np.ndarray

    @classmethod
    def measure(
        cls, library: PatchLibrary, names: Sequence[str], weights: Mapping[str, float]
    ) -> CandidateDescriptors:
        """Measure all candidates of the exemplars, one exemplar after the other in raster order."""
        order = sorted(names, key=lambda name: -weights.get(name, 1.0))
        count = sum(int(np.prod(counts)) for counts in library.counts)
        values = np.empty((len(order), count), np.uint16)
        low, high = np.zeros(len(order)), np.ones(len(order))
        for row, name in enumerate(order):
            found = np.concatenate(
                [
                    library.describe_patches(number, name).ravel()
                    for number in range(len(library.images))
                ]
            )
            low[row], high[row] = float(found.min()), float(found.max())
            values[row] = np.rint((found - low[row]) * (SCALE / max(high[row] - low[row], 1e-12)))
        share = np.array([weights.get(name, 1.0) for name in order])
        parts = np.rint(share / max(share.sum(), 1e-12) * WEIGHT).astype(np.int64)
        return cls(tuple(order), parts, low, high, values)

    def differences(self, number: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return weighted differences (equation 6) of candidates given by their number, int64."""
        off = np.abs(self.values[:, number].astype(np.int64) - target[:, None])
        return (self.weights[:, None] * off).sum(axis=0)

    def scale_targets(self, targets: Mapping[str, float]) -> np.ndarray:
        """Return a place's targets on the candidates' scale, (k,) int64; targets beyond the
        candidates lie outside 0 .. SCALE.
        """
        target = np.array([targets[name] for name in self.names])
        span = np.maximum(self.high - self.low, 1e-12)
        far = _FAR * SCALE
        return np.clip(np.rint((target - self.low) / span * SCALE), -far, far).astype(np.int64)


@dataclass(frozen=True)
class CandidatePool:
    """Candidates of one phase: where each begins in the stack, and its descriptors, sorted by the
    first descriptor.
    """

    at: np.ndarray  # (n,) int32
    values: np.ndarray  # (k, n) uint16

    def nearest(
        self, target: np.ndarray, weights: np.ndarray, count: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return up to `count` candidates nearest in descriptors, and their weighted differences
        (equation 6) as int64.
        """
        count = min(count, len(self.at))
        wide = count if len(target) == 1 else len(self.at)
        first = _nearest_run(self.values[0], target[0], wide)
        chosen, differences = _nearest(self.values, weights, target, first, wide, count)
        return self.at[chosen], differences


class CandidatePools:
    """The pools of a run, one for every phase of its places."""

    def __init__(self, library: PatchLibrary, descriptors: CandidateDescriptors, seed: int) -> None:
        self.counts = library.counts
        self.strides, self.descriptors = library.strides, descriptors
        self.periods, self.shifts = library.periods, library.shifts
        self.shape = library.stack.shape
        self.limits = np.array(self.counts)
        self.before = np.concatenate(
            [[0], np.cumsum([int(np.prod(counts)) for counts in self.counts])]
        )
        self.stage = key(seed, "quilt/order")
        self.nearby = _nearby_offsets(library)
        self._made: dict[tuple[int, ...], CandidatePool] = {}

    def offset_candidates(self, at: np.ndarray, away: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return candidates at offsets `away` (n, 3) from the patches that begin `at` (n,), without
        those that do not fit: where they begin in the stack (int32), and their numbers (int64).
        """
        source, *place = np.unravel_index(at, self.shape)
        z, y, x = (here + by for here, by in zip(place, away.T, strict=True))
        counts = self.limits[source].T
        fits = (z >= 0) & (y >= 0) & (x >= 0) & (z < counts[0]) & (y < counts[1]) & (x < counts[2])
        first = source * self.strides[0] + z * self.strides[1] + y * self.strides[2] + x
        numbers = self.before[source] + (z * counts[1] + y) * counts[2] + x
        return first[fits].astype(np.int32), numbers[fits]

    def nearby_candidates(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return candidates a few voxels from these, as in `offset_candidates`; none along an axis
        with a period.
        """
        where, numbers = self.offset_candidates(
            np.repeat(at, len(self.nearby)), np.tile(self.nearby, (len(at), 1))
        )
        where, first = np.unique(where, return_index=True)
        return where, numbers[first]

    def drop_large_pools(self) -> None:
        """Drop the pools where together they hold many times all candidates, as those of a lattice
        whose period is no whole number; they are built again on request.
        """
        if sum(len(pool.at) for pool in self._made.values()) > HELD * self.before[-1]:
            self._made.clear()

    def pool(self, phase: tuple[int, ...]) -> CandidatePool:
        """Return the pool of a phase."""
        if phase not in self._made:
            self._made[phase] = self._build_pool(phase)
        return self._made[phase]

    def _build_pool(self, phase: tuple[int, ...]) -> CandidatePool:
        """Build the pool of a phase."""
        at, rows = [], []
        for source, counts in enumerate(self.counts):
            axes = [
                positions_in_phase(count, part, shift, period)
                for count, part, shift, period in zip(
                    counts, phase, self.shifts[source], self.periods, strict=True
                )
            ]
            z, y, x = np.ix_(*axes)
            first = source * self.strides[0] + z * self.strides[1] + y * self.strides[2] + x
            at.append(first.astype(np.int32).ravel())
            rows.append(
                (self.before[source] + (z * counts[1] + y) * counts[2] + x).astype(np.int32).ravel()
            )
        where = np.concatenate(at)
        mixed = _hashes(np.uint64(self.stage), where)
        values = self.descriptors.values[:, np.concatenate(rows)]
        order = np.lexsort((mixed, values[0]))
        return CandidatePool(where[order], np.ascontiguousarray(values[:, order]))


def _nearby_offsets(library: PatchLibrary) -> np.ndarray:
    """Return (n, 3) offsets to the candidates around one; none along an axis with a period."""
    reach = [
        0 if period or size == 1 else _AROUND
        for period, size in zip(library.periods, library.box, strict=True)
    ]
    axes = np.meshgrid(*(np.arange(-by, by + 1) for by in reach), indexing="ij")
    moves = np.stack([axis.ravel() for axis in axes], axis=1)
    return moves[(moves != 0).any(axis=1)]


@kernel
def _hashes(stage, at):
    """Return a random word for every candidate, so that equal descriptors have a random order."""
    found = np.empty(len(at), np.uint32)
    for n in range(len(at)):
        found[n] = philox(stage, at[n], 0, 0, 0)[0]
    return found


@kernel
def _nearest_run(values, target, count):
    """Return where the `count` values nearest to a target begin, among sorted values."""
    low, high = 0, len(values) - count
    while low < high:
        middle = (low + high) // 2
        if target - values[middle] > values[middle + count] - target:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def _nearest(values, weights, target, first, wide, count):
    """Select, from a run of `wide` candidates, the `count` with the smallest weighted difference,
    in the run's order.
    """
    every = np.empty(wide, np.int64)
    for n in range(wide):
        total = np.int64(0)
        for k in range(len(target)):
            total += weights[k] * abs(np.int64(values[k, first + n]) - target[k])
        every[n] = total
    chosen, found = np.empty(count, np.int64), np.empty(count, np.int64)
    if count == wide:
        for n in range(count):
            chosen[n], found[n] = first + n, every[n]
        return chosen, found
    shift = 0
    top = np.max(every)
    while (top >> shift) >= 65536:
        shift += 1
    tally = np.zeros(65536, np.int64)
    for n in range(wide):
        tally[every[n] >> shift] += 1
    below, limit = np.int64(0), 0
    while below + tally[limit] < count:
        below += tally[limit]
        limit += 1
    room, taken = count - below, 0
    for n in range(wide):
        step = every[n] >> shift
        if step > limit:
            continue
        if step == limit:
            if room == 0:
                continue
            room -= 1
        chosen[taken], found[taken] = first + n, every[n]
        taken += 1
    return chosen, found


_PARTS = 1 << 44  # a distance of 1

_GOOD = 16  # candidates around which others are looked at

_FEW = 1024  # candidates that are not sifted

_KEPT = 8  # one in so many passes the sieve

_VARIED = 1 << 10  # steps in which a distance varies by chance

_REFUSED = np.iinfo(np.int64).max


@dataclass
class RankedCandidates:
    """Candidates with their distances.

    Attributes
    ----------
    at : (n,) int32
        First voxel in the stack.
    mismatch : (n,) int32
        Voxels of the overlap that differ.
    difference : (n,) int64
        Weighted difference of descriptors, 0 .. SCALE * WEIGHT over the exemplars' range.
    score : (n,) int64
        Distance; those that were taken off are at the end of the range.
    complete : bool
        Whether these are all candidates of the pool.
    """

    at: np.ndarray
    mismatch: np.ndarray
    difference: np.ndarray
    score: np.ndarray
    complete: bool

    def least_mismatch(self) -> int:
        """Return the least mismatch of all, voxels."""
        return int(self.mismatch.min()) if len(self.mismatch) else 0

    def take_nearest(self, count: int) -> np.ndarray:
        """Take off the nearest `count` candidates that are left (of equals the first)."""
        count = min(count, len(self.score))
        near = _smallest(self.score, count) if count else np.empty(0, np.int64)
        near = near[self.score[near] < _REFUSED]
        self.score[near] = _REFUSED
        return near


@dataclass(frozen=True)
class CandidateRanker:
    """Ranking of the candidates of every place."""

    words: PackedLabels
    pools: CandidatePools
    descriptors: CandidateDescriptors
    alpha: float
    variety: float
    sieve: int
    stage: np.uint64
    strict: bool

    def rank(
        self,
        query: OverlapQuery,
        pool: CandidatePool,
        target: np.ndarray,
        *,
        place: int,
        count: int,
        before: tuple[np.ndarray, np.ndarray],
        without: Collection[int],
    ) -> RankedCandidates:
        """Rank the candidates of a place.

        They are the `count` candidates of a pool nearest in descriptors (of many, those that pass
        the sieve), those that continue the patches laid `before` (first voxels and offsets), and
        those around the best of all these. With target fields, the latter two differ from the
        targets no more than the first do.
        """
        at, difference = pool.nearest(target, self.descriptors.weights, count)
        complete = len(at) == len(pool.at)
        limit = int(difference.max()) if self.strict else _REFUSED
        if self.sieve > 1 and len(at) > _FEW and query.voxels:
            at, difference = self._sieve_candidates(query, at, difference)
        more, more_off = self._limit_difference(
            *self.pools.offset_candidates(*before), target, limit
        )
        at, difference = np.concatenate([more, at]), np.concatenate([more_off, difference])
        mismatch = mismatches(self.words, query, at)
        score = self._distances_of(query, mismatch, difference)
        if query.voxels and len(self.pools.nearby):
            best = at[_smallest(score, min(_GOOD, len(score)))]
            more, more_off = self._limit_difference(
                *self.pools.nearby_candidates(best), target, limit
            )
            more_apart = mismatches(self.words, query, more)
            at, mismatch = np.concatenate([at, more]), np.concatenate([mismatch, more_apart])
            difference = np.concatenate([difference, more_off])
            score = np.concatenate([score, self._distances_of(query, more_apart, more_off)])
        if self.variety:
            _vary(score, at, self.stage, place, round(self.variety * _VARIED))
        if without:
            score[np.isin(at, np.fromiter(without, np.int64))] = _REFUSED
        return RankedCandidates(at, mismatch, difference, score, complete)

    def _sieve_candidates(
        self, query: OverlapQuery, at: np.ndarray, difference: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Keep the candidates that are nearest by a part of the overlap; return them and their
        differences.
        """
        # so that words of one candidate are near those of the next in memory
        order = np.argsort(at)
        at, difference = at[order], difference[order]
        part = query.every_nth(self.sieve)
        score = self._distances_of(part, mismatches(self.words, part, at), difference)
        kept = max(_FEW, len(at) // _KEPT)
        near = score <= np.partition(score, kept - 1)[kept - 1]
        return at[near], difference[near]

    def _limit_difference(
        self, at: np.ndarray, numbers: np.ndarray, target: np.ndarray, limit: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Keep the candidates whose difference is at most `limit`; return them and their
        differences.
        """
        off = self.descriptors.differences(numbers, target)
        near = off <= limit
        return at[near], off[near]

    def _distances_of(
        self, query: OverlapQuery, mismatch: np.ndarray, difference: np.ndarray
    ) -> np.ndarray:
        """Return the distances of equation (4), int64."""
        by_mismatch = round(self.alpha * _PARTS / max(query.voxels, 1))
        by_difference = round((1 - self.alpha) * _PARTS / (SCALE * WEIGHT))
        return mismatch * np.int64(by_mismatch) + difference * by_difference


@kernel
def _smallest(score, count):
    """Return where the smallest are, rising; of equals the first."""
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
    """Increase distances by a random share."""
    for n in range(len(score)):
        by = np.int64((philox(stage, place, at[n], 0, 0)[0] * np.uint64(most)) >> np.uint64(32))
        score[n] += (score[n] >> 10) * by
