"""Candidates: the positions of a patch in the exemplars, ordered so that those near a target are
found at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.seeds import key
from trabecula.engine.compile import kernel
from trabecula.engine.random import philox
from trabecula.synth.quilt.patch_library import Learnt
from trabecula.synth.quilt.period import in_phase

SCALE = 65535
"""What a descriptor's whole range in the exemplars is, as a number."""
WEIGHT = 1024
"""What the weights of all descriptors sum up to."""
HELD = 6
"""Times all candidates that pools hold together, about."""
_AROUND = 2  # voxels around a good candidate
_FAR = 8  # ranges beyond the exemplars' at which a target is taken as that far


@dataclass(frozen=True)
class Descriptors:
    """What every candidate's descriptors are, in whole numbers.

    values : (k, n) uint16, 0 .. SCALE over what the candidates hold; the most important first.
    """

    names: tuple[str, ...]
    weights: np.ndarray  # (k,) int64
    low: np.ndarray  # (k,) of what the candidates hold
    high: np.ndarray
    values: np.ndarray

    @classmethod
    def of(cls, learnt: Learnt, names: Sequence[str], weights: Mapping[str, float]) -> Descriptors:
        """Of all candidates of the exemplars, one exemplar after the other in raster order."""
        order = sorted(names, key=lambda name: -weights.get(name, 1.0))
        count = sum(int(np.prod(counts)) for counts in learnt.counts)
        values = np.empty((len(order), count), np.uint16)
        low, high = np.zeros(len(order)), np.ones(len(order))
        for row, name in enumerate(order):
            found = np.concatenate(
                [learnt.described(image, name).ravel() for image in learnt.images]
            )
            low[row], high[row] = float(found.min()), float(found.max())
            values[row] = np.rint((found - low[row]) * (SCALE / max(high[row] - low[row], 1e-12)))
        share = np.array([weights.get(name, 1.0) for name in order])
        parts = np.rint(share / max(share.sum(), 1e-12) * WEIGHT).astype(np.int64)
        return cls(tuple(order), parts, low, high, values)

    def differences(self, number: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Weighted differences (equation 6) of candidates given by their number, int64."""
        off = np.abs(self.values[:, number].astype(np.int64) - target[:, None])
        return (self.weights[:, None] * off).sum(axis=0)

    def scaled(self, targets: Mapping[str, float]) -> np.ndarray:
        """(k,) int64: a place's targets on the candidates' scale; what they do not hold lies
        outside 0 .. SCALE.
        """
        asked = np.array([targets[name] for name in self.names])
        span = np.maximum(self.high - self.low, 1e-12)
        far = _FAR * SCALE
        return np.clip(np.rint((asked - self.low) / span * SCALE), -far, far).astype(np.int64)


@dataclass(frozen=True)
class Pool:
    """Candidates of one phase: where each begins in the stack, and its descriptors, by the first
    descriptor rising.
    """

    at: np.ndarray  # (n,) int32
    values: np.ndarray  # (k, n) uint16

    def nearest(
        self, target: np.ndarray, weights: np.ndarray, count: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Up to `count` candidates nearest in descriptors, and their weighted differences (equation
        6) as int64.
        """
        count = min(count, len(self.at))
        wide = count if len(target) == 1 else len(self.at)
        first = _nearest_run(self.values[0], target[0], wide)
        chosen, differences = _nearest(self.values, weights, target, first, wide, count)
        return self.at[chosen], differences


class Pools:
    """The pools of a run, one for every phase that its places have."""

    def __init__(self, learnt: Learnt, descriptors: Descriptors, seed: int) -> None:
        self.counts = learnt.counts
        self.strides, self.descriptors = learnt.strides, descriptors
        self.periods, self.shifts = learnt.periods, learnt.shifts
        self.shape = learnt.stack.shape
        self.limits = np.array(self.counts)
        self.before = np.concatenate(
            [[0], np.cumsum([int(np.prod(counts)) for counts in self.counts])]
        )
        self.stage = key(seed, "quilt/order")
        self.moves = _moves(learnt)
        self._made: dict[tuple[int, ...], Pool] = {}

    def beside(self, at: np.ndarray, away: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Candidates that lie `away` (n, 3) from the patches that begin `at` (n,), those without
        room left out: where they begin in the stack (int32), and their numbers (int64).
        """
        source, *place = np.unravel_index(at, self.shape)
        z, y, x = (here + by for here, by in zip(place, away.T, strict=True))
        counts = self.limits[source].T
        fits = (z >= 0) & (y >= 0) & (x >= 0) & (z < counts[0]) & (y < counts[1]) & (x < counts[2])
        first = source * self.strides[0] + z * self.strides[1] + y * self.strides[2] + x
        numbers = self.before[source] + (z * counts[1] + y) * counts[2] + x
        return first[fits].astype(np.int32), numbers[fits]

    def around(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Candidates a few voxels from these, as `beside` gives them; along an axis with a period
        there are none.
        """
        where, numbers = self.beside(
            np.repeat(at, len(self.moves)), np.tile(self.moves, (len(at), 1))
        )
        where, first = np.unique(where, return_index=True)
        return where, numbers[first]

    def forget(self) -> None:
        """Let go of the pools where together they hold many times all candidates, as those of a
        lattice do whose period is no whole number; they are made again when they are asked for.
        """
        if sum(len(pool.at) for pool in self._made.values()) > HELD * self.before[-1]:
            self._made.clear()

    def of(self, phase: tuple[int, ...]) -> Pool:
        """The pool of a phase."""
        if phase not in self._made:
            self._made[phase] = self._pool(phase)
        return self._made[phase]

    def _pool(self, phase: tuple[int, ...]) -> Pool:
        at, rows = [], []
        for source, counts in enumerate(self.counts):
            axes = [
                in_phase(count, part, shift, period)
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
        return Pool(where[order], np.ascontiguousarray(values[:, order]))


def _moves(learnt: Learnt) -> np.ndarray:
    """(n, 3) ways to the candidates around one; none along an axis with a period."""
    reach = [
        0 if period or size == 1 else _AROUND
        for period, size in zip(learnt.periods, learnt.box, strict=True)
    ]
    axes = np.meshgrid(*(np.arange(-by, by + 1) for by in reach), indexing="ij")
    moves = np.stack([axis.ravel() for axis in axes], axis=1)
    return moves[(moves != 0).any(axis=1)]


@kernel
def _hashes(stage, at):
    found = np.empty(len(at), np.uint32)
    for n in range(len(at)):
        found[n] = philox(stage, at[n], 0, 0, 0)[0]
    return found


@kernel
def _nearest_run(values, target, count):
    """Where the `count` values nearest to a target begin, among values that rise."""
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
    """Of a run of `wide` candidates the `count` with the smallest weighted difference, in the run's
    order.
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
