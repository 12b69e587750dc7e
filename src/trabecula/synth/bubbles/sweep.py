"""Arrivals in all blocks of a box, or in some, by a search in three steps.

The steps go from cubes of 16 voxels over parts of 8 to blocks of 4. A world holds the arrays that
kernels read, as tuples:

    nodes     shifts (Z, Y, X, 3) float32, flow (Z, Y, X, 3) int8 (either may be empty: none), the
              first node of both (6,)
    bubbles   the first of every cell, places (N, 3) float64, 1 / v, half of their flows (N, 3) or
              none, names uint32
    lattice   first cell (3,), cells (3,), their edges (3,) in voxels
    law       latest arrival, wall, reach (all in voxels), c and a of the flow (see `kernels`)
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.synth.bubbles.kernels import (
    BLOCK,
    MOST,
    SUPER,
    gather,
    keep_near,
    set_around,
    set_arrivals,
    set_forms,
)

_LATEST = np.float32(np.finfo(np.float32).max)
_NOWHERE = np.int64(-1) << np.int64(40)


@inline
def _set_block(node, n, corner, flat):
    """Set the first node of block n of a cube, part by part."""
    bits = 2 if flat else 3
    part, block = n >> bits, n & (1 << bits) - 1
    node[0] = corner[0] + 2 * (part >> 2) + (block >> 2)
    node[1] = corner[1] + 2 * (part >> 1 & 1) + (block >> 1 & 1)
    node[2] = corner[2] + 2 * (part & 1) + (block & 1)


@inline
def _set_cube(node, n, first, sides, flat):
    """Set the first node of cube n."""
    node[0] = 0 if flat else SUPER * (first[0] + n // (sides[1] * sides[2]))
    node[1] = SUPER * (first[1] + n // sides[2] % sides[1])
    node[2] = SUPER * (first[2] + n % sides[2])


@inline
def _enter(seen, node, shift):
    """Return whether a node lies in another cube (part) than the last one, and remember it.

    A cube is 1 << shift blocks wide; `seen` holds the first node of the last one.
    """
    z, y, x = node[0] >> shift << shift, node[1] >> shift << shift, node[2] >> shift << shift
    moved = z != seen[0] or y != seen[1] or x != seen[2]
    seen[0], seen[1], seen[2] = z, y, x
    return moved


@kernel
def grow(
    labels,
    values,
    corner,
    first,
    sides,
    blocks,
    picks,
    start,
    stop,
    flat,
    world,
    level,
    levels,
    merging,
    phases,
):
    """Grow blocks: label a box with them, or give T^2 at some of their voxels.

    Parameters
    ----------
    labels : (Z, Y, X)
        Of the box that begins at voxel `corner`: `phases[0]` where T^2 <= `level`, else
        `phases[1]`. Where `levels` (Z, Y, X) float32 is not empty, it holds the level of every
        voxel, and `level` is the highest of them.
    first, sides : (3,) int64
        The cubes of 16 voxels that cover the box. Their blocks `start` .. `stop` are grown, cube by
        cube, part by part.
    values, blocks, picks : (N, P) float32, (N, 3) int64, (1 or N, P) uint8
        Where `blocks` is not empty, those from `start` to `stop` are grown instead, and `values`
        gets T^2 of the voxels of these numbers.
    """
    # Tuples are unpacked once and their arrays passed one by one: Numba counts references each time
    # it unpacks a tuple.
    (shifts, flow, origins), (starts, places, brakes, flows, names), (low, cells, edges), law = (
        world
    )
    most = len(places) + 1
    everyone, many = np.empty(most, np.int64), np.empty(most, np.int64)
    some, few = np.empty(most, np.int64), np.empty(most, np.int64)
    times = np.empty(most)
    slacks = np.empty(most)
    around = np.zeros((9, 8))
    ends = np.zeros((2, 3), np.int64)
    rows, voxels, each = min(most, MOST), 16 if flat else 64, 16 if flat else 64
    forms, slopes = np.empty((rows, 64), np.float32), np.empty((rows, 3), np.float32)
    at, ahead = np.empty(8, np.float32), np.empty(8, np.float32)
    begins, rises = np.empty(16, np.float32), np.empty(16, np.float32)
    arrivals, walls = np.empty(64, np.float32), np.empty(64, np.float32)
    cube = np.full(3, _NOWHERE)
    part = np.full(3, _NOWHERE)
    node = np.zeros(3, np.int64)
    begin = np.zeros(3, np.int64)
    flat_labels, flat_levels = labels.reshape(-1), levels.reshape(-1)
    in_cube = in_part = 0
    for n in range(start, stop):
        if len(blocks) > 0:
            node[0], node[1], node[2] = blocks[n, 0], blocks[n, 1], blocks[n, 2]
        else:
            if n == start or n % each == 0:
                _set_cube(begin, n // each, first, sides, flat)
            _set_block(node, n % each, begin, flat)
            if _outside(node[0], node[1], node[2], flat, corner, labels.shape):
                continue
        if _enter(cube, node, 2):
            count = gather(
                everyone, cube, flat, starts, places, brakes, low, cells, edges, law, ends
            )
            set_around(around, cube[0], cube[1], cube[2], SUPER, flat, shifts, flow, origins)
            in_cube = keep_near(
                everyone, count, many, around, places, brakes, flows, law, times, slacks
            )
            part[0] = _NOWHERE
        if _enter(part, node, 1):
            set_around(around, part[0], part[1], part[2], 2, flat, shifts, flow, origins)
            in_part = keep_near(
                many, in_cube, some, around, places, brakes, flows, law, times, slacks
            )
        set_around(around, node[0], node[1], node[2], 1, flat, shifts, flow, origins)
        count = min(
            keep_near(some, in_part, few, around, places, brakes, flows, law, times, slacks), MOST
        )
        count = set_forms(
            forms,
            slopes,
            at,
            ahead,
            begins,
            rises,
            few,
            count,
            around,
            flat,
            places,
            brakes,
            flows,
            law,
        )
        set_arrivals(
            arrivals, walls, forms, slopes, few, count, voxels, level, law[1], names, merging
        )
        if len(blocks) > 0:
            for p in range(picks.shape[1]):
                values[n, p] = arrivals[picks[n if len(picks) > 1 else 0, p]]
        else:
            _write(
                flat_labels,
                labels.shape,
                corner,
                node,
                flat,
                arrivals,
                flat_levels,
                phases[0],
                phases[1],
            )


@inline
def _outside(z, y, x, flat, corner, shape):
    """Return whether a block lies outside of the box."""
    if not flat and (BLOCK * (z + 1) <= corner[0] or BLOCK * z >= corner[0] + shape[0]):
        return True
    if BLOCK * (y + 1) <= corner[1] or BLOCK * y >= corner[1] + shape[1]:
        return True
    return BLOCK * (x + 1) <= corner[2] or BLOCK * x >= corner[2] + shape[2]


@inline
def _write(voxels, shape, corner, node, flat, arrivals, latest, free, solid):
    """Label the voxels of a block that lie in the box."""
    rows = 4 if flat else 16
    deep, high, wide = shape
    z, y, x = BLOCK * node[0] - corner[0], BLOCK * node[1] - corner[1], BLOCK * node[2] - corner[2]
    start, stop = max(0, -x), min(BLOCK, wide - x)
    for n in range(rows):
        k, m = z + (n >> 2), y + (n & 3)
        if k < 0 or k >= deep or m < 0 or m >= high:
            continue
        row = np.uint64((k * high + m) * wide + x + start)
        if len(latest) > 0:
            for i in range(stop - start):
                at = row + np.uint64(i)
                voxels[at] = free if arrivals[(start + i) * rows + n] <= latest[at] else solid
        else:
            for i in range(stop - start):
                voxels[row + np.uint64(i)] = (
                    free if arrivals[(start + i) * rows + n] <= _LATEST else solid
                )
