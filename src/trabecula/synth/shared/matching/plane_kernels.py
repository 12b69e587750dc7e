"""What flat neighbourhoods say in a slab of a volume, whichever axis they are seen across: plain
functions on arrays.

Glossary as in `kernels`; the planes of a view lie across its axis, the first of its grid. Where
that is y or x, rows of a plane are z of the volume: a slab of the volume is some rows of every
plane, so nothing has to be turned. `sides`, `strides`, `steps`, `trims` and `wraps` are (3,), along
the axes of the view.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.synth.shared.matching.kernels import reach

_TOGETHER = 16  # planes across x that enter a slab at once: a line of the cache


@kernel
def add_votes(
    total, start, values, match, weight, shape, sides, strides, steps, width, trims, wraps, axis
):
    """Add the weighted sums of a view's matched neighbourhoods to a slab of the volume that begins
    at plane `start`.

    total (C, ...) int32, of the volume; values (C, z, y, x) int16, what the exemplar's voxels add;
    match, weight (Z, Y, X) int32, where a site of weight 0 does not vote. The rim of `trims` voxels
    does not vote, except at a border that does not wrap.
    """
    C, depth, height, across = total.shape
    rows = height if axis == 0 else depth
    together = _TOGETHER if axis == 2 else 1
    planes = np.empty((together, C, rows, (match.shape[2] - 1) * steps[2] + width), np.int32)
    if axis == 0:
        for z in range(depth):
            m, w = match[start + z], weight[start + z]
            _vote_rows(
                values, m, w, shape, sides, strides, steps, width, trims, wraps, 0, planes[0]
            )
            total[:, z] += planes[0, :, :, :across]
    elif axis == 1:
        for y in range(height):
            m, w = match[y], weight[y]
            _vote_rows(
                values, m, w, shape, sides, strides, steps, width, trims, wraps, start, planes[0]
            )
            total[:, :, y] += planes[0, :, :, :across]
    else:
        for first in range(0, across, together):
            count = min(together, across - first)
            for n in range(count):
                m, w = match[first + n], weight[first + n]
                _vote_rows(
                    values,
                    m,
                    w,
                    shape,
                    sides,
                    strides,
                    steps,
                    width,
                    trims,
                    wraps,
                    start,
                    planes[n],
                )
            for c in range(C):
                for z in range(depth):
                    for y in range(height):
                        for n in range(count):
                            total[c, z, y, first + n] += planes[n, c, z, y]


@inline
def _vote_rows(
    values, match, weight, shape, sides, strides, steps, width, trims, wraps, start, plane
):
    """The weighted sums of the sites of one plane, in as many of its rows from `start` on as
    `plane` (C, rows, ...) has.
    """
    C, SY, SX, step = len(values), match.shape[0], match.shape[1], steps[2]
    weights = np.empty(width, np.int32)
    plane[:] = 0
    for turn in range(2 if wraps[1] else 1):
        low = start + turn * sides[1]
        high = low + plane.shape[1]
        for sy in range(
            max(0, (low - width + steps[1]) // steps[1]), min(SY, (high - 1) // steps[1] + 1)
        ):
            y0, y1 = reach(sy, SY, width, trims[1], wraps[1])
            y0, y1 = max(y0, low - sy * steps[1]), min(y1, high - sy * steps[1])
            if y0 >= y1:
                continue
            for sx in range(SX):
                w = weight[sy, sx]
                if w == 0:
                    continue
                # Whole rows, with weight 0 at the rim: the compiler makes eight voxels one
                # addition.
                x0, x1 = reach(sx, SX, width, trims[2], wraps[2])
                weights[:] = w
                weights[:x0] = 0
                weights[x1:] = 0
                m = match[sy, sx]
                ez = m // (shape[2] * shape[1]) * strides[0]
                ey = (m // shape[2]) % shape[1] * strides[1]
                ex = m % shape[2] * strides[2]
                for c in range(C):
                    for dy in range(y0, y1):
                        to = plane[c, sy * steps[1] + dy - low, sx * step : sx * step + width]
                        row = values[c, ez, ey + dy, ex : ex + width]
                        for x in range(width):
                            to[x] += weights[x] * np.int32(row[x])
    for x in range(sides[2], plane.shape[2] if wraps[2] else 0):
        plane[:, :, x - sides[2]] += plane[:, :, x]


@kernel
def divide(total, votes, start):
    """Votes (C, Z, Y, X) int16 from plane `start` on: 256 times the sums (C + 1, ...) over the last
    of them, the weights.
    """
    C, depth, height, across = total.shape
    for c in range(C - 1):
        for z in range(depth):
            for y in range(height):
                for x in range(across):
                    below = max(total[C - 1, z, y, x], np.int32(1))
                    votes[c, start + z, y, x] = np.int64(total[c, z, y, x]) * 256 // below


@kernel
def compare_pixels(
    mean,
    cost,
    chosen,
    start,
    first,
    field,
    dear,
    match,
    weight,
    shape,
    sides,
    strides,
    steps,
    width,
    trims,
    wraps,
    axis,
):
    """For voxels of a slab from plane `start` on the voxel of the exemplar, of all matched with it,
    nearest in value to `mean`.

    mean (C, ...) int16, 256 times a value; cost (...) int64 the least so far and chosen (...) int32
    the voxel that it belongs to, numbered from `first`, both updated; all three of the slab, with
    the axis of the view first. field (C, z, y, x) int8; dear (z, y, x) int32, a factor of the
    squared distance. Of equals the first one stays. The rest as in `add_votes`.
    """
    C, EY, EX = len(field), field.shape[2], field.shape[3]
    SY, SX = match.shape[1:]
    low = 0 if axis == 0 else start
    high = low + cost.shape[1]
    for plane in range(len(cost)):
        site = start + plane if axis == 0 else plane
        for sy in range(SY):
            y0, y1 = reach(sy, SY, width, trims[1], wraps[1])
            if not _meets(sy * steps[1] + y0, sy * steps[1] + y1, low, high, sides[1]):
                continue
            for sx in range(SX):
                if weight[site, sy, sx] == 0:
                    continue
                x0, x1 = reach(sx, SX, width, trims[2], wraps[2])
                m = match[site, sy, sx]
                ez = m // (shape[2] * shape[1]) * strides[0]
                ey = (m // shape[2]) % shape[1] * strides[1]
                ex = m % shape[2] * strides[2]
                for dy in range(y0, y1):
                    y = _around(sy * steps[1] + dy, sides[1]) - low
                    if y < 0 or y >= cost.shape[1]:
                        continue
                    for dx in range(x0, x1):
                        x = _around(sx * steps[2] + dx, sides[2])
                        apart = np.int64(0)
                        for c in range(C):
                            d = (np.int64(field[c, ez, ey + dy, ex + dx]) << 8) - mean[
                                c, plane, y, x
                            ]
                            apart += d * d
                        # A distance of 0 would hide what is dear.
                        apart = (apart + 256) * dear[ez, ey + dy, ex + dx]
                        if apart < cost[plane, y, x]:
                            cost[plane, y, x] = apart
                            chosen[plane, y, x] = first + (ez * EY + ey + dy) * EX + ex + dx


@inline
def _around(place, side):
    """A place along an axis that wraps."""
    while place >= side:
        place -= side
    return place


@inline
def _meets(begin, end, low, high, side):
    """Whether any of begin .. end, around an axis of `side`, lies within low .. high."""
    meets = False
    for row in range(begin, end):
        meets |= low <= _around(row, side) < high
    return meets


@kernel
def paint(pixels, chosen, field, start):
    """Give voxels of (C, Z, Y, X) int8 from plane `start` on the value (C, n) of the pixel that was
    chosen, where one was.
    """
    for z in range(chosen.shape[0]):
        for y in range(chosen.shape[1]):
            for x in range(chosen.shape[2]):
                if chosen[z, y, x] >= 0:
                    for c in range(len(field)):
                        field[c, start + z, y, x] = pixels[c, chosen[z, y, x]]
