"""Neighbourhoods as bits, a tree over their block counts, and its exact search: plain functions on
arrays.

Glossary: a *corner* is the first voxel of a neighbourhood; `planes[z, y, x]` holds the bits of its
plane z, rows in groups that fill a word, one group of words per bit of a label; `step` is the
distance between voxels that a neighbourhood takes (2 at half resolution). A neighbourhood's
*features* are the numbers of voxels of one phase in each of its 3 x 3 x 3 blocks: the L1 distance
of features never exceeds the number of differing voxels, so it prunes exactly.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.rows import copy_row
from trabecula.numerics.bits import count_bits

FAR = np.int32(1 << 30)
"""Further than any neighbourhood is from another."""


@kernel
def pack_planes(values, planes, width, step, bits, rows, start, stop):
    """Pack the bits of the plane of width x width voxels at every corner (z, y, x), for z in
    start..stop.

    values (Z, Y, X) uint8; planes (Z, Y - span, X - span, bits * words) uint64; `rows` rows go into
    a word.
    """
    height, breadth = width[1], width[2]
    words = planes.shape[3] // bits
    for z in range(start, stop):
        for y in range(planes.shape[1]):
            for x in range(planes.shape[2]):
                for b in range(bits):
                    for w in range(words):
                        word = np.uint64(0)
                        for r in range(w * rows, min(height, (w + 1) * rows)):
                            row = values[z, y + r * step]
                            for i in range(breadth):
                                word = (word << np.uint64(1)) | np.uint64(
                                    (row[x + i * step] >> b) & 1
                                )
                        planes[z, y, x, b * words + w] = word


@inline
def differing(a, z, y, x, b, u, v, w, depth, step, bits, most):
    """Count the voxels that differ between the neighbourhood of `a` at z, y, x and that of `b` at
    u, v, w; stop above `most`.
    """
    total = np.int32(0)
    words = a.shape[3] // bits
    for i in range(depth):
        p, q = a[z + i * step, y, x], b[u + i * step, v, w]
        for j in range(words):
            word = p[j] ^ q[j]
            for k in range(1, bits):
                word |= p[k * words + j] ^ q[k * words + j]
            total += np.int32(count_bits(word))
        if total > most:
            break
    return total


@inline
def corner_of(index, shape):
    """Return the corner z, y, x of a flat index."""
    return index // (shape[1] * shape[2]), index // shape[2] % shape[1], index % shape[2]


@kernel
def gather_features(blocks, corners, shape, offsets, features):
    """Set features[n, j] = blocks[corner n + offsets[j]] of the corners with a flat index in
    `shape`.
    """
    for n in range(len(corners)):
        z, y, x = corner_of(corners[n], shape)
        for j in range(len(offsets)):
            features[n, j] = blocks[z + offsets[j, 0], y + offsets[j, 1], x + offsets[j, 2]]


@inline
def _widest(features, order, a, b, scratch):
    """Return the feature of largest variance over at most 256 of the candidates a..b, and whether
    it varies.
    """
    stride = max(1, (b - a) // 256)
    best, widest = 0, -1.0
    for j in range(features.shape[1]):
        count, total, square = 0, 0.0, 0.0
        for n in range(a, b, stride):
            value = np.float64(features[order[n], j])
            count, total, square = count + 1, total + value, square + value * value
        spread = square * count - total * total
        if spread > widest:
            best, widest = j, spread
    return best, widest > 0


@inline
def _median(features, order, a, b, j, histogram):
    """Return the value of feature j that splits a..b most evenly: those up to it go left. -1 where
    all are equal.
    """
    histogram[:] = 0
    for n in range(a, b):
        histogram[features[order[n], j]] += 1
    below, best, least = 0, -1, b - a
    for value in range(255):
        below += histogram[value]
        if 0 < below < b - a and abs(2 * below - (b - a)) < least:
            best, least = value, abs(2 * below - (b - a))
    return best


@kernel
def grow_tree(features, order, spare, nodes, low, high, leaf):
    """Split the candidates in two along the widest feature, again and again. Return the number of
    nodes.

    features (N, F) uint8; order (N,) int32, permuted in place; nodes (M, 4) int32: first, last + 1,
    left child, right child (0 at a leaf); low, high (M, F) uint8: the least and largest of each
    feature in a node.
    """
    histogram = np.zeros(256, np.int64)
    nodes[0, 1] = len(order)
    count, at = 1, 0
    while at < count:
        a, b = nodes[at, 0], nodes[at, 1]
        low[at], high[at] = 255, 0
        for n in range(a, b):
            row = features[order[n]]
            for j in range(features.shape[1]):
                low[at, j], high[at, j] = min(low[at, j], row[j]), max(high[at, j], row[j])
        if b - a > leaf and count + 2 <= len(nodes):
            j, varies = _widest(features, order, a, b, histogram)
            value = _median(features, order, a, b, j, histogram) if varies else -1
            if value >= 0:
                to, kept = a, 0
                for n in range(a, b):
                    if features[order[n], j] <= value:
                        order[to] = order[n]
                        to += 1
                    else:
                        spare[kept] = order[n]
                        kept += 1
                copy_row(order[to:b], spare)
                nodes[at, 2], nodes[at, 3] = count, count + 1
                nodes[count, 0], nodes[count, 1] = a, to
                nodes[count + 1, 0], nodes[count + 1, 1] = to, b
                count += 2
        at += 1
    return count


@inline
def least_between(wanted, low, high):
    """Return the least L1 distance from features to any inside a box."""
    total = np.int32(0)
    for j in range(len(wanted)):
        q, a, b = np.int32(wanted[j]), np.int32(low[j]), np.int32(high[j])
        total += max(np.int32(0), max(a - q, q - b))
    return total


@inline
def scan(features, wanted, a, b, sums):
    """Compute the L1 distances of the features of candidates a..b, at most as many as `sums` holds:
    64 lanes at once.
    """
    sums[:] = 0
    for j in range(len(wanted)):
        value, row, total = wanted[j], features[j, a:b], sums[: b - a]
        for n in range(len(row)):
            total[n] += np.uint16(max(row[n], value) - min(row[n], value))


@inline
def _least_along(image, exemplar, site, corner, moves, shape, depth, step, bits, along):
    """Lower along[m] to the distance when site and corner both move by moves[m], where that is a
    corner still.
    """
    for m in range(len(moves)):
        a, b, c = corner[0] + moves[m, 0], corner[1] + moves[m, 1], corner[2] + moves[m, 2]
        if a < 0 or b < 0 or c < 0 or a >= shape[0] or b >= shape[1] or c >= shape[2]:
            continue
        i, j, k = site[0] + moves[m, 0], site[1] + moves[m, 1], site[2] + moves[m, 2]
        d = differing(image, i, j, k, exemplar, a, b, c, depth, step, bits, along[m])
        along[m] = min(along[m], d)


@kernel
def nearest(
    image, exemplar, features, corners, shape, nodes, low, high, sites, wanted, moves, depth, step,
    bits, first, best, source, along, start, stop,
):  # fmt: skip
    """Find the nearest candidates of the sites start..stop, exactly; any that is nearer than `best`
    was where `first`.

    features (F, N) and corners (N,) of the candidates in the order of the tree; sites (S, 3)
    corners in the image with their features `wanted` (S, F); moves (S, M, 3). best, source (S,):
    least number of differing voxels (what it holds already is the bound) and the first candidate
    that has it; along (S, M): over all candidates that have it, the least distance when both move
    by moves[s, m].
    """
    stack = np.empty(128, np.int32)
    sums = np.empty(1024, np.uint16)
    for s in range(start, stop):
        site = sites[s]
        top = 1
        stack[0] = 0
        if first:
            best[s] -= 1
        while top > 0:
            top -= 1
            node = nodes[stack[top]]
            if least_between(wanted[s], low[stack[top]], high[stack[top]]) > best[s]:
                continue
            if node[2]:
                left = least_between(wanted[s], low[node[2]], high[node[2]])
                right = least_between(wanted[s], low[node[3]], high[node[3]])
                # The nearer child is put on top.
                stack[top], stack[top + 1] = (
                    (node[3], node[2]) if left <= right else (node[2], node[3])
                )
                top += 2
                continue
            for a in range(node[0], node[1], len(sums)):
                b = min(a + len(sums), node[1])
                scan(features, wanted[s], a, b, sums)
                for n in range(a, b):
                    if sums[n - a] > best[s]:
                        continue
                    corner = corner_of(corners[n], shape)
                    d = differing(
                        image, site[0], site[1], site[2], exemplar, corner[0], corner[1], corner[2],
                        depth, step, bits, best[s]
                    )  # fmt: skip
                    if d > best[s]:
                        continue
                    if d < best[s] or source[s] < 0:
                        best[s], source[s] = d, corners[n]
                        along[s] = FAR
                    _least_along(
                        image, exemplar, site, corner, moves[s], shape, depth, step, bits, along[s]
                    )
                    if first:
                        top = 0
                        break
                if first and top == 0:
                    break
