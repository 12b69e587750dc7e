"""Compiled: which counts of patterns change where one voxel of a block changes its phase.

On a local array as in `kernels`, read as one line: `steps` lead from a voxel to others. Places
count from the start, never from the end, so they are without a sign (`_at`): a kernel reads a
hundred of them for every voxel that it looks at.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import inline
from trabecula.engine.rows import copy_row
from trabecula.synth.shared.patterns.balls import (
    BALL_BINS,
    OUTSIDE,
    FilledBalls,
    list_ball_changes,
    refill_balls,
)
from trabecula.synth.shared.patterns.kernels import (
    CHORDS,
    MARGIN,
    NEIGHBOURS,
    REACH,
    STRIDES,
    WEIGHTS,
    neighbours_of_row,
)

MOST_CHANGES = 3 * 7 + len(STRIDES) * 16 + 54 + BALL_BINS
"""Bins that one voxel changes at most."""

_strides = np.array(STRIDES)


class PatternBlock(NamedTuple):
    """A block, and what is known of each of its voxels.

    Attributes
    ----------
    phases : int
    voxels : (z * y * x,) uint8
        Of the local array.
    steps : three ints
        From a voxel to the next along z, y and x.
    near : (27,) int64
        To its neighbours.
    codes : (z * y * x,) int16
        Of the neighbours of the block's voxels and of those next to it; -1 elsewhere.
    balls : FilledBalls
        Without entries where none are counted.
    powers : (8,) int64
        Of the number of phases.
    pairs, squares : (18,), (12,) int64
        Room for the codes of cubes.
    """

    phases: int
    voxels: np.ndarray
    steps: tuple[int, int, int]
    near: np.ndarray
    codes: np.ndarray
    balls: FilledBalls
    powers: np.ndarray
    pairs: np.ndarray
    squares: np.ndarray


class ChangeList(NamedTuple):
    """Bins (n,) int64 that change, and by how much."""

    bins: np.ndarray
    by: np.ndarray


@inline
def pattern_block(local, phases, balls):
    """Return the block of a local array, whose neighbours are looked up."""
    steps = (local.shape[1] * local.shape[2], local.shape[2], 1)
    near, voxels = np.empty(27, np.int64), local.reshape(-1)
    for n in range(27):
        near[n] = (n // 9 - 1) * steps[0] + (n // 3 % 3 - 1) * steps[1] + n % 3 - 1
    codes = np.full(local.size, -1, np.int16)
    side = local.shape[2] - 2 * MARGIN + 2
    row, seen = np.empty(side, np.int32), np.empty(side, np.uint8)
    for z in range(MARGIN - 1, local.shape[0] - MARGIN + 1):
        for y in range(MARGIN - 1, local.shape[1] - MARGIN + 1):
            neighbours_of_row(local, z, y, row, seen)
            first = z * steps[0] + y * steps[1] + MARGIN - 1
            copy_row(codes[first : first + side], row)
    cubes = (phases ** np.arange(8), np.empty(18, np.int64), np.empty(12, np.int64))
    return PatternBlock(phases, voxels, steps, near, codes, balls, *cubes)


@inline
def change_list():
    """Return room for what one voxel changes."""
    return ChangeList(np.empty(MOST_CHANGES, np.int64), np.empty(MOST_CHANGES, np.int64))


@inline
def change_voxel(block, voxel, place, new):
    """Give a voxel to a phase; neighbours and balls follow. `place` is where it is in the block."""
    voxels, codes, own = block.voxels, block.codes, block.voxels[voxel]
    voxels[voxel] = new
    alike = np.int64(0)
    for n in range(27):
        near, weight = voxel + block.near[n], WEIGHTS[n]
        there = _at(voxels, near)
        if there == new:
            alike += weight
        if _at(codes, near) < 0 or weight == 0:
            continue
        if there == own:
            codes[near] -= weight
        elif there == new:
            codes[near] += weight
    if codes[voxel] >= 0:
        codes[voxel] = alike
    if block.balls.fills.size:
        refill_balls(block.balls, place, own, new)


@inline
def list_changes(block, voxel, place, new, found):
    """List the bins that change where a voxel becomes a phase, and by how much; return how many,
    and the first and the last but one of those of the nearest cubes.
    """
    phases, count = block.phases, 0
    for axis in range(3):
        first = axis * phases * CHORDS
        count = _list_chords(block.voxels, block.steps[axis], voxel, new, first, found, count)
    first, nearest, last = 3 * phases * CHORDS, count, count
    for n in range(len(STRIDES)):
        count = _list_cubes(block, voxel, new, _strides[n], first, found, count)
        first += phases * block.powers[7]
        if n == 0:
            last = count
    count = _list_neighbours(block, voxel, new, first, found, count)
    if block.balls.fills.size:
        first += phases * NEIGHBOURS
        own = _at(block.voxels, voxel)
        count = list_ball_changes(block.balls, place, own, new, first, found, count)
    return count, nearest, last


@inline
def _list_cubes(block, voxel, new, stride, first, found, count):
    """List the cubes of a stride that have the voxel in a corner."""
    voxels, phases, powers = block.voxels, block.phases, block.powers
    pairs, squares = block.pairs, block.squares
    down, back, aside = (stride * block.steps[0], stride * block.steps[1], stride)
    more = np.int64(new) - np.int64(_at(voxels, voxel))
    seen = np.uint8(0)
    for n in range(9):
        row = voxel + (n // 3 - 1) * down + (n % 3 - 1) * back
        left, middle, right = _at(voxels, row - aside), _at(voxels, row), _at(voxels, row + aside)
        seen |= left | middle | right
        pairs[2 * n] = np.int64(left) + phases * np.int64(middle)
        pairs[2 * n + 1] = np.int64(middle) + phases * np.int64(right)
    for n in range(12):  # (plane, one of two along y, one of two along x)
        at = 6 * (n // 4) + n % 4
        squares[n] = pairs[at] + powers[2] * pairs[at + 2]
    for k in range(8):
        if seen == OUTSIDE and _leaves(voxels, voxel, k, (down, back, aside)):
            continue
        at = 7 - k
        code = squares[at] + powers[4] * squares[at + 4]
        count = _list(found, count, first + code, -1)
        count = _list(found, count, first + code + more * powers[k], 1)
    return count


@inline
def _leaves(voxels, voxel, corner, steps):
    """Return whether the cube whose corner a voxel is has one outside the material."""
    first = voxel
    for axis in range(3):
        first -= (corner >> (2 - axis) & 1) * steps[axis]
    for m in range(8):
        at = first + (m >> 2) * steps[0] + (m >> 1 & 1) * steps[1] + (m & 1) * steps[2]
        if _at(voxels, at) == OUTSIDE:
            return True
    return False


@inline
def _list_neighbours(block, voxel, new, first, found, count):
    """List the neighbours of the voxel and of those around it."""
    own, alike = _at(block.voxels, voxel), np.int64(0)  # of the new phase, around the voxel
    for n in range(27):
        near, weight = voxel + block.near[n], WEIGHTS[n]
        there, code = _at(block.voxels, near), np.int64(_at(block.codes, near))
        if there == new:
            alike += weight
        if code < 0 or weight == 0 or (there != own and there != new):
            continue
        bins = first + np.int64(there) * NEIGHBOURS + code
        count = _list(found, count, bins, -1)
        count = _list(found, count, bins + (-weight if there == own else weight), 1)
    code = np.int64(_at(block.codes, voxel))
    if code >= 0:
        count = _list(found, count, first + np.int64(own) * NEIGHBOURS + code, -1)
        count = _list(found, count, first + np.int64(new) * NEIGHBOURS + alike, 1)
    return count


@inline
def _list_chords(voxels, step, voxel, new, first, found, count):
    """List the chords along an axis that end or begin where a voxel becomes a phase."""
    own = _at(voxels, voxel)
    left, before = _extent(voxels, voxel, -step)
    right, after = _extent(voxels, voxel, step)
    length = left + right + 1
    count = _list_chord(own, before, after, length, -1, first, found, count)
    # the new chord goes as far as what was there before on either side
    low, low_end = 0, own
    high, high_end = 0, own
    if left:
        count = _list_chord(own, before, new, left, 1, first, found, count)
    else:
        low_end = before
        if before == new:
            more, low_end = _extent(voxels, voxel - step, -step)
            low = more + 1
            count = _list_chord(new, low_end, own, low, -1, first, found, count)
    if right:
        count = _list_chord(own, new, after, right, 1, first, found, count)
    else:
        high_end = after
        if after == new:
            more, high_end = _extent(voxels, voxel + step, step)
            high = more + 1
            count = _list_chord(new, own, high_end, high, -1, first, found, count)
    return _list_chord(new, low_end, high_end, low + high + 1, 1, first, found, count)


@inline
def _extent(voxels, voxel, step):
    """Return how many voxels beyond one have its phase, up to `CHORDS`, and the phase of the one
    after them.
    """
    own, count, at = _at(voxels, voxel), 0, voxel
    while count < CHORDS:
        at += step
        there = _at(voxels, at)
        if there != own:
            return count, there
        count += 1
    return count, own


@inline
def _list_chord(phase, before, after, length, by, first, found, count):
    """List a chord, where it is counted: not where a face cuts it."""
    if before == OUTSIDE or (length <= REACH and after == OUTSIDE):
        return count
    return _list(found, count, first + np.int64(phase) * CHORDS + min(length, CHORDS) - 1, by)


@inline
def _list(found, count, one, by):
    """Add a bin that changes to a list; return how many it has."""
    place = np.uint64(count)
    found.bins[place], found.by[place] = one, by
    return count + 1


@inline
def _at(values, place):
    """Return one of flat values."""
    return values[np.uint64(place)]
