"""Search and vote: plain functions on arrays.

Glossary: S the neighbourhoods of the output on a grid, E those of the exemplar as a flat list; `match` the index into E per
site of S. `ratio` is the grid's step over that of E, so that a neighbour's match moves by `ratio` cells of E.
Both kernels read old arrays and write new ones over a slab (Jacobi), so tiles and threads do not matter.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.random import below, philox


@kernel
def start_matches(match, count, key):
    """Random patches: an independent uniform index per site."""
    for z in range(match.shape[0]):
        for y in range(match.shape[1]):
            for x in range(match.shape[2]):
                word = philox(key, z, y, x, 0)[0]
                match[z, y, x] = below(word, count)


@inline
def _distance(a, b):
    total = np.int32(0)
    for i in range(a.shape[0]):
        difference = np.int32(a[i]) - np.int32(b[i])
        total += difference * difference
    return total


@inline
def _moved(match, shape, dz, dy, dx):
    """The index `dz, dy, dx` cells further in E, or -1 outside."""
    x = match % shape[2] + dx
    y = (match // shape[2]) % shape[1] + dy
    z = match // (shape[2] * shape[1]) + dz
    if z < 0 or y < 0 or x < 0 or z >= shape[0] or y >= shape[1] or x >= shape[2]:
        return np.int64(-1)
    return np.int64((z * shape[1] + y) * shape[2] + x)


@inline
def _clamped(value, size):
    return min(max(value, 0), size - 1)


@inline
def _random_candidate(words, match, shape, radius):
    """Anywhere in E where `radius` is 0, otherwise within `radius` of `match`."""
    if radius == 0:
        return below(words[0], shape[0] * shape[1] * shape[2])
    x = _clamped(match % shape[2] + below(words[2], 2 * radius + 1) - radius, shape[2])
    y = _clamped((match // shape[2]) % shape[1] + below(words[1], 2 * radius + 1) - radius, shape[1])
    z = _clamped(match // (shape[2] * shape[1]) + below(words[0], 2 * radius + 1) - radius, shape[0])
    return np.int64((z * shape[1] + y) * shape[2] + x)


@kernel
def search(features, exemplar, penalty, old, match, distance, shape, ratio, key, sweep, tries, start, stop):
    """One sweep: the best of the own match, the six neighbours' moved along, and random ones, for sites start..stop.

    features (Z, Y, X, D) int16; exemplar (N, D) int16; penalty (N,) float32 factors; old, match (Z, Y, X) int32;
    distance (Z, Y, X) int32, unpenalised.
    """
    Z, Y, X = old.shape
    longest = max(shape[0], max(shape[1], shape[2]))
    for z in range(start, stop):
        for y in range(Y):
            for x in range(X):
                site = features[z, y, x]
                best = np.int64(old[z, y, x])
                least = np.float32(_distance(site, exemplar[best])) * penalty[best]
                for axis in range(3):
                    for side in range(-1, 2, 2):
                        dz, dy, dx = (side, 0, 0) if axis == 0 else ((0, side, 0) if axis == 1 else (0, 0, side))
                        nz, ny, nx = z + dz, y + dy, x + dx
                        if nz < 0 or ny < 0 or nx < 0 or nz >= Z or ny >= Y or nx >= X:
                            continue
                        candidate = _moved(np.int64(old[nz, ny, nx]), shape, -dz * ratio, -dy * ratio, -dx * ratio)
                        if candidate < 0 or candidate == best:
                            continue
                        d = np.float32(_distance(site, exemplar[candidate])) * penalty[candidate]
                        if d < least:
                            least, best = d, candidate
                for k in range(tries):
                    radius = 0 if k % 2 == 0 else max(1, longest >> (k // 2 + 2))
                    words = philox(key, z, y, x, (sweep << 8) + k)
                    candidate = _random_candidate(words, best, shape, radius)
                    d = np.float32(_distance(site, exemplar[candidate])) * penalty[candidate]
                    if d < least:
                        least, best = d, candidate
                match[z, y, x] = best
                distance[z, y, x] = _distance(site, exemplar[best])


@kernel
def vote(field, match, weight, shape, stride, step, width, trim, total, result, start, stop):
    """Weighted mean of the matched neighbourhoods over voxel planes start..stop, times 256, in int16.

    field (C, z, y, x) int8, the exemplar; match, weight (Z, Y, X) int32; stride of E in voxels; total (C + 1, ...) int32
    scratch; result (C, ...) int16. The rim of `trim` voxels of a neighbourhood does not vote, except at the border.
    """
    SZ, SY, SX = match.shape
    C = field.shape[0]
    total[:, start:stop] = 0
    for z in range(start, stop):
        for sz in range(max(0, (z - width + step) // step), min(SZ, z // step + 1)):
            dz = z - sz * step
            if (dz < trim and sz > 0) or (dz >= width - trim and sz < SZ - 1):
                continue
            for sy in range(SY):
                y0 = 0 if sy == 0 else trim
                y1 = width if sy == SY - 1 else width - trim
                for sx in range(SX):
                    x0 = 0 if sx == 0 else trim
                    x1 = width if sx == SX - 1 else width - trim
                    m = match[sz, sy, sx]
                    w = weight[sz, sy, sx]
                    ez = m // (shape[2] * shape[1]) * stride + dz
                    ey = (m // shape[2]) % shape[1] * stride
                    ex = m % shape[2] * stride
                    for dy in range(y0, y1):
                        for c in range(C):
                            to = total[c, z, sy * step + dy]
                            row = field[c, ez, ey + dy]
                            for dx in range(x0, x1):
                                to[sx * step + dx] += w * np.int32(row[ex + dx])
                        weights = total[C, z, sy * step + dy]
                        for dx in range(x0, x1):
                            weights[sx * step + dx] += w
        for c in range(C):
            for y in range(total.shape[2]):
                for x in range(total.shape[3]):
                    result[c, z, y, x] = np.int64(total[c, z, y, x]) * 256 // total[C, z, y, x]
