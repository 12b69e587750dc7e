"""The map of sources and its pieces: plain functions on arrays. Glossary in `kernels`."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.measure.copying.kernels import FAR, differing, least_between, row_of, scan
from trabecula.measure.union_find import join, root_of

_SIDES = ((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1))


@inline
def _descended(wanted, nodes, low, high):
    """The leaf that features lead to, by the nearer child of every node."""
    at = 0
    while nodes[at, 2]:
        left, right = nodes[at, 2], nodes[at, 3]
        nearer = least_between(wanted, low[left], high[left]) <= least_between(
            wanted, low[right], high[right]
        )
        at = left if nearer else right
    return at


@kernel
def start_sources(
    image, exemplar, features, corners, shape, nodes, low, high, blocks, offsets, counts, depth, step, bits,
    source, distance, start, stop,
):  # fmt: skip
    """The nearest candidate of one leaf of the tree, for sites that count in planes start..stop:
    exact for a true copy.
    """
    wanted = np.empty(len(offsets), np.uint8)
    sums = np.empty(1024, np.uint16)
    for z in range(start, stop):
        for y in range(counts.shape[1]):
            for x in range(counts.shape[2]):
                source[z, y, x], distance[z, y, x] = -1, FAR
                if not counts[z, y, x]:
                    continue
                for j in range(len(offsets)):
                    wanted[j] = blocks[z + offsets[j, 0], y + offsets[j, 1], x + offsets[j, 2]]
                node = nodes[_descended(wanted, nodes, low, high)]
                best = FAR
                b = min(node[0] + len(sums), node[1])
                scan(features, wanted, node[0], b, sums)
                for n in range(node[0], b):
                    if sums[n - node[0]] >= best:
                        continue
                    u, v, w = row_of(corners[n], shape)
                    d = differing(image, z, y, x, exemplar, u, v, w, depth, step, bits, best)
                    if d < best:
                        best, source[z, y, x] = d, corners[n]
                distance[z, y, x] = best


@kernel
def pass_sources(
    image, exemplar, shape, old, far, depth, step, bits, source, distance, start, stop
):
    """One sweep: the six neighbours' sources, moved along, are tried; of equal ones that of more
    neighbours wins.

    old, far: sources and distances before; source, distance: after, in planes start..stop (Jacobi).
    """
    tried = np.empty(6, np.int64)
    for z in range(start, stop):
        for y in range(old.shape[1]):
            for x in range(old.shape[2]):
                own, best = np.int64(old[z, y, x]), far[z, y, x]
                source[z, y, x], distance[z, y, x] = own, best
                if own < 0:
                    continue
                support = 0
                for side in range(6):
                    dz, dy, dx = _SIDES[side]
                    tried[side] = -1
                    i, j, k = z + dz, y + dy, x + dx
                    if (
                        i < 0
                        or j < 0
                        or k < 0
                        or i >= old.shape[0]
                        or j >= old.shape[1]
                        or k >= old.shape[2]
                    ):
                        continue
                    near = np.int64(old[i, j, k])
                    if near < 0:
                        continue
                    u, v, w = row_of(near, shape)
                    u, v, w = u - dz, v - dy, w - dx
                    if (
                        u >= 0
                        and v >= 0
                        and w >= 0
                        and u < shape[0]
                        and v < shape[1]
                        and w < shape[2]
                    ):
                        tried[side] = (u * shape[1] + v) * shape[2] + w
                        support += tried[side] == own
                for side in range(6):
                    if tried[side] < 0 or tried[side] == own:
                        continue
                    agree, first = 0, side
                    for other in range(6):
                        if tried[other] == tried[side]:
                            agree, first = agree + 1, min(first, other)
                    if first < side:
                        continue
                    u, v, w = row_of(tried[side], shape)
                    d = differing(image, z, y, x, exemplar, u, v, w, depth, step, bits, best)
                    if d < best or (d == best and agree > support):
                        own, best, support = tried[side], d, agree
                source[z, y, x], distance[z, y, x] = own, best


@kernel
def join_equal(keys, parent):
    """Union of 6-neighbours with the same key, none of it negative; parent (Z * Y * X,) int64 holds
    0, 1, 2, ... at first.
    """
    Z, Y, X = keys.shape
    for z in range(Z):
        for y in range(Y):
            for x in range(X):
                if keys[z, y, x] < 0:
                    continue
                n = (z * Y + y) * X + x
                for axis in range(3):
                    i, j, k = z - (axis == 0), y - (axis == 1), x - (axis == 2)
                    if i >= 0 and j >= 0 and k >= 0 and keys[i, j, k] == keys[z, y, x]:
                        join(parent, n, (i * Y + j) * X + k)
    for n in range(len(parent)):
        parent[n] = root_of(parent, n)
