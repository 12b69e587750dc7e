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

From pictures the neighbourhoods are squares in the planes of a view; where a material is seen in several views, a voxel becomes
the mean over all of them (`sliced_views`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.engine.tiles import for_slabs, one_blas_thread
from trabecula.synth.shared.fields import FULL
from trabecula.synth.shared.neighbourhoods import (
    SCALE,
    Basis,
    Triple,
    covered_shape,
    principal_basis,
    project,
    steps_of,
)
from trabecula.synth.shared.statistics.sliced_kernels import add, draw_signs, draw_starts, transport

UNIT = 256
"""An int8 step of a field in the int16 of votes."""

_FINE = 4096  # what an orthonormal basis is multiplied by on the way back
_MOST = 1 << 16  # neighbourhoods of the exemplars that stand for all of them, about
_BINS = 1024  # of a histogram along an axis
_BATCH = 1 << 24  # values of neighbourhoods that are put back at a time


@dataclass(frozen=True)
class Slices:
    """What sliced rounds aim at: neighbourhoods of exemplars on their principal components.

    `features` (N, P) float32 and `back` (P, C * voxels) float64 hold whole numbers, P is a power of two; `rest` (C,) int64 is
    what the components leave out of the mean, in 1 / UNIT of an int8 step.
    """

    basis: Basis
    features: np.ndarray
    back: np.ndarray
    rest: np.ndarray


def slices_of(
    fields: Sequence[np.ndarray], *, width: int = 4, variance: float = 0.95, most: int = 64, flat: bool = False
) -> Slices:
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
    flat : bool
        Whether neighbourhoods are squares of one plane z, as of a picture (C, 1, Y, X), rather than cubes.
    """
    basis = principal_basis(fields[0], width=width, variance=variance, most=most, flat=flat)
    count = basis.vectors.shape[1]
    size = 1 << max(2, (count - 1).bit_length())
    sides = [[side - w + 1 for side, w in zip(field.shape[1:], basis.box, strict=True)] for field in fields]
    stride = max(1, round((sum(map(math.prod, sides)) / _MOST) ** (1 / 2 if flat else 1 / 3)))
    rows = np.concatenate([project(field, basis, step=stride).reshape(-1, count) for field in fields])
    features = np.zeros((len(rows), size), np.float32)
    features[:, :count] = rows
    back = np.zeros((size, len(basis.vectors)))
    back[:count] = np.rint(basis.vectors.T.astype(np.float64) * (_FINE / basis.scale))
    middle = (rows.sum(axis=0, dtype=np.float64) / len(rows)) @ back[:count] / (SCALE * _FINE)
    rest = _mean_of_neighbourhoods(fields, basis.box) - middle.reshape(len(fields[0]), -1).mean(axis=1)
    rest = np.rint(UNIT * rest).astype(np.int64)
    return Slices(basis, features, back, rest)


def _mean_of_neighbourhoods(fields: Sequence[np.ndarray], box: Triple) -> np.ndarray:
    """The mean (C,) of all values in all neighbourhoods: a voxel near a face lies in fewer of them."""
    sums, count = np.zeros(len(fields[0])), 0
    for field in fields:
        covers = [
            np.convolve(np.ones(side - w + 1, np.int64), np.ones(w, np.int64))
            for side, w in zip(field.shape[1:], box, strict=True)
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
    total, votes = _sums(field, slices, key, number, step, strength, periodic, free)
    return _replaced(field, total, votes, free)


def sliced_views(
    field: np.ndarray,
    views: Sequence[tuple[int, Slices]],
    *,
    key: np.uint64,
    number: int,
    step: int = 2,
    strength: float = 1.5,
    periodic: Sequence[bool] = (True, True, True),
    free: np.ndarray | None = None,
) -> np.ndarray:
    """One round in which every plane of every view moves towards that view's distribution, and all overlaps are averaged.

    Parameters
    ----------
    field : (C, Z, Y, X) int16
        1 / UNIT of an int8 step; no side below the width of the neighbourhoods.
    views : sequence of (axis, Slices)
        The axis across which a view is seen (0 z, 1 y, 2 x) and what it aims at: flat neighbourhoods of a picture whose rows
        lie along the slower of the two other axes.
    key, number, step, strength, periodic, free
        As in `sliced_round`, of the volume.

    Returns
    -------
    (C, Z, Y, X) int16
    """
    total = np.zeros(field.shape, np.int32)
    votes = np.zeros(field.shape[1:], np.int32)
    for place, (axis, slices) in enumerate(views):
        order = (axis, *(a for a in range(3) if a != axis))
        sums, counts = _sums(
            np.ascontiguousarray(np.moveaxis(field, axis + 1, 1)),
            slices,
            key,
            number * len(views) + place,
            step,
            strength,
            [periodic[a] for a in order],
            None if free is None else np.ascontiguousarray(np.moveaxis(free, axis, 0)),
        )
        np.moveaxis(total, axis + 1, 1)[:] += sums
        np.moveaxis(votes, axis, 0)[:] += counts
    return _replaced(field, total, votes, free)


def _replaced(field: np.ndarray, total: np.ndarray, votes: np.ndarray, free: np.ndarray | None) -> np.ndarray:
    """The mean of what was put back wherever there is something, and the voxel is free."""
    limit = FULL * UNIT
    chosen = votes > 0 if free is None else (votes > 0) & free
    return np.where(chosen, np.clip(total // np.maximum(votes, 1), -limit, limit), field).astype(np.int16)


def _sums(
    field: np.ndarray,
    slices: Slices,
    key: np.uint64,
    number: int,
    step: int,
    strength: float,
    periodic: Sequence[bool],
    free: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Sums (C, Z, Y, X) int32 of the moved neighbourhoods that hold a voxel, and their number (Z, Y, X) int32."""
    box, steps = slices.basis.box, steps_of(step, flat=slices.basis.flat)
    along = list(zip(field.shape[1:], box, steps, periodic, strict=True))
    room = [side if wrap and t > 1 else min(t, side - w + 1) for side, w, t, wrap in along]
    starts = np.empty(3, np.int64)
    draw_starts(key, number, np.array(room), starts)
    counts = [
        -(-side // t) if wrap else (side - start - w) // t + 1
        for start, (side, w, t, wrap) in zip(starts, along, strict=True)
    ]
    places = [
        (start + np.arange(reach)) % side
        for start, reach, side in zip(starts, covered_shape(counts, box=box, steps=steps), field.shape[1:], strict=True)
    ]
    here = np.ix_(np.arange(len(field)), *places)
    levels = np.clip((field.astype(np.int32) + UNIT // 2) >> 8, -FULL, FULL).astype(np.int8)
    active = np.ones(counts, bool) if free is None else _holding(free[here[1:]][0], box, steps)
    features = project(levels[here], slices.basis, step=step, active=active)[active]
    moved = _moved(features, slices, key, number, strength)
    total, votes = _put_back(moved, active, slices, len(field), steps)
    for axis, (side, _, _, wrap) in enumerate(along):
        if wrap:
            total, votes = _folded(total, axis + 1, side), _folded(votes, axis, side)
    total += slices.rest[:, None, None, None].astype(np.int32) * votes
    there = np.ix_(np.arange(len(field)), *(place[:count] for place, count in zip(places, votes.shape, strict=True)))
    whole, counted = np.zeros(field.shape, np.int32), np.zeros(field.shape[1:], np.int32)
    whole[there], counted[there[1:]] = total, votes
    return whole, counted


def _holding(free: np.ndarray, box: Triple, steps: Triple) -> np.ndarray:
    """Whether the neighbourhood at each site holds a voxel that is free."""
    windows = np.lib.stride_tricks.sliding_window_view(free, box)[:: steps[0], :: steps[1], :: steps[2]]
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
    moved: np.ndarray, active: np.ndarray, slices: Slices, channels: int, steps: Triple
) -> tuple[np.ndarray, np.ndarray]:
    """Sums (C, ...) int32 of the neighbourhoods that cover each voxel, in 1 / UNIT of an int8 step, and their number."""
    covered = covered_shape(active.shape, box=slices.basis.box, steps=steps)
    total, votes = np.zeros((channels, *covered), np.int32), np.zeros(covered, np.int32)
    planes = max(1, _BATCH // max(1, active.shape[1] * active.shape[2] * slices.back.shape[1]))
    done = 0
    for first in range(0, len(active), planes):
        part = active[first : first + planes]
        count = int(np.count_nonzero(part))
        _put_planes_back(moved[done : done + count], part, first, slices, total, votes, steps)
        done += count
    return total, votes


def _put_planes_back(
    moved: np.ndarray,
    part: np.ndarray,
    first: int,
    slices: Slices,
    total: np.ndarray,
    votes: np.ndarray,
    steps: Triple,
) -> None:
    """The same for a few planes of sites, of which `first` is the number of the first."""
    if not len(moved):
        return
    box = slices.basis.box
    numbers = np.where(part, np.cumsum(part).reshape(part.shape) - 1, -1)
    blocks = np.empty((len(moved), slices.back.shape[1]), np.int32)
    low, high = first * steps[0], (first + len(part) - 1) * steps[0] + box[0]

    def rebuild(a: int, b: int) -> None:
        blocks[a:b] = np.rint(moved[a:b] @ slices.back * (UNIT / (SCALE * _FINE)))

    def collect(a: int, b: int) -> None:
        add(blocks, numbers, total, votes, steps, box, first, low + a, low + b)

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
