"""From matches to a field: weights, the vote, what is known beside it, and the histogram."""

from __future__ import annotations

import numpy as np

from trabecula.engine.tiles import for_slabs
from trabecula.synth.shared.fields import FULL
from trabecula.synth.shared.histogram import Histogram, match_histogram
from trabecula.synth.shared.joints import joined
from trabecula.synth.shared.matching.grid import Grid
from trabecula.synth.shared.matching.kernels import vote, vote_sums
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.neighbourhoods import SCALE, Triple
from trabecula.synth.shared.pyramid import double


def refined(field: np.ndarray, wraps: tuple[bool, ...], *, distances: bool) -> np.ndarray:
    """A field (C, Z, Y, X) int8 at twice the resolution; a distance, which counts in voxels, doubles too."""
    doubled = double(field, wraps)
    return np.clip(doubled.astype(np.int16) * 2, -FULL, FULL).astype(np.int8) if distances else doubled


def robust_weights(grid: Grid, distance: np.ndarray, robustness: float) -> np.ndarray:
    """w_p = d^(r - 2) of the neighbourhood distance d (equation 2 without its trace), as integers of 1 .. 1023.

    Through a table over the ratio to the mean, so that no power function is asked for a bit it might round otherwise.
    Sites that are not active weigh 0.
    """
    # One quantum per voxel keeps an exact match from outvoting everything.
    basis = grid.candidates.basis
    floor = SCALE**2 * len(basis.vectors) * basis.grain ** (2 if basis.flat else 3)
    count = max(1, int(np.count_nonzero(grid.active)))
    mean = int(distance.sum(dtype=np.int64)) // count + floor
    ratio = np.clip((distance.astype(np.int64) + floor) * 256 // mean, 1, 4095)
    table = np.clip(np.rint(255 * (np.arange(4096).clip(1) / 256) ** ((robustness - 2) / 2)), 1, 1023)
    return np.where(grid.active, table.astype(np.int32)[ratio], np.int32(0))


def joined_votes(region: Region, votes: np.ndarray) -> np.ndarray:
    """Votes without a step beside what is known."""
    if region.free is None or region.low is None or region.high is None:
        return votes
    return joined(votes, region.low, region.high, region.free)


def rematched(region: Region, votes: np.ndarray, targets: tuple[Histogram, ...] | None) -> np.ndarray:
    """Votes (C, Z, Y, X) int16 as a field in int8, with histograms where there are targets, and what is known put back."""
    if targets is not None:
        matched = [match_histogram(mean, target, region.free) for mean, target in zip(votes, targets, strict=True)]
        return region.bounded(np.stack(matched))
    return region.bounded(np.clip((votes.astype(np.int32) + 128) >> 8, -127, 127).astype(np.int8))


def voted(grid: Grid, match: np.ndarray, weights: np.ndarray, *, trim: int = 0) -> np.ndarray:
    """The weighted mean of the matched neighbourhoods, times 256; 0 where no active one reaches."""
    candidates, region = grid.candidates, grid.region
    stack = candidates.stack
    votes = np.empty((len(stack.field), *region.shape), np.int16)

    def work(start: int, stop: int) -> None:
        plane = np.empty((len(votes) + 1, *grid.reach[1:]), np.int32)
        vote(
            stack.field,
            match,
            weights,
            candidates.shape,
            candidates.strides,
            candidates.steps,
            candidates.basis.box,
            trims_of(grid, trim),
            region.wraps,
            plane,
            votes,
            start,
            stop,
        )

    for_slabs(work, region.shape[0])
    return votes


def add_sums(
    total: np.ndarray, values: np.ndarray, grid: Grid, match: np.ndarray, weights: np.ndarray, *, trim: int = 0
) -> None:
    """Add the weighted sums of the matched neighbourhoods to `total` (K, Z, Y, X) int32, on the grid's region.

    Parameters
    ----------
    values : (K, z, y, x) int16
        What the voxels of the exemplar's stack add: such as its channels times a factor for each voxel, and as the last
        that factor, so that `mean_of` divides by what the voxels weigh together.
    match, weights : (sz, sy, sx) int32
        Of every site; a weight of 0 adds nothing.
    trim : int
        Voxels at the rim of a neighbourhood that are left out, in its plane where it is flat.
    """
    candidates, region = grid.candidates, grid.region

    def work(start: int, stop: int) -> None:
        plane = np.empty((len(total), *grid.reach[1:]), np.int32)
        vote_sums(
            values,
            match,
            weights,
            candidates.shape,
            candidates.strides,
            candidates.steps,
            candidates.basis.box,
            trims_of(grid, trim),
            region.wraps,
            plane,
            total,
            start,
            stop,
        )

    for_slabs(work, region.shape[0])


def mean_of(total: np.ndarray) -> np.ndarray:
    """Votes (C, Z, Y, X) int16, 256 times the mean, of sums (C + 1, Z, Y, X) int32 whose last are the weights."""
    below = np.maximum(total[-1], 1)
    votes = np.empty((len(total) - 1, *total.shape[1:]), np.int16)
    for z in range(len(below)):  # plane by plane: the products need 8 bytes
        votes[:, z] = total[:-1, z].astype(np.int64) * 256 // below[z]
    return votes


def trims_of(grid: Grid, trim: int) -> Triple:
    """The rim that does not vote along each axis; a flat neighbourhood is one voxel thick."""
    return (0 if grid.candidates.basis.flat else trim, trim, trim)
