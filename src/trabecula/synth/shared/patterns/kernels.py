"""Compiled: patterns of labels counted, and what one voxel that changes its phase changes of them.

All on a local array: a block with `MARGIN` voxels around it, in which `OUTSIDE` marks what is not
part of the material. No pattern of a voxel of the block leaves it.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.random import below, philox
from trabecula.measure.neighbours import place_along
from trabecula.synth.shared.patterns.balls import (
    FRACTIONS,
    OUTSIDE,
    RADII,
    ball_scratch,
    fill_balls,
    list_ball_changes,
    refill_balls,
)

REACH = 16
"""Voxels of the longest chord that is counted by its length."""

CHORDS = REACH + 1

STRIDES = (1, 2, 3, 5)
"""Voxels between the corners of a cube."""

MARGIN = REACH + 3

_FACES, _EDGES, _CORNERS = 7, 13, 9  # of their counts: 0 .. 6, 0 .. 12, 0 .. 8
NEIGHBOURS = _FACES * _EDGES * _CORNERS

_SMALL = 100
"""Voxels of a body below which none is cut off, joined or changed."""

_strides = np.array(STRIDES)
_FRACTIONS = len(FRACTIONS)
_MOST_BINS = 3 * 7 + len(STRIDES) * 16 + 54 + 2 * len(RADII) * _FRACTIONS  # that a voxel changes


@kernel
def load(phases, valid, corner, wraps, local):
    """Copy the part of phases (Z, Y, X) that begins at `corner` into a local array."""
    depth, height, width = phases.shape
    for z in range(local.shape[0]):
        at_z = place_along(z + corner[0], depth, wraps[0])
        for y in range(local.shape[1]):
            at_y = place_along(y + corner[1], height, wraps[1])
            row = local[z, y]
            if at_z < 0 or at_y < 0:
                row[:] = OUTSIDE
                continue
            for x in range(local.shape[2]):
                at_x = place_along(x + corner[2], width, wraps[2])
                if at_x < 0 or (valid.size and not valid[at_z, at_y, at_x]):
                    row[x] = OUTSIDE
                else:
                    row[x] = phases[at_z, at_y, at_x]


@kernel
def count_patterns(local, phases, counts, rooms):
    """Count the patterns of the block, and the rooms for them."""
    powers = phases ** np.arange(8)
    low = MARGIN
    stop = (local.shape[0] - low, local.shape[1] - low, local.shape[2] - low)
    for axis in range(3):
        _count_chords(local, axis, phases, counts, rooms)
    first = 3 * phases * CHORDS
    last = first + len(STRIDES) * powers[7] * phases
    for z in range(low, stop[0]):
        for y in range(low, stop[1]):
            for x in range(low, stop[2]):
                own = local[z, y, x]
                if own == OUTSIDE:
                    continue
                for n in range(len(STRIDES)):
                    code = _cube(local, z, y, x, _strides[n], powers)
                    if code >= 0:
                        counts[first + n * powers[7] * phases + code] += 1
                        rooms[3 * CHORDS + n] += 1
                code = _neighbours(local, z, y, x)
                if code >= 0:
                    counts[last + own * NEIGHBOURS + code] += 1
                    rooms[3 * CHORDS + len(STRIDES)] += 1


@inline
def _count_chords(local, axis, phases, counts, rooms):
    """Count the chords along an axis that begin in the block, walking backwards."""
    side = local.shape[axis]
    sides = (local.shape[(axis + 1) % 3], local.shape[(axis + 2) % 3])
    extents = np.zeros(CHORDS + 1, np.int64)
    for i in range(MARGIN, sides[0] - MARGIN):
        for j in range(MARGIN, sides[1] - MARGIN):
            inside, same, ahead = 0, 0, OUTSIDE
            for k in range(side - 1, MARGIN - 1, -1):
                here = _at(local, axis, k, i, j)
                inside = inside + 1 if here != OUTSIDE else 0
                same = same + 1 if here == ahead else 1
                ahead = here
                if k >= side - MARGIN or here == OUTSIDE:
                    continue
                before = _at(local, axis, k - 1, i, j)
                if before == OUTSIDE:
                    continue
                extents[min(inside, CHORDS)] += 1
                if before != here and (same > REACH or inside > same):
                    counts[(axis * phases + here) * CHORDS + min(same, CHORDS) - 1] += 1
    # a chord of n voxels needs one more behind it, the longest need none
    more = extents[CHORDS]
    rooms[axis * CHORDS + CHORDS - 1] += more
    for length in range(REACH, 0, -1):
        if length < REACH:
            more += extents[length + 1]
        rooms[axis * CHORDS + length - 1] += more


@inline
def _at(local, axis, k, i, j):
    """Return the phase at k along an axis, at i and j along the two after it."""
    if axis == 0:
        return local[k, i, j]
    if axis == 1:
        return local[j, k, i]
    return local[i, j, k]


@inline
def _cube(local, z, y, x, stride, powers):
    """Return the code of the cube whose first corner is a voxel; -1 where a corner is outside."""
    code = np.int64(0)
    for n in range(8):
        phase = local[z + stride * (n >> 2), y + stride * ((n >> 1) & 1), x + stride * (n & 1)]
        if phase == OUTSIDE:
            return np.int64(-1)
        code += powers[n] * phase
    return code


@inline
def _neighbours(local, z, y, x):
    """Return the code of the neighbours of a voxel's phase; -1 where one is outside."""
    own, code = local[z, y, x], np.int64(0)
    for dz in range(-1, 2):
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                there = local[z + dz, y + dy, x + dx]
                if there == OUTSIDE:
                    return np.int64(-1)
                if there == own:
                    code += _weight(dz, dy, dx)
    return code


