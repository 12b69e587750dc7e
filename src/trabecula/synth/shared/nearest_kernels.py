"""Opening the leaves of `nearest` that may hold a nearest neighbour.

float32 only excludes: every comparison leaves room for its rounding, and what passes is compared in
integers.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel

LEAF = 16
"""Candidates of a leaf: one AVX-512 register of float32, two of AVX2."""

_ROUNDING = 2.0**-24


@inline
def _scan(leaf, query, smooth, tiles, index, near, passed, eights, best, distance):
    """Open one leaf: `best` and `distance` (k,) stay sorted by distance, then place; `near`,
    `passed`, `eights` are scratch.
    """
    # lanes are not a constant here: an unrolled loop would not be vectorised
    tile, lanes = tiles[leaf], len(near)
    # What float32 sums up may be wrong by one rounding per term: no candidate that could be nearer
    # is left out.
    farthest = np.float32(np.float64(distance[-1]) * (1 + 4 * (len(tile) + 4) * _ROUNDING))
    near[:] = 0
    for d in range(0, len(tile), 4):
        q0, q1, q2, q3 = smooth[d], smooth[d + 1], smooth[d + 2], smooth[d + 3]
        for j in range(lanes):
            a, b = q0 - np.float32(tile[d, j]), q1 - np.float32(tile[d + 1, j])
            c, e = q2 - np.float32(tile[d + 2, j]), q3 - np.float32(tile[d + 3, j])
            near[j] += (a * a + b * b) + (c * c + e * e)
        # the first components are the longest: most leaves are shut early
        if d % 8 == 4 or d + 4 == len(tile):
            for j in range(lanes):
                passed[j] = near[j] <= farthest
            if eights[0] == 0 and eights[1] == 0:
                return
    for j in range(lanes):
        if not passed[j] or index[leaf, j] < 0:
            continue
        exact = np.int64(0)
        for d in range(len(query)):
            apart = np.int64(query[d]) - np.int64(tile[d, j])
            exact += apart * apart
        _insert(exact, index[leaf, j], best, distance)


@inline
def _insert(exact, place, best, distance):
    at = len(best) - 1
    if exact > distance[at] or (exact == distance[at] and place > best[at]):
        return
    while at > 0 and (
        exact < distance[at - 1] or (exact == distance[at - 1] and place < best[at - 1])
    ):
        distance[at], best[at] = distance[at - 1], best[at - 1]
        at -= 1
    distance[at], best[at] = exact, place


@inline
def _highest(score, highest, where):
    """The best centre of every sixteenth: a maximum that is vectorised."""
    highest[:] = -np.inf
    where[:] = 0
    for first in range(0, len(score) - LEAF + 1, LEAF):
        for j in range(LEAF):
            better = score[first + j] > highest[j]
            highest[j] = score[first + j] if better else highest[j]
            where[j] = first + j if better else where[j]


@kernel
def search_leaves(queries, moved, scores, tiles, index, radius, best, distance):
    """Nearest candidates of a few queries. scores (Q, L) float32: q c - |c|^2 / 2 for every centre
    c; spoiled.

    |q - c| <= reach + radius, with reach the k-th best so far, is tested as 2 score + (reach +
    radius)^2 >= |q|^2, less what rounding may take. First every query opens sixteen near leaves, so
    that its reach is nearly final. Then leaf after leaf is opened for all queries that need it,
    while it is in the cache.
    """
    near, passed = np.empty(LEAF, np.float32), np.empty(LEAF, np.bool_)
    highest, where = np.empty(LEAF, np.float32), np.empty(LEAF, np.int32)
    smooth = np.zeros((len(queries), tiles.shape[1]), np.float32)
    lowest = np.empty(len(queries), np.float32)
    count, widest = len(radius), np.float64(radius.max())
    opened = np.zeros((len(queries), -(-count // 8) * 8), np.bool_)
    eights, together = passed.view(np.uint64), opened.view(np.uint64)
    for q in range(len(queries)):
        score = scores[q]
        best[q], distance[q] = 2**31 - 1, 2**62
        square = np.float64(0)
        for d in range(moved.shape[1]):
            smooth[q, d] = queries[q, d]
            square += np.float64(moved[q, d]) ** 2
        _highest(score, highest, where)
        for j in range(LEAF):
            if score[where[j]] > -np.inf:
                _scan(
                    where[j],
                    queries[q],
                    smooth[q],
                    tiles,
                    index,
                    near,
                    passed,
                    eights,
                    best[q],
                    distance[q],
                )
                score[where[j]] = -np.inf
        reach = np.sqrt(np.float64(distance[q, -1]))
        slack = 8 * (moved.shape[1] + 8) * _ROUNDING * (square + (reach + widest) ** 2)
        lowest[q] = np.float32(square - slack)
        _open(score, radius, np.float32(reach), lowest[q], opened[q])
    for eight in range(together.shape[1]):
        for q in range(len(queries)):
            if together[q, eight] == 0:
                continue
            for leaf in range(8 * eight, min(8 * eight + 8, count)):
                far = np.float32(np.sqrt(np.float64(distance[q, -1]))) + radius[leaf]
                if opened[q, leaf] and np.float32(2) * scores[q, leaf] + far * far >= lowest[q]:
                    _scan(
                        leaf,
                        queries[q],
                        smooth[q],
                        tiles,
                        index,
                        near,
                        passed,
                        eights,
                        best[q],
                        distance[q],
                    )


@inline
def _open(score, radius, reach, lowest, opened):
    for leaf in range(len(score)):
        far = reach + radius[leaf]
        opened[leaf] = np.float32(2) * score[leaf] + far * far >= lowest
