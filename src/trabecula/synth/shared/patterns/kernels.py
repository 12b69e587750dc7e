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

_FACES, EDGES, CORNERS = 7, 13, 9  # of their counts: 0 .. 6, 0 .. 12, 0 .. 8
NEIGHBOURS = _FACES * EDGES * CORNERS

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
                code = neighbours_of(local, z, y, x)
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
def neighbours_of(local, z, y, x):
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
        return np.int64(EDGES * CORNERS)
    if apart == 2:
        return np.int64(CORNERS)
    return np.int64(1 if apart == 3 else 0)
