"""The vote of equation (1) with both terms: matched intensities and matched gradients, as a
screened Poisson system.

With e_p the neighbourhood matched at p, and (a, b) the pairs of adjacent voxels inside it, the
field s that minimises

    sum_p w_p sum_a (s_a - e_p,a)^2  +  mu sum_p sum_(a,b) ((s_a - s_b) - (e_p,a - e_p,b))^2

solves, at every voxel a with its six neighbours b,

    W_a s_a + mu sum_b n_ab (s_a - s_b)  =  sum_p w_p e_p,a + mu sum_p sum_b (e_p,a - e_p,b)

where W_a sums the weights and n_ab counts the neighbourhoods that hold a and b. `add_votes` sums
the four in integers, `poisson.solve_votes` solves. Each pair counts once; seen from both of its
voxels, as the paper may mean it, it would count twice, which is twice mu.

Zhang, Chen, Wang, Wang (2017), Computer Aided Geometric Design, sections 4.1 and 4.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.errors import InputError
from trabecula.engine import memmap
from trabecula.engine.compile import inline, kernel
from trabecula.engine.memory import Array
from trabecula.engine.parallel import for_slabs


@dataclass(frozen=True)
class GradientVotes:
    """Sums over the neighbourhoods that hold a voxel, in integers: any order of adding gives the
    same.

    A neighbour beyond the last plane of an axis is the first one, for results that repeat;
    elsewhere its count is 0.
    """

    values: np.ndarray  # (C, Z, Y, X) int32, sum of w_p e_p
    weights: np.ndarray  # (Z, Y, X) int32, sum of w_p
    # (C, Z, Y, X) int32, sum of e_p,a - e_p,b over the neighbours b of a in the neighbourhood
    gradients: np.ndarray
    # (3, Z, Y, X) int16, neighbourhoods that hold the voxel and the next along an axis
    pairs: np.ndarray


def vote_arrays(shape: Sequence[int], channels: int) -> dict[str, Array]:
    """Declare the votes of a volume (Z, Y, X)."""
    sums = Array((channels, *shape), np.int32)
    return {
        "values": sums,
        "weights of voxels": Array(shape, np.int32),
        "gradients": sums,
        "pairs": Array((3, *shape), np.int16),
    }


def empty_votes(shape: tuple[int, ...], *, channels: int = 1) -> GradientVotes:
    """Return the votes of a (Z, Y, X) volume before the first is cast."""
    arrays = vote_arrays(shape, channels).values()
    return GradientVotes(*(memmap.zeros(array.shape, array.dtype) for array in arrays))


def add_votes(
    votes: GradientVotes,
    field: np.ndarray,
    match: np.ndarray,
    weight: np.ndarray,
    *,
    shape: tuple[int, ...],
    stride: int,
    step: int,
    width: int,
    trim: int = 0,
    wraps: tuple[bool, ...] = (False, False, False),
) -> None:
    """Add the matched neighbourhoods of one exemplar to `votes`, in place; once per exemplar where
    there are several.

    Parameters
    ----------
    votes : Votes
        Of the volume that the grid of neighbourhoods covers, (sites - 1) * step + width along every
        axis.
    field : (C, z, y, x) int8
        The exemplar.
    match : (sz, sy, sx) int32
        Per site the index of its neighbourhood among `shape` corners, `stride` voxels apart; below
        0: none.
    weight : (sz, sy, sx) int32
        1 .. 1023 (sums stay inside 32 bits for neighbourhoods of up to 10^3); 0: none.
    step, width : int
        Distance between sites and width of a neighbourhood, voxels.
    trim : int
        Voxels at the rim of a neighbourhood that do not vote, except at a border that does not
        wrap.
    wraps : (3,) bool
        Axes along which the volume will be folded (`fold_votes`).

    Raises
    ------
    InputError
        The votes are not of the volume that the sites cover.
    """
    covered = tuple((count - 1) * step + width for count in match.shape)
    if votes.weights.shape != covered or len(votes.values) != len(field):
        raise InputError(
            f"votes of {len(votes.values)} x {votes.weights.shape} do not fit {len(field)} "
            "channels on sites that cover "
            f"{covered}: make them with empty_votes(covered, channels=...)"
        )
    rims = [
        _rims(count, width=width, trim=trim, wrap=wrap)
        for count, wrap in zip(match.shape, wraps, strict=True)
    ]
    around = _laplacian(field)

    place = (shape, stride, step)

    def work(start: int, stop: int) -> None:
        sums = votes.values, votes.gradients
        _add(field, around, match, weight, place, tuple(rims), sums, start, stop)

    for_slabs(work, covered[0])
    _add_counts(votes, match, weight, rims, step=step)


def fold_votes(votes: GradientVotes, shape: tuple[int, ...]) -> GradientVotes:
    """Fold the votes of a volume that repeats every `shape` voxels: those beyond are added where it
    repeats.

    For sites that go once round every periodic axis; give the covered length along the others.
    Where there is nothing beyond they are the votes themselves.

    Raises
    ------
    InputError
        `shape` is larger than the votes.
    """
    if any(want > have for want, have in zip(shape, votes.weights.shape, strict=True)):
        raise InputError(
            f"votes of {votes.weights.shape} do not cover a period of {tuple(shape)}: add sites"
        )
    if votes.weights.shape == tuple(shape):
        return votes
    arrays = [votes.pairs, votes.gradients, votes.weights, votes.values]
    del votes  # each is freed once it is folded, if this is its last reference
    return GradientVotes(*(_fold(arrays.pop(), shape) for _ in range(4)))


def _fold(array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    volumes = array.reshape(-1, *array.shape[-3:])
    folded = memmap.empty((*array.shape[:-3], *shape), array.dtype)
    results = folded.reshape(-1, *shape)

    def work(start: int, stop: int) -> None:
        for volume, result in zip(volumes, results, strict=True):
            for z in range(start, stop):
                plane = volume[z].copy()
                for beyond in range(z + shape[0], len(volume), shape[0]):
                    plane += volume[beyond]
                rows = _add_beyond(plane, shape[1])
                result[z] = _add_beyond(rows.T, shape[2]).T

    for_slabs(work, shape[0])
    return folded


def _add_beyond(rows: np.ndarray, period: int) -> np.ndarray:
    """Return the first `period` rows, with the others added to them in place."""
    for first in range(period, len(rows), period):
        beyond = rows[first : first + period]
        rows[: len(beyond)] += beyond
    return rows[:period]


def _rims(count: int, *, width: int, trim: int, wrap: bool) -> np.ndarray:
    """Return (sites, 2): the first voxel of each neighbourhood that votes along an axis, and the
    one after the last.
    """
    rims = np.tile([trim, width - trim], (count, 1))
    if not wrap:
        rims[0, 0], rims[-1, 1] = 0, width
    return rims


def _add_counts(
    votes: GradientVotes,
    match: np.ndarray,
    weight: np.ndarray,
    rims: list[np.ndarray],
    *,
    step: int,
) -> None:
    """Add weights and pairs: matrix products along the axes, exact since no sum reaches 2^24."""
    holds, pairs = [], []
    for rim, length in zip(rims, votes.weights.shape, strict=True):
        first, stop = (step * np.arange(len(rim)) + edge for edge in rim.T)
        voxel = np.arange(length)[:, None]
        holds.append(((voxel >= first) & (voxel < stop)).astype(np.float32))
        pairs.append(((voxel >= first) & (voxel < stop - 1)).astype(np.float32))

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            cast, held = _sum_planes(holds[0][z], match, weight)
            votes.weights[z] += (holds[1] @ cast @ holds[2].T).astype(np.int32)
            votes.pairs[1, z] += (pairs[1] @ held @ holds[2].T).astype(np.int16)
            votes.pairs[2, z] += (holds[1] @ held @ pairs[2].T).astype(np.int16)
            _, held = _sum_planes(pairs[0][z], match, weight)
            votes.pairs[0, z] += (holds[1] @ held @ holds[2].T).astype(np.int16)

    for_slabs(work, len(votes.weights))


def _sum_planes(
    near: np.ndarray, match: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sum the weights of sites on planes that are `near`, and the number that vote, across the
    planes.
    """
    cast, held = np.zeros(match.shape[1:], np.float32), np.zeros(match.shape[1:], np.float32)
    for sz in np.flatnonzero(near):
        voting = (match[sz] >= 0) & (weight[sz] > 0)
        held += voting
        cast += weight[sz] * voting
    return cast, held


