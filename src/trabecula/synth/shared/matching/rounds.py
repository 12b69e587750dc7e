"""From matches to a field: weights, the vote, the joint to known voxels, the histogram."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs, sum_slabs
from trabecula.synth.shared.content.fields import FULL
from trabecula.synth.shared.content.histogram import Histogram, match_histogram
from trabecula.synth.shared.content.joints import spread_offset
from trabecula.synth.shared.matching.grid import Grid
from trabecula.synth.shared.matching.neighbourhoods import SCALE, Triple
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.votes import CubeLayout, vote, weigh
from trabecula.synth.shared.pyramid import double
from trabecula.synth.shared.slabs import make_by_slabs


def refine_field(
    field: np.ndarray,
    wraps: tuple[bool, ...],
    *,
    distances: bool,
    features: int = 0,
    shape: Sequence[int] | None = None,
) -> np.ndarray:
    """Double the resolution of a field (C, Z, Y, X) int8; a distance, which counts in voxels,
    doubles too, and so do the last channels that are `features`.

    With a `shape` cropped, or continued by its last cells, to that.
    """
    factors = [2 if distances else 1] * (len(field) - features) + [2] * features
    return double(field, wraps, shape=shape, factors=factors)


def robust_weights(grid: Grid, distance: np.ndarray, robustness: float) -> np.ndarray:
    """Return w_p = d^(r - 2) of the neighbourhood distance d (equation 2 without its trace), as
    integers of 1 .. 1023.

    A table over the ratio to the mean: a power function might round its last bit differently on
    another machine. Sites that are not active weigh 0.
    """
    # One quantum per voxel keeps an exact match from outvoting everything.
    basis = grid.candidates.basis
    floor = SCALE**2 * len(basis.vectors) * basis.grain ** (2 if basis.flat else 3)
    total = sum_slabs(
        lambda start, stop: int(distance[start:stop].sum(dtype=np.int64)), len(distance)
    )
    mean = total // max(1, grid.count) + floor
    table = np.clip(
        np.rint(255 * (np.arange(4096).clip(1) / 256) ** ((robustness - 2) / 2)), 1, 1023
    ).astype(np.int32)
    weights = memmap.empty(distance.shape, np.int32)
    for_slabs(
        lambda start, stop: weigh(distance, grid.active, floor, mean, table, weights, start, stop),
        len(weights),
    )
    return weights


def join_to_known(region: Region, votes: np.ndarray) -> np.ndarray:
    """Remove the step of votes beside known voxels, in place; return the votes."""
    if region.free is None or region.low is None or region.high is None:
        return votes
    return spread_offset(votes, region.low, region.high, region.free)


def match_votes(
    region: Region, votes: np.ndarray, targets: tuple[Histogram, ...] | None
) -> np.ndarray:
    """Make votes (C, Z, Y, X) int16 a field in int8, with histograms where there are targets,
    within the bounds of known voxels.
    """
    if targets is None:
        return region.clip_to_bounds(
            make_by_slabs(
                lambda start, stop: round_votes(votes[:, start:stop]), votes.shape, np.int8
            )
        )
    field = memmap.empty(votes.shape, np.int8)
    for mean, target, channel in zip(votes, targets, field, strict=True):
        match_histogram(mean, target, region.free, out=channel)
    return region.clip_to_bounds(field)


def round_votes(votes: np.ndarray) -> np.ndarray:
    """Round votes int16, 256 times a field, to the field in int8."""
    return np.clip((votes.astype(np.int32) + 128) >> 8, -FULL, FULL).astype(np.int8)


def cast_votes(
    grid: Grid,
    match: np.ndarray,
    weights: np.ndarray,
    *,
    trim: int = 0,
    field: np.ndarray | None = None,
    planes: int | None = None,
) -> np.ndarray:
    """Return the weighted mean of the matched neighbourhoods, times 256; 0 where no active one
    reaches.

    Parameters
    ----------
    grid : Grid
    match, weights : (sz, sy, sx) int32
    trim : int
        Voxels at the rim of a neighbourhood that do not vote.
    field : (C, z, y, x) int8, optional
        What neighbourhoods vote with. Default: the exemplars'.
    planes : int, optional
        So many of the first planes, without what reaches around into them. Default: all.
    """
    candidates, region = grid.candidates, grid.region
    voting = candidates.stack.field if field is None else field
    depth = region.shape[0] if planes is None else planes
    around = region.wraps[0] and depth == region.shape[0]
    votes = memmap.empty((len(voting), depth, *region.shape[1:]), np.int16)

    layout = CubeLayout(
        candidates.shape,
        candidates.strides,
        candidates.steps,
        candidates.basis.box,
        trims_of(grid, trim),
        (around, *region.wraps[1:]),
    )

    def work(start: int, stop: int) -> None:
        plane = np.empty((len(votes) + 1, *grid.reach[1:]), np.int32)
        vote(voting, match, weights, layout, plane, votes, start, stop)

    for_slabs(work, depth, anywhere=True)
    return votes


def trims_of(grid: Grid, trim: int) -> Triple:
    """Return the rim that does not vote along each axis; a flat neighbourhood is one
    voxel thick.
    """
    return (0 if grid.candidates.basis.flat else trim, trim, trim)


def equal_weights(active: np.ndarray) -> np.ndarray:
    """Return the weights int32 of sites (sz, sy, sx) that vote alike: 1, and 0 where not active."""
    return make_by_slabs(lambda start, stop: active[start:stop], active.shape, np.int32)