@inline
def _weight(dz, dy, dx):
    """Return what a neighbour counts in the code; nothing in the middle."""
    apart = abs(dz) + abs(dy) + abs(dx)
    if apart == 1:
        return np.int64(_EDGES * _CORNERS)
    if apart == 2:
        return np.int64(_CORNERS)
    return np.int64(1 if apart == 3 else 0)


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
    slopes, balls, euler, euler_off, euler_weights = misfit
    key, number = draw
    spots = _interface(local)
    _shuffle(spots, key, number)
    powers = phases ** np.arange(8)
    codes = _all_neighbours(local)
    if len(slopes) > balls:
        fills = fill_balls(local, MARGIN, phases)
    else:
        fills = np.empty((0, 0, 0, 0, 0), np.int32)
    around = (codes, fills, ball_scratch())
    marks, mark = np.zeros(local.size, np.int32), np.int32(0)
    stack = np.empty(_SMALL, np.int64)
    bins, by = np.empty(_MOST_BINS, np.int64), np.empty(_MOST_BINS, np.int64)
    grid = np.empty(27, np.int64)
    loops = np.zeros(len(euler), np.float64)
    done, was = np.empty(len(spots), np.int64), np.empty(len(spots), np.uint8)
    now, height, width = 0, local.shape[1], local.shape[2]
    sides, gained, price, whole, whole_price = cells
    cubes = 3 * phases * CHORDS
    combinations = powers[7] * phases
    for n in range(len(spots)):
        spot = spots[n]
        z, y, x = spot // (height * width), spot // width % height, spot % width
        at_z, at_y, at_x = z - MARGIN, y - MARGIN, x - MARGIN
        if free.size and not free[at_z, at_y, at_x]:
            continue
        own = local[z, y, x]
        new = _other(local, z, y, x, philox(key, number, spot, 0, 1)[0])
        if new == OUTSIDE:
            continue
        count = _changes(local, around, z, y, x, new, phases, powers, grid, bins, by)
        more = _gained(gained, sides, z, y, x)
        if price == 0 and more[new] >= 0:
            continue
        energy = 2.0 * price * (more[new] - more[own] + 1)
        energy += 2.0 * whole_price * (whole[new] - whole[own] + 1)
        energy += votes.effort * _depth(votes.field[:, at_z, at_y, at_x], own, new, votes.level)
        loops[:] = 0
        for k in range(count):
            one = bins[k]
            energy += by[k] * slopes[one, 0] + by[k] * by[k] * slopes[one, 1]
            if cubes <= one < cubes + combinations:
                for e in range(len(euler)):
                    loops[e] += by[k] * euler[e, one - cubes]
        for e in range(len(euler)):
            energy += euler_weights[e] * loops[e] * (2 * euler_off[e] + loops[e])
        kept = energy < 0
        if kept:
            small, mark = _touches_small(local, spot, own, steps[:6], marks, mark, stack)
            kept = not small
        if kept:
            small, mark = _touches_small(local, spot, new, steps, marks, mark, stack)
            kept = not small
        if not kept:
            continue
        _apply(local, around, z, y, x, new)
        done[now], was[now] = spot, own
        now += 1
        more[new] += 1
        more[own] -= 1
        whole[new] += 1
        whole[own] -= 1
        for k in range(count):
            change[bins[k]] += by[k]
            slopes[bins[k], 0] += 2 * slopes[bins[k], 1] * by[k]
        for e in range(len(euler)):
            euler_off[e] += loops[e]
    given = (local, around, phases, powers, grid, bins, by, change, done[:now], was[:now])
    left = now - _undo(given, cells, False)
    return left - _undo(given, cells, True)


