"""Compiled: patterns of the labels of a block, counted.

All on a local array: a block with `MARGIN` voxels around it, in which `OUTSIDE` marks what is not
part of the material. No pattern of a voxel of the block leaves it.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.measure.neighbours import place_along
from trabecula.synth.shared.patterns.balls import OUTSIDE

REACH = 16
"""Voxels of the longest chord that is counted by its length."""

CHORDS = REACH + 1

STRIDES = (1, 2, 3, 5)
"""Voxels between the corners of a cube."""

MARGIN = REACH + 3

_FACES, _EDGES, _CORNERS = 7, 13, 9  # of their counts: 0 .. 6, 0 .. 12, 0 .. 8
NEIGHBOURS = _FACES * _EDGES * _CORNERS

WEIGHTS = np.array(
    [
        (0, _EDGES * _CORNERS, _CORNERS, 1)[abs(z) + abs(y) + abs(x)]
        for z in (-1, 0, 1)
        for y in (-1, 0, 1)
        for x in (-1, 0, 1)
    ]
)
"""Of neighbours in their code, (27,): nothing in the middle."""

_strides = np.array(STRIDES)


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
    for axis in range(3):
        _count_chords(local, axis, phases, counts, rooms)
    first = 3 * phases * CHORDS
    last = first + len(STRIDES) * powers[7] * phases
    side = local.shape[2] - 2 * MARGIN
    codes, near = np.empty(side, np.int32), np.empty(side + 2, np.int32)
    seen = np.empty(side + 2, np.uint8)
    for z in range(MARGIN, local.shape[0] - MARGIN):
        for y in range(MARGIN, local.shape[1] - MARGIN):
            for n in range(len(STRIDES)):
                _cubes_of_row(local, z, y, _strides[n], powers, codes, seen)
                for x in range(side):
                    if seen[x] != OUTSIDE:
                        counts[first + n * powers[7] * phases + codes[x]] += 1
                        rooms[3 * CHORDS + n] += 1
            neighbours_of_row(local, z, y, near, seen)
            row = local[z, y, MARGIN : MARGIN + side]
            for x in range(side):
                if near[x + 1] >= 0:
                    counts[last + row[x] * NEIGHBOURS + near[x + 1]] += 1
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
def _cubes_of_row(local, z, y, stride, powers, codes, seen):
    """Find the codes of the cubes that have their first corner in a row of the block; what is
    `seen` of one is `OUTSIDE` where a corner is.
    """
    codes[:], seen[:] = 0, 0
    for n in range(8):
        first = MARGIN + stride * (n & 1)
        line = local[z + stride * (n >> 2), y + stride * (n >> 1 & 1)]
        row, power = line[first : first + len(codes)], np.int32(powers[n])
        for x in range(len(codes)):
            codes[x] += power * np.int32(row[x])
            seen[x] |= row[x]


@inline
def neighbours_of_row(local, z, y, codes, seen):
    """Find the codes of the neighbours of the voxels in a row of the block, and of one before and
    one after it: -1 where one of them, or the voxel, is outside. `seen` is room.
    """
    codes[:], seen[:] = 0, 0
    first = MARGIN - 1
    own = local[z, y, first : first + len(codes)]
    for n in range(27):
        line, at = local[z + n // 9 - 1, y + n // 3 % 3 - 1], first + n % 3 - 1
        row, weight = line[at : at + len(codes)], np.int32(WEIGHTS[n])
        for x in range(len(codes)):
            codes[x] += weight if row[x] == own[x] else 0
            seen[x] |= row[x]
    for x in range(len(codes)):
        if seen[x] == OUTSIDE:
            codes[x] = -1
