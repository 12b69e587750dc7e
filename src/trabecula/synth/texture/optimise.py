"""Rounds of search and vote on one grid of neighbourhoods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.engine.tiles import for_slabs
from trabecula.synth.shared.fields import FULL
from trabecula.synth.shared.histogram import Histogram, match_histogram
from trabecula.synth.shared.nearest import index_histogram, k_nearest, reranked
from trabecula.synth.shared.neighbourhoods import SCALE, project
from trabecula.synth.shared.pyramid import double
from trabecula.synth.texture.config import TextureConfig
from trabecula.synth.texture.joints import joined, known_of, mixed_histograms, surroundings
from trabecula.synth.texture.kernels import search, start_matches, vote
from trabecula.synth.texture.region import Region
from trabecula.synth.texture.sources import Candidates


@dataclass(frozen=True)
class Grid:
    """The output's neighbourhoods at one resolution and width: what does not change from round to round."""

    candidates: Candidates
    region: Region  # covered
    shape: tuple[int, ...]
    active: np.ndarray  # bool, `shape`
    targets: tuple[Histogram, ...]  # that the free voxels are to have, one a channel

    @classmethod
    def over(cls, region: Region, candidates: Candidates) -> Grid:
        """The neighbourhoods of a region, which is continued to what they cover."""
        width, step = candidates.basis.width, candidates.step
        covered, shape = region.covered(width=width, step=step), region.grid(width=width, step=step)
        active, targets = covered.active(shape, width=width, step=step), candidates.stack.histograms
        if covered.free is not None and covered.low is not None and covered.high is not None:
            near = surroundings(covered.free, known_of(covered.free, covered.low, covered.high), width)
            made = int(np.count_nonzero(covered.free))
            targets = mixed_histograms(targets, covered.low, covered.high, near, made)
        return cls(candidates, covered, shape, active, targets)

    @property
    def reach(self) -> tuple[int, ...]:
        """Voxels that the neighbourhoods cover, those beyond an axis that wraps counted again."""
        width, step = self.candidates.basis.width, self.candidates.step
        return tuple((count - 1) * step + width for count in self.shape)


@dataclass(frozen=True)
class State:
    """The output at one resolution."""

    match: np.ndarray  # (sz, sy, sx) int32, index of the nearest neighbourhood per site
    votes: np.ndarray  # (C, Z, Y, X) int16, the weighted mean of what overlaps, times 256
    field: np.ndarray  # (C, Z, Y, X) int8, the same with the exemplar's histogram


def wrapped(grid: Grid, field: np.ndarray) -> np.ndarray:
    """A field (C, Z, Y, X) with its beginning repeated beyond each axis that wraps, as far as neighbourhoods reach."""
    beyond = [(0, 0)] + [(0, max(0, far - side)) for far, side in zip(grid.reach, field.shape[1:], strict=True)]
    return np.pad(field, beyond, mode="wrap") if any(far for _, far in beyond) else field


def features_of(grid: Grid, field: np.ndarray) -> np.ndarray:
    """The feature vectors of the output's neighbourhoods."""
    active = None if grid.active.all() else grid.active
    return project(wrapped(grid, field), grid.candidates.basis, step=grid.candidates.step, active=active)


def nearest_matches(
    grid: Grid, old: np.ndarray, features: np.ndarray, *, index_penalty: float
) -> tuple[np.ndarray, np.ndarray]:
    """Section 4.2: of the k nearest neighbourhoods the best by the modified distance; matches and their distances."""
    candidates = grid.candidates
    queries = features[grid.active]
    index, distance = k_nearest(queries, candidates.prepared)
    shares = index_histogram(old[grid.active], len(candidates.features))
    count = len(candidates.numbers)
    chosen, apart = reranked(index, distance, shares, weight=index_penalty * count, theta=1 / count)
    match, found = old.copy(), np.zeros(old.shape, np.int32)
    match[grid.active], found[grid.active] = chosen, apart
    return match, found


def random_matches(grid: Grid, stage: np.uint64) -> np.ndarray:
    """Random patches: an independent candidate per site."""
    numbers = grid.candidates.numbers
    chosen = np.empty(grid.shape, np.int32)
    start_matches(chosen, len(numbers), stage)
    return numbers[chosen].astype(np.int32)


def refined(field: np.ndarray, wraps: tuple[bool, ...], *, distances: bool) -> np.ndarray:
    """A field (C, Z, Y, X) int8 at twice the resolution; a distance, which counts in voxels, doubles too."""
    doubled = double(field, wraps)
    return np.clip(doubled.astype(np.int16) * 2, -FULL, FULL).astype(np.int8) if distances else doubled