def _laplacian(field: np.ndarray) -> np.ndarray:
    """Sum of e_a - e_b over all neighbours b in the exemplar, int16."""
    total = np.zeros(field.shape, np.int16)
    for axis in (1, 2, 3):
        slope = np.diff(field.astype(np.int16), axis=axis)
        inner = [slice(None)] * 4
        inner[axis] = slice(1, None)
        total[tuple(inner)] += slope
        inner[axis] = slice(None, -1)
        total[tuple(inner)] -= slope
    return total


@kernel
def _add(field, around, match, weight, place, rims, sums, start, stop):
    """Add values and gradients of all sites on the voxel planes start..stop; `around` is the
    exemplar's Laplacian.

    The Laplacian's part from beyond the neighbourhood is taken back at its faces.
    """
    shape, stride, step = place
    rims_z, rims_y, rims_x = rims
    values, gradients = sums
    SZ, SY, SX = match.shape
    for z in range(start, stop):
        for sz in range(SZ):
            dz = z - sz * step
            z0, z1 = rims_z[sz]
            if dz < z0 or dz >= z1:
                continue
            for sy in range(SY):
                y0, y1 = rims_y[sy]
                for sx in range(SX):
                    m, w = match[sz, sy, sx], weight[sz, sy, sx]
                    if m < 0 or w == 0:
                        continue
                    x0, x1 = rims_x[sx]
                    ez = m // (shape[2] * shape[1]) * stride + dz
                    ey, ex = (m // shape[2]) % shape[1] * stride, m % shape[2] * stride + x0
                    zm, zp = max(ez - 1, 0), min(ez + 1, field.shape[1] - 1)
                    for c in range(len(field)):
                        for dy in range(y0, y1):
                            own, y, x, length = (
                                field[c, ez, ey + dy],
                                sy * step + dy,
                                sx * step + x0,
                                x1 - x0,
                            )
                            to, slopes, slope = (
                                values[c, z, y],
                                gradients[c, z, y],
                                around[c, ez, ey + dy],
                            )
                            for i in range(length):
                                to[x + i] += w * np.int32(own[ex + i])
                            for i in range(length):
                                slopes[x + i] += slope[ex + i]
                            if dz == z0:
                                _take_back(slopes, own, field[c, zm, ey + dy], x, ex, length)
                            if dz == z1 - 1:
                                _take_back(slopes, own, field[c, zp, ey + dy], x, ex, length)
                            if dy == y0:
                                _take_back(
                                    slopes, own, field[c, ez, max(ey + dy - 1, 0)], x, ex, length
                                )
                            if dy == y1 - 1:
                                after = min(ey + dy + 1, field.shape[2] - 1)
                                _take_back(slopes, own, field[c, ez, after], x, ex, length)
                            slopes[x] -= np.int32(own[ex]) - np.int32(own[max(ex - 1, 0)])
                            last = ex + length - 1
                            slopes[x + length - 1] -= np.int32(own[last]) - np.int32(
                                own[min(last + 1, len(own) - 1)]
                            )


@inline
def _take_back(slopes, own, near, x, ex, length):
    for i in range(length):
        slopes[x + i] -= np.int32(own[ex + i]) - np.int32(near[ex + i])