@inline
def _undo(given, cells, of_block):
    """Take back the last changes that left a cell, or the block, with too many of a phase. Return
    how many.
    """
    local, around, phases, powers, grid, bins, by, change, done, was = given
    sides, gained, price, whole, _ = cells
    height, width, undone = local.shape[1], local.shape[2], 0
    for n in range(len(done) - 1, -1, -1):
        spot = done[n]
        z, y, x = spot // (height * width), spot // width % height, spot % width
        own, old, more = local[z, y, x], was[n], _gained(gained, sides, z, y, x)
        too_many = whole[own] if of_block else more[own]
        if own == old or too_many <= 0 or (price == 0 and more[old] >= 0):
            continue
        count = _changes(local, around, z, y, x, old, phases, powers, grid, bins, by)
        for k in range(count):
            change[bins[k]] += by[k]
        _apply(local, around, z, y, x, old)
        more[own] -= 1
        more[old] += 1
        whole[own] -= 1
        whole[old] += 1
        undone += 1
    return undone


@inline
def _gained(gained, sides, z, y, x):
    """Return what the cell of a voxel of the block has too many of each phase, (phases,)."""
    return gained[(z - MARGIN) // sides[0], (y - MARGIN) // sides[1], (x - MARGIN) // sides[2]]


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
def _other(local, z, y, x, word):
    """Draw the phase of a face neighbour that has another one; `OUTSIDE` where there is none."""
    own, count, found = local[z, y, x], 0, np.uint8(OUTSIDE)
    for axis in range(3):
        for step in (-1, 1):
            there = _next(local, axis, step, z, y, x)
            count += there != own and there != OUTSIDE
    if count == 0:
        return found
    pick = below(word, count)
    for axis in range(3):
        for step in (-1, 1):
            there = _next(local, axis, step, z, y, x)
            if there != own and there != OUTSIDE:
                if pick == 0:
                    found = there
                pick -= 1
    return found


@inline
def _next(local, axis, step, z, y, x):
    """Return the phase `step` voxels from a voxel along an axis."""
    if axis == 0:
        return local[z + step, y, x]
    if axis == 1:
        return local[z, y + step, x]
    return local[z, y, x + step]


@inline
def _depth(votes, own, new, level):
    """Return how far votes (C,) lie on a phase's side of where it ends."""
    if len(votes) == 1:
        far = np.float64(votes[0]) - level
        return far if own == 1 else -far
    return (np.float64(votes[own]) - np.float64(votes[new])) / 2


@inline
def _all_neighbours(local):
    """Return the codes of the neighbours of the block's voxels and of those next to it; -1
    elsewhere.
    """
    codes = np.full(local.shape, -1, np.int16)
    for z in range(MARGIN - 1, local.shape[0] - MARGIN + 1):
        for y in range(MARGIN - 1, local.shape[1] - MARGIN + 1):
            for x in range(MARGIN - 1, local.shape[2] - MARGIN + 1):
                if local[z, y, x] != OUTSIDE:
                    codes[z, y, x] = _neighbours(local, z, y, x)
    return codes


@inline
def _apply(local, around, z, y, x, new):
    """Give a voxel to a phase; neighbours and balls `around` follow."""
    codes, fills, scratch = around
    own = local[z, y, x]
    local[z, y, x] = new
    for dz in range(-1, 2):
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                if codes[z + dz, y + dy, x + dx] < 0:
                    continue
                there = local[z + dz, y + dy, x + dx]
                if there == own:
                    codes[z + dz, y + dy, x + dx] -= _weight(dz, dy, dx)
                elif there == new:
                    codes[z + dz, y + dy, x + dx] += _weight(dz, dy, dx)
    if codes[z, y, x] >= 0:
        codes[z, y, x] = _neighbours(local, z, y, x)
    if fills.size:
        place = (z - MARGIN, y - MARGIN, x - MARGIN)
        refill_balls(fills, *place, own, new, scratch)


@inline
def _changes(local, around, z, y, x, new, phases, powers, grid, bins, by):
    """List the bins that change where a voxel becomes a phase, and by how much; return how many."""
    codes, fills, scratch = around
    count, own = 0, local[z, y, x]
    for axis in range(3):
        count = _chord_changes(local, axis, z, y, x, new, phases, bins, by, count)
    first = 3 * phases * CHORDS
    more = np.int64(new) - np.int64(own)
    for n in range(len(STRIDES)):
        stride, outside = _strides[n], False
        for i in range(3):
            for j in range(3):
                row = local[z + (i - 1) * stride, y + (j - 1) * stride]
                for k in range(3):
                    there = row[x + (k - 1) * stride]
                    grid[9 * i + 3 * j + k] = there
                    outside |= there == OUTSIDE
        for k in range(8):
            corner = 9 * (1 - (k >> 2)) + 3 * (1 - ((k >> 1) & 1)) + 1 - (k & 1)
            code = np.int64(0)
            for m in range(8):
                there = grid[corner + 9 * (m >> 2) + 3 * ((m >> 1) & 1) + (m & 1)]
                if outside and there == OUTSIDE:
                    code = np.int64(-1)
                    break
                code += powers[m] * there
            if code >= 0:
                bins[count], by[count] = first + code, -1
                bins[count + 1], by[count + 1] = first + code + more * powers[k], 1
                count += 2
        first += powers[7] * phases
    alike = np.int64(0)  # of the new phase, around the voxel
    for dz in range(-1, 2):
        for dy in range(-1, 2):
            for dx in range(-1, 2):
                there, weight = local[z + dz, y + dy, x + dx], _weight(dz, dy, dx)
                if weight and there == new:
                    alike += weight
                code = np.int64(codes[z + dz, y + dy, x + dx])
                if code < 0 or not weight or (there != own and there != new):
                    continue
                bins[count], by[count] = first + there * NEIGHBOURS + code, -1
                code += -weight if there == own else weight
                bins[count + 1], by[count + 1] = first + there * NEIGHBOURS + code, 1
                count += 2
    if codes[z, y, x] >= 0:
        bins[count], by[count] = first + own * NEIGHBOURS + codes[z, y, x], -1
        bins[count + 1], by[count + 1] = first + new * NEIGHBOURS + alike, 1
        count += 2
    if fills.size:
        first += phases * NEIGHBOURS
        place = (z - MARGIN, y - MARGIN, x - MARGIN)
        count = list_ball_changes(fills, *place, own, new, first, scratch, bins, by, count)
    return count


@inline
def _chord_changes(local, axis, z, y, x, new, phases, bins, by, count):
    """List the chords along an axis that end or begin where a voxel becomes a phase."""
    own = local[z, y, x]
    left, before = _extent(local, axis, -1, 0, z, y, x)
    right, after = _extent(local, axis, 1, 0, z, y, x)
    length = left + right + 1
    count = _count_chord(axis, own, before, after, length, -1, phases, bins, by, count)
    # the new chord goes as far as what was there before on either side
    low, low_end = 0, own
    high, high_end = 0, own
    if left:
        count = _count_chord(axis, own, before, new, left, 1, phases, bins, by, count)
    else:
        low_end = before
        if before == new:
            more, low_end = _extent(local, axis, -1, 1, z, y, x)
            low = more + 1
            count = _count_chord(axis, new, low_end, own, low, -1, phases, bins, by, count)
    if right:
        count = _count_chord(axis, own, new, after, right, 1, phases, bins, by, count)
    else:
        high_end = after
        if after == new:
            more, high_end = _extent(local, axis, 1, 1, z, y, x)
            high = more + 1
            count = _count_chord(axis, new, own, high_end, high, -1, phases, bins, by, count)
    length = low + high + 1
    return _count_chord(axis, new, low_end, high_end, length, 1, phases, bins, by, count)


@inline
def _extent(local, axis, step, away, z, y, x):
    """Return how many voxels beyond the one `away` from a voxel have its phase, up to `CHORDS`, and
    the phase of the one after them.
    """
    at = away * step
    own, count = _next(local, axis, at, z, y, x), 0
    while count < CHORDS:
        at += step
        there = _next(local, axis, at, z, y, x)
        if there != own:
            return count, there
        count += 1
    return count, own


@inline
def _count_chord(axis, phase, before, after, length, by_how_many, phases, bins, by, count):
    """List a chord, where it is counted: not where a face cuts it."""
    if before == OUTSIDE or (length <= REACH and after == OUTSIDE):
        return count
    bins[count] = (axis * phases + phase) * CHORDS + min(length, CHORDS) - 1
    by[count] = by_how_many
    return count + 1


@inline
def _touches_small(local, spot, phase, steps, marks, mark, stack):
    """Return whether a voxel has no neighbour of this phase, or one in a body of less than `_SMALL`
    voxels without it, and the last of the marks that were used. `steps` lead to neighbours.
    """
    all_of, alone = local.reshape(-1), True
    centre = mark + np.int32(1)
    marks[spot], mark = centre, centre
    for n in range(len(steps)):
        first = spot + steps[n]
        if all_of[first] != phase:
            continue
        alone = False
        if marks[first] >= centre:
            continue
        mark += np.int32(1)
        marks[first], stack[0], top, voxels = mark, first, 1, 1
        met, large = False, False
        while top and not met and not large:
            top -= 1
            here = stack[top]
            for k in range(len(steps)):
                there = here + steps[k]
                if there < 0 or there >= all_of.size:
                    large = True
                elif all_of[there] == phase and marks[there] != mark and marks[there] != centre:
                    if marks[there] > centre:
                        met = True  # a large one of before
                        break
                    voxels += 1
                    if voxels >= _SMALL:
                        large = True
                        break
                    marks[there] = mark
                    stack[top] = there
                    top += 1
        if not met and not large:
            return True, mark
    return alone, mark