def swept(
    grid: Grid,
    match: np.ndarray,
    field: np.ndarray,
    config: TextureConfig,
    *,
    stage: np.uint64,
    first: int,
    count: int,
) -> tuple[np.ndarray, np.ndarray]:
    """`count` sweeps of the coherent search on a field, numbered from `first`: new matches and their distances."""
    features = features_of(grid, field)
    for sweep in range(first, first + count):
        match, distance = searched(
            grid, match, features, stage=stage, sweep=sweep, tries=config.tries, index_penalty=config.index_penalty
        )
    return match, distance


def searched(
    grid: Grid,
    old: np.ndarray,
    features: np.ndarray,
    *,
    stage: np.uint64,
    sweep: int,
    tries: int,
    index_penalty: float,
) -> tuple[np.ndarray, np.ndarray]:
    """One sweep of the coherent search: new matches and their distances."""
    candidates = grid.candidates
    match = np.empty_like(old)
    distance = np.empty(old.shape, np.int32)
    penalty = penalties(old, grid, index_penalty)
    ratio = candidates.step // candidates.stride

    def work(start: int, stop: int) -> None:
        search(
            features,
            candidates.features,
            penalty,
            grid.active,
            old,
            match,
            distance,
            candidates.shape,
            ratio,
            grid.region.wraps,
            stage,
            sweep,
            tries,
            start,
            stop,
        )

    for_slabs(work, len(old), least=2)
    return match, distance


def penalties(match: np.ndarray, grid: Grid, weight: float) -> np.ndarray:
    """w_d = 1 + weight * max(0, H / theta - 1), theta = 1 / |E| (section 4.2), frozen for one sweep."""
    allowed = grid.candidates.allowed
    used = match.ravel() if grid.active.all() else match[grid.active]
    even = np.float32(np.count_nonzero(allowed) / max(1, used.size))
    share = np.bincount(used, minlength=len(allowed)).astype(np.float32) * even
    factors = np.float32(1) + np.float32(weight) * np.maximum(share - 1, 0)
    return np.where(allowed, factors, np.float32(np.inf))


def robust_weights(grid: Grid, distance: np.ndarray, robustness: float) -> np.ndarray:
    """w_p = d^(r - 2) of the neighbourhood distance d (equation 2 without its trace), as integers of 1 .. 1023.

    Through a table over the ratio to the mean, so that no power function is asked for a bit it might round otherwise.
    Sites that are not active weigh 0.
    """
    # One quantum per voxel keeps an exact match from outvoting everything.
    basis = grid.candidates.basis
    floor = SCALE**2 * len(basis.vectors) * basis.grain**3
    count = max(1, int(np.count_nonzero(grid.active)))
    mean = int(distance.sum(dtype=np.int64)) // count + floor
    ratio = np.clip((distance.astype(np.int64) + floor) * 256 // mean, 1, 4095)
    table = np.clip(np.rint(255 * (np.arange(4096).clip(1) / 256) ** ((robustness - 2) / 2)), 1, 1023)
    return np.where(grid.active, table.astype(np.int32)[ratio], np.int32(0))


def cast(grid: Grid, match: np.ndarray, weights: np.ndarray, *, trim: int = 0, histogram: bool = True) -> State:
    """Vote and match the histogram: the matches become a field."""
    votes = joined_votes(grid, voted(grid, match, weights, trim=trim))
    return State(match, votes, rematched(grid, votes, histogram=histogram))


def joined_votes(grid: Grid, votes: np.ndarray) -> np.ndarray:
    """Votes without a step beside what is known."""
    region = grid.region
    if region.free is None or region.low is None or region.high is None:
        return votes
    return joined(votes, region.low, region.high, region.free)


def rematched(grid: Grid, votes: np.ndarray, *, histogram: bool = True) -> np.ndarray:
    """Votes (C, Z, Y, X) int16 as a field in int8, with the exemplar's histograms where asked, and what is known put back."""
    region = grid.region
    if histogram:
        matched = [match_histogram(mean, target, region.free) for mean, target in zip(votes, grid.targets, strict=True)]
        return region.bounded(np.stack(matched))
    return region.bounded(np.clip((votes.astype(np.int32) + 128) >> 8, -127, 127).astype(np.int8))


def voted(grid: Grid, match: np.ndarray, weights: np.ndarray, *, trim: int = 0) -> np.ndarray:
    """The weighted mean of the matched neighbourhoods, times 256; 0 where no active one reaches."""
    candidates, region = grid.candidates, grid.region
    stack, width = candidates.stack, candidates.basis.width
    votes = np.empty((len(stack.field), *region.shape), np.int16)

    def work(start: int, stop: int) -> None:
        plane = np.empty((len(votes) + 1, *grid.reach[1:]), np.int32)
        vote(
            stack.field,
            match,
            weights,
            candidates.shape,
            candidates.stride,
            candidates.step,
            width,
            trim,
            region.wraps,
            plane,
            votes,
            start,
            stop,
        )

    for_slabs(work, region.shape[0])
    return votes
