"""Compiled: voxels of a block change their phase, each where that brings patterns nearer to what is
to be.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.random import below, philox
from trabecula.synth.shared.patterns.balls import OUTSIDE, filled_balls, no_balls
from trabecula.synth.shared.patterns.changes import (
    change_list,
    change_voxel,
    list_changes,
    pattern_block,
)
from trabecula.synth.shared.patterns.kernels import CHORDS, MARGIN

_SMALL = 100
"""Voxels of a body below which none is cut off, joined or changed."""


@kernel
def flip_block(local, phases, free, votes, draw, misfit, steps, cells, change):
    """Change voxels of the block where that brings patterns nearer to their target, each once, in
    random order. Return how many. The local array follows, and what `misfit` and `cells` hold.

    Parameters
    ----------
    local : (z, y, x) uint8
    phases : int
    free : (z, y, x) bool
        Of the block. Where it has entries, others stay.
    votes : VotePrice
        Of the block.
    draw : (uint64, int)
        Key of the random order, and the number of the block.
    misfit : BlockMisfit
    steps : (26,) int64
        From a place in the local array to its neighbours, faces first.
    cells : FractionCells
        Changes bring no phase of a cell above what it is to have, nor of the block.
    change : (bins,) int64
        Of the counts of patterns.
    """
    key, number = draw
    spots = _interface(local)
    _shuffle(spots, key, number)
    with_balls = len(misfit.slopes) > misfit.balls
    balls = filled_balls(local, MARGIN, phases) if with_balls else no_balls()
    block = pattern_block(local, phases, balls)
    voxels, found, loops = block.voxels, change_list(), np.zeros(len(misfit.euler))
    marks, mark = np.zeros(local.size, np.int32), np.int32(0)
    stack = np.empty(_SMALL, np.int64)
    done, was, now = np.empty(len(spots), np.int64), np.empty(len(spots), np.uint8), 0
    for n in range(len(spots)):
        spot = spots[n]
        place = _place(block, spot)
        if free.size and not free[place]:
            continue
        own = voxels[spot]
        new = _other(block, spot, philox(key, number, spot, 0, 1)[0])
        if new == OUTSIDE:
            continue
        more, whole = _gained(cells, place), cells.whole
        if cells.price == 0 and more[new] >= 0:
            continue
        energy = 2.0 * cells.price * (more[new] - more[own] + 1)
        energy += 2.0 * cells.whole_price * (whole[new] - whole[own] + 1)
        energy += votes.effort * _depth(votes, place, own, new)
        count, first, last = list_changes(block, spot, place, new, found)
        energy = _add_misfit(energy, found, count, misfit.slopes)
        _count_loops(found, first, last, misfit.euler, 3 * phases * CHORDS, loops)
        for e in range(len(loops)):
            energy += misfit.euler_weights[e] * loops[e] * (2 * misfit.euler_off[e] + loops[e])
        kept = energy < 0
        if kept:
            small, mark = _touches_small(voxels, spot, own, steps[:6], marks, mark, stack)
            kept = not small
        if kept:
            small, mark = _touches_small(voxels, spot, new, steps, marks, mark, stack)
            kept = not small
        if not kept:
            continue
        change_voxel(block, spot, place, new)
        done[now], was[now] = spot, own
        now += 1
        _move(cells, place, own, new)
        for k in range(count):
            one, by = found.bins[k], found.by[k]
            change[one] += by
            misfit.slopes[one, 0] += 2 * misfit.slopes[one, 1] * by
        for e in range(len(loops)):
            misfit.euler_off[e] += loops[e]
    given = (block, found, change, done[:now], was[:now])
    left = now - _undo(given, cells, False)
    return left - _undo(given, cells, True)


@inline
def _add_misfit(energy, found, count, slopes):
    """Return energy with what a change makes of the misfit."""
    for k in range(count):
        one, by = np.uint64(found.bins[k]), found.by[k]
        energy += by * slopes[one, 0] + by * by * slopes[one, 1]
    return energy


@inline
def _count_loops(found, first, last, euler, cubes, loops):
    """Count what the nearest cubes of a change, those of a list from one on, add to the Euler
    numbers.
    """
    loops[:] = 0
    for k in range(first, last):
        for e in range(len(loops)):
            loops[e] += found.by[k] * euler[e, found.bins[k] - cubes]


@inline
def _undo(given, cells, of_block):
    """Take back the last changes that left a cell, or the block, with too many of a phase. Return
    how many.
    """
    block, found, change, done, was = given
    undone = 0
    for n in range(len(done) - 1, -1, -1):
        spot, old = done[n], was[n]
        place, own = _place(block, spot), block.voxels[spot]
        more = _gained(cells, place)
        too_many = cells.whole[own] if of_block else more[own]
        if own == old or too_many <= 0 or (cells.price == 0 and more[old] >= 0):
            continue
        count, _, _ = list_changes(block, spot, place, old, found)
        for k in range(count):
            change[found.bins[k]] += found.by[k]
        change_voxel(block, spot, place, old)
        _move(cells, place, own, old)
        undone += 1
    return undone


@inline
def _place(block, spot):
    """Return where a voxel of the local array is in the block."""
    down, back, _ = block.steps
    return spot // down - MARGIN, spot % down // back - MARGIN, spot % back - MARGIN


@inline
def _gained(cells, place):
    """Return what the cell of a voxel of the block has too many of each phase, (phases,)."""
    z, y, x = place
    return cells.gained[z // cells.sides[0], y // cells.sides[1], x // cells.sides[2]]


@inline
def _move(cells, place, own, new):
    """Count a voxel that became another phase in its cell, and in the block."""
    more = _gained(cells, place)
    more[new] += 1
    more[own] -= 1
    cells.whole[new] += 1
    cells.whole[own] -= 1


@inline
def _interface(local):
    """Return the voxels of the block that share a face with another phase, as places in the local
    array.
    """
    found = np.empty(local.size, np.int64)
    count, height, width = 0, local.shape[1], local.shape[2]
    for z in range(MARGIN, local.shape[0] - MARGIN):
        for y in range(MARGIN, height - MARGIN):
            for x in range(MARGIN, width - MARGIN):
                own = local[z, y, x]
                if own == OUTSIDE:
                    continue
                alike = (
                    own == local[z - 1, y, x]
                    and own == local[z + 1, y, x]
                    and own == local[z, y - 1, x]
                    and own == local[z, y + 1, x]
                    and own == local[z, y, x - 1]
                    and own == local[z, y, x + 1]
                )
                if not alike:
                    found[count] = (z * height + y) * width + x
                    count += 1
    return found[:count]


@inline
def _shuffle(spots, key, number):
    """Put a list into random order."""
    for n in range(len(spots) - 1, 0, -1):
        other = below(philox(key, number, n, 0, 0)[0], n + 1)
        spots[n], spots[other] = spots[other], spots[n]


@inline
def _other(block, spot, word):
    """Draw the phase of a face neighbour that has another one; `OUTSIDE` where there is none."""
    own, count, found = block.voxels[spot], 0, np.uint8(OUTSIDE)
    for axis in range(3):
        for step in (-block.steps[axis], block.steps[axis]):
            there = block.voxels[spot + step]
            count += there != own and there != OUTSIDE
    if count == 0:
        return found
    pick = below(word, count)
    for axis in range(3):
        for step in (-block.steps[axis], block.steps[axis]):
            there = block.voxels[spot + step]
            if there != own and there != OUTSIDE:
                if pick == 0:
                    found = there
                pick -= 1
    return found


@inline
def _depth(votes, place, own, new):
    """Return how far votes at a voxel lie on a phase's side of where it ends."""
    z, y, x = place
    if len(votes.field) == 1:
        far = np.float64(votes.field[0, z, y, x]) - votes.level
        return far if own == 1 else -far
    return (np.float64(votes.field[own, z, y, x]) - np.float64(votes.field[new, z, y, x])) / 2


@inline
def _touches_small(voxels, spot, phase, steps, marks, mark, stack):
    """Return whether a voxel has no neighbour of this phase, or one in a body of less than `_SMALL`
    voxels without it, and the last of the marks that were used. `steps` lead to neighbours.
    """
    alone = True
    centre = mark + np.int32(1)
    marks[spot], mark = centre, centre
    for n in range(len(steps)):
        first = spot + steps[n]
        if voxels[first] != phase:
            continue
        alone = False
        if marks[first] >= centre:
            continue
        mark += np.int32(1)
        marks[first], stack[0], top, size = mark, first, 1, 1
        met, large = False, False
        while top and not met and not large:
            top -= 1
            here = stack[top]
            for k in range(len(steps)):
                there = here + steps[k]
                if there < 0 or there >= voxels.size:
                    large = True
                elif voxels[there] == phase and marks[there] != mark and marks[there] != centre:
                    if marks[there] > centre:
                        met = True  # a large one of before
                        break
                    size += 1
                    if size >= _SMALL:
                        large = True
                        break
                    marks[there] = mark
                    stack[top] = there
                    top += 1
        if not met and not large:
            return True, mark
    return alone, mark
