"""Votes: matched neighbourhoods averaged where they overlap, by plain functions on arrays.

S, E and `match` as in `sweeps`. Sites that are not `active` do not vote.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import inline, kernel


class CubeLayout(NamedTuple):
    """Geometry of a vote, (3,) each: the extent and strides of E, the steps of S, the sides and the
    rims of neighbourhoods, in voxels, and the output's axes that wrap.
    """

    shape: tuple[int, ...]
    strides: tuple[int, ...]
    steps: tuple[int, ...]
    box: tuple[int, ...]
    trims: tuple[int, ...]
    wraps: tuple[bool, ...]


@kernel
def weigh(distance, active, floor, mean, table, weight, start, stop):
    """Look up 256 times the ratio of each site's distance to the mean in the table; 0 where a site
    is not active.
    """
    for z in range(start, stop):
        for y in range(distance.shape[1]):
            for x in range(distance.shape[2]):
                ratio = (np.int64(distance[z, y, x]) + floor) * 256 // mean
                weight[z, y, x] = table[min(max(ratio, 1), 4095)] if active[z, y, x] else 0


@kernel
def vote(field, match, weight, layout, plane, result, start, stop):
    """Average the matched neighbourhoods with their weights over voxel planes start..stop, times
    256, in int16; 0 where none is.

    field (C, z, y, x) int8, the exemplar; match, weight (Z, Y, X) int32, where a site of weight 0
    does not vote; strides of E, steps of S, box and trims (3,) int in voxels; wraps (3,) bool;
    plane (C + 1, y, x) int32 scratch, as wide as the grid covers; result (C, ...) int16. The rim of
    `trims` voxels of a neighbourhood does not vote, except at a border that does not wrap.
    """
    C, Z, Y, X = result.shape
    wraps = layout.wraps
    summed = np.empty(match.shape[1:], np.int32)
    for z in range(start, stop):
        plane[:] = 0
        summed[:] = 0
        for turn in range(2 if wraps[0] else 1):
            _vote_plane(field, match, weight, layout, plane, summed, z + turn * Z)
        _spread(summed, plane[C], layout)
        fold(plane, Y, X, wraps)
        for c in range(C):
            for y in range(Y):
                for x in range(X):
                    weights = plane[C, y, x]
                    result[c, z, y, x] = (
                        np.int64(plane[c, y, x]) * 256 // weights if weights > 0 else 0
                    )


@inline
def fold(plane, Y, X, wraps):
    """Add the part beyond an axis that wraps to its beginning."""
    # Loops and no sums of arrays, here and below: those take Numba seconds to compile.
    for c in range(plane.shape[0]):
        for y in range(Y, plane.shape[1] if wraps[1] else 0):
            for x in range(plane.shape[2]):
                plane[c, y - Y, x] += plane[c, y, x]
        for y in range(plane.shape[1]):
            for x in range(X, plane.shape[2] if wraps[2] else 0):
                plane[c, y, x - X] += plane[c, y, x]


@inline
def reach(site, count, width, trim, wrap):
    """Return the voxels first .. last of a neighbourhood that vote along an axis."""
    first = 0 if site == 0 and not wrap else trim
    last = width if site == count - 1 and not wrap else width - trim
    return first, last


@inline
def _vote_plane(field, match, weight, layout, plane, summed, z):
    """Add the sites' weighted votes for voxel plane z to `plane`, and their weights to `summed`."""
    shape, strides, steps, box, trims, wraps = layout
    SZ, SY, SX = match.shape
    C, width, step = field.shape[0], box[2], steps[2]
    weights = np.empty(width, np.int32)
    for sz in range(max(0, (z - box[0] + steps[0]) // steps[0]), min(SZ, z // steps[0] + 1)):
        dz = z - sz * steps[0]
        z0, z1 = reach(sz, SZ, box[0], trims[0], wraps[0])
        if dz < z0 or dz >= z1:
            continue
        for sy in range(SY):
            y0, y1 = reach(sy, SY, box[1], trims[1], wraps[1])
            for sx in range(SX):
                w = weight[sz, sy, sx]
                if w == 0:
                    continue
                summed[sy, sx] += w
                # Whole rows, with weight 0 at the rim: the compiler makes eight voxels one
                # addition.
                x0, x1 = reach(sx, SX, width, trims[2], wraps[2])
                weights[:] = w
                weights[:x0] = 0
                weights[x1:] = 0
                m = match[sz, sy, sx]
                ez = m // (shape[2] * shape[1]) * strides[0] + dz
                ey = (m // shape[2]) % shape[1] * strides[1]
                ex = m % shape[2] * strides[2]
                for c in range(C):
                    for dy in range(y0, y1):
                        to = plane[c, sy * steps[1] + dy, sx * step : sx * step + width]
                        row = field[c, ez, ey + dy, ex : ex + width]
                        for x in range(width):
                            to[x] += weights[x] * np.int32(row[x])


@inline
def _spread(summed, weights, layout):
    """Sum the weights of a plane's sites over its voxels."""
    _, _, steps, box, trims, wraps = layout
    SY, SX = summed.shape
    row = np.empty(SX, np.int32)
    for y in range(weights.shape[0]):
        row[:] = 0
        for sy in range(max(0, (y - box[1] + steps[1]) // steps[1]), min(SY, y // steps[1] + 1)):
            y0, y1 = reach(sy, SY, box[1], trims[1], wraps[1])
            if y0 <= y - sy * steps[1] < y1:
                for sx in range(SX):
                    row[sx] += summed[sy, sx]
        for sx in range(SX):
            x0, x1 = reach(sx, SX, box[2], trims[2], wraps[2])
            for x in range(sx * steps[2] + x0, sx * steps[2] + x1):
                weights[y, x] += row[sx]
