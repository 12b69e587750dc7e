"""The output's neighbourhoods at one resolution, and the search for the nearest one of the exemplar for each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.engine.tiles import for_slabs
from trabecula.synth.shared.histogram import Histogram
from trabecula.synth.shared.joints import known_of, mixed_histograms, surroundings
from trabecula.synth.shared.matching.kernels import search, start_matches
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Candidates
from trabecula.synth.shared.nearest import index_histogram, k_nearest, reranked
from trabecula.synth.shared.neighbourhoods import covered_shape, project


@dataclass(frozen=True)
class Grid:
    """The output's neighbourhoods at one resolution and width: what does not change from round to round."""

    candidates: Candidates
    region: Region  # covered
    shape: tuple[int, ...]
    active: np.ndarray  # bool, `shape`
    targets: tuple[Histogram, ...]  # that the free voxels are to have, one a channel
    guide: np.ndarray | None = None  # (`shape`, K) int16: more features, of the place and not of the field

    @classmethod
    def over(cls, region: Region, candidates: Candidates, targets: tuple[Histogram, ...] | None = None) -> Grid:
        """The neighbourhoods of a region, which is continued to what they cover. Targets default to `targets_of` the region."""
        box, steps = candidates.basis.box, candidates.steps
        covered, shape = region.covered(box=box, steps=steps), region.grid(box=box, steps=steps)
        active = covered.active(shape, box=box, steps=steps)
        if targets is None:
            targets = targets_of(covered, candidates.stack.histograms, width=candidates.basis.width)
        return cls(candidates, covered, shape, active, targets)

    @property
    def reach(self) -> tuple[int, ...]:
        """Voxels that the neighbourhoods cover, those beyond an axis that wraps counted again."""
        return covered_shape(self.shape, box=self.candidates.basis.box, steps=self.candidates.steps)


def targets_of(region: Region, histograms: tuple[Histogram, ...], *, width: int) -> tuple[Histogram, ...]:
    """The histograms that what is made is to have: the exemplar's, and those of the known voxels within `width`, as one."""
    if region.free is None or region.low is None or region.high is None:
        return histograms
    near = surroundings(region.free, known_of(region.free, region.low, region.high), width)
    made = int(np.count_nonzero(region.free))
    return mixed_histograms(histograms, region.low, region.high, near, made)


def wrapped(grid: Grid, field: np.ndarray) -> np.ndarray:
    """A field (C, Z, Y, X) with its beginning repeated beyond each axis that wraps, as far as neighbourhoods reach."""
    beyond = [(0, 0)] + [(0, max(0, far - side)) for far, side in zip(grid.reach, field.shape[1:], strict=True)]
    return np.pad(field, beyond, mode="wrap") if any(far for _, far in beyond) else field


def features_of(grid: Grid, field: np.ndarray) -> np.ndarray:
    """The feature vectors of the output's neighbourhoods."""
    active = None if grid.active.all() else grid.active
    features = project(wrapped(grid, field), grid.candidates.basis, step=grid.candidates.step, active=active)
    if grid.guide is None:
        return features
    np.right_shift(features, 1, out=features)
    return with_guide(features, grid.guide)


def with_guide(features: np.ndarray, guide: np.ndarray) -> np.ndarray:
    """Halved features (..., D) int16 followed by others (..., K): halved, squares of all of them together fit into int32."""
    return np.concatenate([features, guide], axis=-1)


def random_matches(grid: Grid, stage: np.uint64) -> np.ndarray:
    """Random patches: an independent candidate per site."""
    numbers = grid.candidates.numbers
    chosen = np.empty(grid.shape, np.int32)
    start_matches(chosen, len(numbers), stage)
    return numbers[chosen].astype(np.int32)


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


def swept(
    grid: Grid,
    match: np.ndarray,
    field: np.ndarray,
    *,
    stage: np.uint64,
    first: int,
    count: int,
    tries: int,
    index_penalty: float,
) -> tuple[np.ndarray, np.ndarray]:
    """`count` sweeps of the coherent search on a field, numbered from `first`: new matches and their distances."""
    features = features_of(grid, field)
    for sweep in range(first, first + count):
        match, distance = searched(
            grid, match, features, stage=stage, sweep=sweep, tries=tries, index_penalty=index_penalty
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
    # In a picture a neighbour in the next plane keeps its match: there is no plane beside it.
    ratio = candidates.step // candidates.stride
    ratios = (0 if candidates.basis.flat else ratio, ratio, ratio)

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
            ratios,
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
