"""The output's neighbourhoods at one resolution, and the search for the nearest one of the exemplar
to each.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.memory import Array, Stage, Workspace
from trabecula.engine.parallel import for_slabs, sum_slabs, thread_count
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.content.joints import find_known, pool_histograms, surroundings
from trabecula.synth.shared.matching.neighbour_search import (
    best_among,
    index_histogram,
    neighbour_bytes,
    usage_factors,
)
from trabecula.synth.shared.matching.neighbourhoods import (
    Triple,
    block_bytes,
    grid_reach,
    planes_together,
    project_planes,
)
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Candidates
from trabecula.synth.shared.matching.sweeps import (
    Sweep,
    count_matches,
    search,
    search_leaves,
    start_matches,
)
from trabecula.synth.shared.slabs import count_true, make_by_slabs

_TOGETHER = 1024  # sites whose exact search is one call, unless a plane holds more


@dataclass(frozen=True)
class Grid:
    """The output's neighbourhoods at one resolution and width; constant from round to round."""

    candidates: Candidates
    region: Region  # covered
    shape: tuple[int, ...]
    active: np.ndarray  # bool, `shape`
    targets: tuple[Histogram, ...]  # that the free voxels are to have, one a channel
    # (`shape`, K) int16: more features, of the place and not of the field
    guide: np.ndarray | None = None

    @classmethod
    def over(
        cls, region: Region, candidates: Candidates, targets: tuple[Histogram, ...] | None = None
    ) -> Grid:
        """Lay the neighbourhoods over a region, which is continued to the voxels that they cover.
        Targets default to `targets_of` the region.
        """
        box, steps = candidates.basis.box, candidates.steps
        covered, shape = region.cover(box=box, steps=steps), region.grid(box=box, steps=steps)
        active = covered.active(shape, box=box, steps=steps)
        if targets is None:
            targets = targets_of(covered, candidates.stack.histograms, width=candidates.basis.width)
        return cls(candidates, covered, shape, active, targets)

    @cached_property
    def count(self) -> int:
        """Count the active sites."""
        return count_true(self.active)

    @property
    def full(self) -> bool:
        """Return whether all sites are active."""
        return self.count == self.active.size

    @property
    def reach(self) -> tuple[int, ...]:
        """Return the voxels that the neighbourhoods cover; those beyond an axis that wraps count
        again.
        """
        return grid_reach(self.shape, box=self.candidates.basis.box, steps=self.candidates.steps)

    @property
    def middles(self) -> list[np.ndarray]:
        """Return the voxel in the middle of every neighbourhood, one array an axis."""
        box, steps = self.candidates.basis.box, self.candidates.steps
        return [
            (np.arange(count) * step + w // 2) % side
            for count, step, w, side in zip(self.shape, steps, box, self.region.shape, strict=True)
        ]


def targets_of(
    region: Region, histograms: tuple[Histogram, ...], *, width: int
) -> tuple[Histogram, ...]:
    """Return the histograms that the free voxels are to have: the exemplar's and those of the known
    voxels within `width`, as one.
    """
    if region.free is None or region.low is None or region.high is None:
        return histograms
    near = surroundings(region.free, find_known(region.free, region.low, region.high), width)
    return pool_histograms(histograms, region.low, region.high, near, count_true(region.free))


def wrap_field(grid: Grid, field: np.ndarray) -> np.ndarray:
    """Repeat the beginning of a field (C, Z, Y, X) beyond each axis that wraps, as far as
    neighbourhoods reach.
    """
    shape = (len(field), *np.maximum(grid.reach, field.shape[1:]).tolist())
    if shape == field.shape:
        return field
    return make_by_slabs(
        lambda start, stop: _planes(shape[1:], field, start, stop), shape, field.dtype
    )


def _planes(shape: Sequence[int], field: np.ndarray, start: int, stop: int) -> np.ndarray:
    """Return planes start..stop of a field that is repeated to `shape`."""
    part = (
        field[:, start:stop]
        if stop <= field.shape[1]
        else field[:, np.arange(start, stop) % field.shape[1]]
    )
    beyond = [
        (0, 0),
        (0, 0),
        *((0, far - side) for far, side in zip(shape[1:], field.shape[2:], strict=True)),
    ]
    return np.pad(part, beyond, mode="wrap") if tuple(shape[1:]) != field.shape[2:] else part


def features_of(grid: Grid, field: np.ndarray) -> np.ndarray:
    """Return the feature vectors of the output's neighbourhoods."""
    features = memmap.empty((*grid.shape, _depth(grid)), np.int16)

    def work(start: int, stop: int) -> None:
        for first, last in _together(grid, start, stop):
            features[first:last] = site_features(grid, field, first, last)

    for_slabs(work, grid.shape[0], least=2)
    return features


def site_features(grid: Grid, field: np.ndarray, start: int, stop: int) -> np.ndarray:
    """Return the feature vectors of the neighbourhoods in planes start..stop of the sites, in the
    caller's thread.
    """
    basis, step = grid.candidates.basis, grid.candidates.steps[0]
    features = np.empty((stop - start, *grid.shape[1:], basis.vectors.shape[1]), np.int16)
    shape = tuple(np.maximum(grid.reach, field.shape[1:]).tolist())
    planes = _planes(shape, field, start * step, (stop - 1) * step + basis.box[0])
    active = None if grid.full else grid.active[start:stop]
    project_planes(planes, basis, features, step=grid.candidates.step, active=active)
    if grid.guide is None:
        return features
    return append_guide(features >> 1, grid.guide[start:stop])


def append_guide(features: np.ndarray, guide: np.ndarray) -> np.ndarray:
    """Append other features (..., K) to halved features (..., D) int16: halved, the squares of all
    of them fit into int32.
    """
    return np.concatenate([features, guide], axis=-1)


def _depth(grid: Grid) -> int:
    """Return the length of a feature vector."""
    return grid.candidates.basis.vectors.shape[1] + (
        0 if grid.guide is None else grid.guide.shape[-1]
    )


def _together(grid: Grid, start: int, stop: int) -> Iterator[tuple[int, int]]:
    """Yield groups of planes of sites, so few that their features are still in the cache when they
    are searched.
    """
    thick = planes_together(_depth(grid), grid.shape)
    for first in range(start, stop, thick):
        yield first, min(first + thick, stop)


def random_matches(grid: Grid, stage: np.uint64) -> np.ndarray:
    """Draw an independent candidate for every site."""
    match, numbers = memmap.empty(grid.shape, np.int32), grid.candidates.numbers
    for_slabs(lambda start, stop: start_matches(match, numbers, stage, start, stop), len(match))
    return match


def exact_search(
    grid: Grid, old: np.ndarray, features: np.ndarray, *, index_penalty: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the best of the k nearest neighbourhoods by the modified distance (section 4.2):
    matches and their distances.
    """
    among, count = grid.candidates.index, len(grid.candidates.numbers)
    active = grid.active
    shares = index_histogram(old, len(grid.candidates.features), active)
    factors = usage_factors(shares, weight=index_penalty * count, theta=1 / count)
    match, found = (memmap.empty(old.shape, np.int32, least=0) for _ in range(2))
    thick = max(1, _TOGETHER // (old.shape[1] * old.shape[2]))

    def work(start: int, stop: int) -> None:
        for first in range(start, stop, thick):
            planes = slice(first, min(first + thick, stop))
            there = active[planes]
            match[planes], found[planes] = old[planes], 0
            match[planes][there], found[planes][there] = best_among(
                features[planes][there], among, factors
            )

    for_slabs(work, len(old), least=1, anywhere=True)
    return match, found


def coherent_search(
    grid: Grid,
    match: np.ndarray,
    field: np.ndarray,
    *,
    stage: np.uint64,
    first: int,
    count: int,
    tries: int,
    index_penalty: float,
    by_leaves: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Do `count` sweeps of the coherent search on a field, numbered from `first`: new matches and
    their distances. The first one of several may be `by_leaves`, among candidates that are likely
    near wherever they are in the exemplars.
    """
    guides, mapped = 0 if grid.guide is None else grid.guide.shape[-1], memmap.is_active()
    work = Workspace(
        search_stages(grid.candidates, grid.region, guides=guides, sweeps=count, mapped=mapped)
    )
    work.enter("search")
    held = count > 1 and not mapped
    features = work.adopt("features", features_of(grid, field)) if held else None
    distance = work.empty("distance")
    for sweep in range(first, first + count):
        name = "found" if (first + count - sweep) % 2 else "found before"
        found = work[name] if name in work else work.empty(name)
        penalty = usage_penalties(match, grid, index_penalty)
        if by_leaves and sweep == first:
            _search_leaves(grid, match, field, features, found, penalty)
        else:
            settings = Sweep(
                grid.candidates.shape, _ratios(grid), grid.region.wraps, stage, sweep, tries
            )
            _search_sweep(grid, match, field, features, (found, distance), penalty, settings)
        match = found
    return work.take("found"), work.take("distance")


def search_stages(
    candidates: Candidates,
    region: Region,
    *,
    guides: int = 0,
    sweeps: int = 1,
    exact: bool = False,
    mapped: bool = False,
) -> tuple[Stage, ...]:
    """Declare the arrays of a search beside the field and the matches before it, for a region that
    is covered and features with so many `guides`.

    Features are held where they are searched more than once: in files they are more to write and
    to read than to make again.
    """
    basis, threads = candidates.basis, thread_count()
    sites = region.grid(box=basis.box, steps=candidates.steps)
    depth = basis.vectors.shape[1] + guides
    match, held = Array(sites, np.int32), exact or (sweeps > 1 and not mapped)
    arrays = {
        "found": match,
        "found before": match if sweeps > 1 and not exact else None,
        "distance": match,
        "features": Array((*sites, depth), np.int16, axis=-4) if held else None,
    }
    thick = min(planes_together(depth, sites), -(-sites[0] // (4 * threads if threads > 1 else 1)))
    planes = min((thick - 1) * candidates.steps[0] + basis.box[0], region.shape[0] + basis.box[0])
    channels = len(candidates.stack.field)
    seen = channels * planes * region.shape[1] * region.shape[2]
    made = 2 * depth * thick * sites[1] * sites[2] * (3 if guides else 1)
    made += seen * (int(channels > 1) + 2 * any(region.wraps))
    blocks = block_bytes(basis, sites)
    made += max(4 * seen, 2 * seen + blocks) if basis.grain > 1 else blocks
    made += neighbour_bytes(len(candidates.features), candidates.k) if exact else 0
    return (Stage("search", arrays, threads * made, basis.width + 2),)


def _ratios(grid: Grid) -> Triple:
    """Return how many cells a neighbour's match moves along each axis. In a picture a neighbour in
    the next plane keeps its match: there is no plane beside it.
    """
    ratio = grid.candidates.step // grid.candidates.stride
    return (0 if grid.candidates.basis.flat else ratio, ratio, ratio)


def _search_leaves(
    grid: Grid,
    old: np.ndarray,
    field: np.ndarray,
    features: np.ndarray | None,
    match: np.ndarray,
    penalty: np.ndarray,
) -> None:
    """Do one sweep among the candidates of leaves: new matches, into an array."""
    candidates, tree = grid.candidates, grid.candidates.tree

    def work(start: int, stop: int) -> None:
        for first, last, rows in _rows(grid, field, features, start, stop):
            search_leaves(
                rows,
                first,
                candidates.features,
                penalty,
                tree,
                grid.active,
                old,
                match,
                first,
                last,
            )

    for_slabs(work, len(old), least=2, anywhere=True)


def _search_sweep(
    grid: Grid,
    old: np.ndarray,
    field: np.ndarray,
    features: np.ndarray | None,
    into: tuple[np.ndarray, np.ndarray],
    penalty: np.ndarray,
    settings: Sweep,
) -> None:
    """Do one sweep of the coherent search: new matches and their distances, into two arrays."""
    match, distance = into

    def work(start: int, stop: int) -> None:
        for first, last, rows in _rows(grid, field, features, start, stop):
            search(
                rows,
                first,
                grid.candidates.features,
                penalty,
                grid.active,
                old,
                match,
                distance,
                settings,
                first,
                last,
            )

    for_slabs(work, len(old), least=2, anywhere=True)


def _rows(
    grid: Grid, field: np.ndarray, features: np.ndarray | None, start: int, stop: int
) -> Iterator[tuple[int, int, np.ndarray]]:
    """Yield groups of planes of sites with their features, which are computed on the way where they
    are not given.
    """
    for first, last in _together(grid, start, stop):
        rows = None if features is None else features[first:last]
        yield first, last, site_features(grid, field, first, last) if rows is None else rows


def usage_penalties(match: np.ndarray, grid: Grid, weight: float) -> np.ndarray:
    """Return w_d = 1 + weight * max(0, H / theta - 1), theta = 1 / |E| (section 4.2), frozen for
    one sweep.
    """
    allowed = grid.candidates.allowed

    def tally(start: int, stop: int) -> np.ndarray:
        counts = np.zeros(len(allowed), np.int64)
        count_matches(match, grid.active, counts, start, stop)
        return counts

    even = np.float32(np.count_nonzero(allowed) / max(1, grid.count))
    share = np.asarray(sum_slabs(tally, len(match))).astype(np.float32) * even
    factors = np.float32(1) + np.float32(weight) * np.maximum(share - 1, 0)
    return np.where(allowed, factors, np.float32(np.inf))
