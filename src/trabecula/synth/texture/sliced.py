"""Sliced rounds: neighbourhoods of the output take on the distribution of the exemplar's, without copying any of them.

Pitie, Kokaram, Dahyot 2007, "Automated colour grading using colour distribution transfer",
doi:10.1016/j.cviu.2006.11.011, section 3, on the principal components of neighbourhoods: turn the axes at random, move
the values along every axis monotonically so that their histogram is the exemplar's, turn back; a voxel becomes the mean
of the neighbourhoods that hold it. Nothing is looked up in the exemplar, so nothing is copied.

Only what the components hold is put back: what they leave out of the output (its noise, at first) has to go, or it stays
for ever. Along periodic axes every voxel lies in equally many neighbourhoods; along open ones those near a face lie in
fewer, their mean is noisier, and the rarer phase gathers there.

Everything is a whole number within the range in which products of matrices are exact, so the bits do not depend on the
BLAS, on threads or on the machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.engine.tiles import for_slabs, one_blas_thread
from trabecula.synth.shared.fields import FULL
from trabecula.synth.shared.neighbourhoods import SCALE, Basis, principal_basis, project
from trabecula.synth.texture.sliced_kernels import add, draw_signs, draw_starts, transport

UNIT = 256
"""An int8 step of a field in the int16 of votes."""

_FINE = 4096  # what an orthonormal basis is multiplied by on the way back
_MOST = 1 << 16  # neighbourhoods of the exemplars that stand for all of them, about
_BINS = 1024  # of a histogram along an axis
_BATCH = 1 << 24  # values of neighbourhoods that are put back at a time


@dataclass(frozen=True)
class Slices:
    """What sliced rounds aim at: neighbourhoods of exemplars on their principal components.

    `features` (N, P) float32 and `back` (P, C * w^3) float64 hold whole numbers, P is a power of two; `rest` (C,) int64 is
    what the components leave out of the mean, in 1 / UNIT of an int8 step.
    """

    basis: Basis
    features: np.ndarray
    back: np.ndarray
    rest: np.ndarray


def slices_of(fields: Sequence[np.ndarray], *, width: int = 4, variance: float = 0.95, most: int = 64) -> Slices:
    """The neighbourhoods of fields (C, Z, Y, X) int8 of one number of channels, about 65 thousand of them at most.

    Parameters
    ----------
    fields : sequence of arrays
        The exemplars at one resolution. The components are those of the first.
    width : int
        Voxels a side of a neighbourhood.
    variance : float
        Share that the components keep, 0..1.
    most : int
        Components at most.
    """
    basis = principal_basis(fields[0], width=width, variance=variance, most=most)
    count = basis.vectors.shape[1]
    size = 1 << max(2, (count - 1).bit_length())
    total = sum(int(np.prod([side - width + 1 for side in field.shape[1:]])) for field in fields)
    stride = max(1, round((total / _MOST) ** (1 / 3)))
    rows = np.concatenate([project(field, basis, step=stride).reshape(-1, count) for field in fields])
    features = np.zeros((len(rows), size), np.float32)
    features[:, :count] = rows
    back = np.zeros((size, len(basis.vectors)))
    back[:count] = np.rint(basis.vectors.T.astype(np.float64) * (_FINE / basis.scale))
    middle = (rows.sum(axis=0, dtype=np.float64) / len(rows)) @ back[:count] / (SCALE * _FINE)
    rest = _mean_of_neighbourhoods(fields, width) - middle.reshape(len(fields[0]), -1).mean(axis=1)
    rest = np.rint(UNIT * rest).astype(np.int64)
    return Slices(basis, features, back, rest)


def _mean_of_neighbourhoods(fields: Sequence[np.ndarray], width: int) -> np.ndarray:
    """The mean (C,) of all values in all neighbourhoods: a voxel near a face lies in fewer of them."""
    sums, count = np.zeros(len(fields[0])), 0
    for field in fields:
        covers = [
            np.convolve(np.ones(side - width + 1, np.int64), np.ones(width, np.int64)) for side in field.shape[1:]
        ]
        for axis, cover in enumerate(covers):  # sums of whole numbers: exact
            shape = [1, 1, 1]
            shape[axis] = -1
            covers[axis] = cover.reshape(shape)
        weights = covers[0] * covers[1] * covers[2]
        sums += [float(np.sum(channel * weights)) for channel in field]
        count += int(weights.sum())
    return np.asarray(sums / count)


def sliced_round(
    field: np.ndarray,
    slices: Slices,
    *,
    key: np.uint64,
    number: int,
    step: int = 2,
    strength: float = 1.5,
    periodic: Sequence[bool] = (True, True, True),
    free: np.ndarray | None = None,
) -> np.ndarray:
    """One round: every neighbourhood of a grid moves towards the exemplar's distribution, and overlaps are averaged.

    Parameters
    ----------
    field : (C, Z, Y, X) int16
        1 / UNIT of an int8 step; no side below the width of the neighbourhoods.
    slices : Slices
    key : uint64
        Of the random axes and of where the grid begins.
    number : int
        Of the round: each has its own random numbers.
    step : int
        Voxels between neighbourhoods; the grid begins elsewhere in every round, so all voxels get their turn.
    strength : float
        How far they move: 1 is to the exemplar's distribution. More makes up for what averaging takes away.
    periodic : three bools
        Axes that wrap around.
    free : (Z, Y, X) bool, optional
        Only neighbourhoods that hold such a voxel take part, and only such voxels change. Default: all.

    Returns
    -------
    (C, Z, Y, X) int16
    """
    width = slices.basis.width
    room = [side if wrap else min(step, side - width + 1) for side, wrap in zip(field.shape[1:], periodic, strict=True)]
    starts = np.empty(3, np.int64)
    draw_starts(key, number, np.array(room), starts)
    counts = [
        -(-side // step) if wrap else (side - start - width) // step + 1
        for side, start, wrap in zip(field.shape[1:], starts, periodic, strict=True)
    ]
    places = [
        (start + np.arange((count - 1) * step + width)) % side
        for side, start, count in zip(field.shape[1:], starts, counts, strict=True)
    ]
    here = np.ix_(np.arange(len(field)), *places)
    steps = np.clip((field.astype(np.int32) + UNIT // 2) >> 8, -FULL, FULL).astype(np.int8)
    active = np.ones(counts, bool) if free is None else _holding(free[here[1:]][0], width, step)
    features = project(steps[here], slices.basis, step=step, active=active)[active]
    moved = _moved(features, slices, key, number, strength)
    total, votes = _put_back(moved, active, slices, len(field), step)
    for axis, (side, wrap) in enumerate(zip(field.shape[1:], periodic, strict=True)):
        if wrap:
            total, votes = _folded(total, axis + 1, side), _folded(votes, axis, side)
    mean = total // np.maximum(votes, 1) + slices.rest[:, None, None, None]
    there = np.ix_(np.arange(len(field)), *(place[:count] for place, count in zip(places, votes.shape, strict=True)))
    chosen = votes > 0 if free is None else (votes > 0) & free[there[1:]][0]
    result = field.copy()
    result[there] = np.where(chosen, np.clip(mean, -FULL * UNIT, FULL * UNIT), field[there])
    return result


def _holding(free: np.ndarray, width: int, step: int) -> np.ndarray:
    """Whether the neighbourhood at each site holds a voxel that is free."""
    windows = np.lib.stride_tricks.sliding_window_view(free, (width,) * 3)[::step, ::step, ::step]
    return np.asarray(windows.any(axis=(3, 4, 5)))


def rotation(key: np.uint64, number: int, size: int) -> np.ndarray:
    """A random turn of `size` axes (a power of two) times `size`, in whole numbers: Hadamard's matrix twice, with random
    signs before, between and behind."""
    matrix: np.ndarray = np.ones((1, 1))
    while len(matrix) < size:
        matrix = np.block([[matrix, matrix], [matrix, -matrix]])
    signs = np.empty(3 * size)
    draw_signs(key, number, signs)
    first, second, third = signs.reshape(3, size)
    with one_blas_thread():
        return np.asarray((first[:, None] * matrix * second) @ matrix * third)


def _moved(features: np.ndarray, slices: Slices, key: np.uint64, number: int, strength: float) -> np.ndarray:
    """Features (n, D) int16 after the round, (n, P) float64 of whole numbers."""
    count, size = features.shape[1], slices.features.shape[1]
    turn = rotation(key, number, size).astype(np.float32)
    with one_blas_thread():
        ours = features.astype(np.float32) @ turn[:count]
        theirs = slices.features @ turn
        moves = np.empty(ours.shape, np.float64)
        for_slabs(lambda a, b: transport(ours, theirs, _BINS, moves, a, b), size, least=1)
        # Turned back it is size**2 too large.
        moved: np.ndarray = np.rint((moves @ turn.T.astype(np.float64)) * (strength / size**2))
    moved[:, :count] += features
    return moved


def _put_back(
    moved: np.ndarray, active: np.ndarray, slices: Slices, channels: int, step: int
) -> tuple[np.ndarray, np.ndarray]:
    """Sums (C, ...) int32 of the neighbourhoods that cover each voxel, in 1 / UNIT of an int8 step, and their number."""
    covered = tuple((count - 1) * step + slices.basis.width for count in active.shape)
    total, votes = np.zeros((channels, *covered), np.int32), np.zeros(covered, np.int32)
    planes = max(1, _BATCH // max(1, active.shape[1] * active.shape[2] * slices.back.shape[1]))
    done = 0
    for first in range(0, len(active), planes):
        part = active[first : first + planes]
        count = int(np.count_nonzero(part))
        _put_planes_back(moved[done : done + count], part, first, slices, total, votes, step)
        done += count
    return total, votes


def _put_planes_back(
    moved: np.ndarray,
    part: np.ndarray,
    first: int,
    slices: Slices,
    total: np.ndarray,
    votes: np.ndarray,
    step: int,
) -> None:
    """The same for a few planes of sites, of which `first` is the number of the first."""
    if not len(moved):
        return
    width = slices.basis.width
    numbers = np.where(part, np.cumsum(part).reshape(part.shape) - 1, -1)
    blocks = np.empty((len(moved), slices.back.shape[1]), np.int32)
    low, high = first * step, (first + len(part) - 1) * step + width

    def rebuild(a: int, b: int) -> None:
        blocks[a:b] = np.rint(moved[a:b] @ slices.back * (UNIT / (SCALE * _FINE)))

    def collect(a: int, b: int) -> None:
        add(blocks, numbers, total, votes, step, width, first, low + a, low + b)

    for_slabs(rebuild, len(moved), least=64)
    for_slabs(collect, high - low, least=4)


def _folded(values: np.ndarray, axis: int, side: int) -> np.ndarray:
    """What reaches past the end of a periodic axis, added to its start."""
    kept = np.take(values, range(side), axis)
    extra = values.shape[axis] - side
    if extra > 0:
        start = [slice(None)] * values.ndim
        start[axis] = slice(0, extra)
        kept[tuple(start)] += np.take(values, range(side, side + extra), axis)
    return kept
