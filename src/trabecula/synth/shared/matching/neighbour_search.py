"""Exact k nearest neighbours in an index of feature vectors, and their second ordering by the index
histogram.

Distances to the centres of all boughs come from one float32 matrix product; a bough, and then a
leaf of it, is opened where its centre is not farther than the k-th best so far plus its radius. The
float32 products only *exclude*, with a bound on their rounding error, and what remains is compared
in integers. So the result is that of a search in exact arithmetic, whatever the BLAS, the threads
and the order of the leaves.
"""

from __future__ import annotations

import numpy as np

from trabecula.core.errors import InputError
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs, sum_slabs
from trabecula.synth.shared.matching.neighbour_index import (
    BOUGH,
    LEAF,
    NeighbourIndex,
    as_feature_table,
)

_QUERIES = 64  # queries of one matrix product: their products with all centres stay in the cache
_FIRST = 3  # boughs that every query opens before it is known how far it has to look
_ROUNDING = 2.0**-24


def neighbour_bytes(count: int, k: int) -> int:
    """Forecast the memory of a search among `count` candidates, per thread."""
    return _QUERIES * (5 * count // (LEAF * BOUGH) + 64 * k)


def k_nearest(queries: np.ndarray, among: NeighbourIndex) -> tuple[np.ndarray, np.ndarray]:
    """Find the k nearest candidates of every query by Euclidean distance, exactly; of equals the
    one that comes first.

    Parameters
    ----------
    queries : (Q, D) int16
    among : Candidates

    Returns
    -------
    index : (Q, k) int32
        Places in the array that `build_index` was given, nearest first; k as given there, or all
        where there are fewer.
    distance : (Q, k) int64
        Squared distances.

    Raises
    ------
    InputError
        The queries are not int16 vectors of the candidates' length.

    Examples
    --------
    >>> import numpy as np
    >>> points = np.array([[0, 0], [3, 4], [1, 0], [3, 4]], np.int16)
    >>> index, distance = k_nearest(np.array([[3, 3]], np.int16), candidates(points, k=3))
    >>> index.tolist(), distance.tolist()
    ([[1, 3, 2]], [[1, 1, 13]])
    """
    queries = _check_queries(queries, among)
    index = np.empty((len(queries), among.k), np.int32)
    distance = np.empty((len(queries), among.k), np.int64)

    def work(start: int, stop: int) -> None:
        for first in range(start, stop, _QUERIES):
            part = slice(first, min(first + _QUERIES, stop))
            _search(queries[part], among, index[part], distance[part])

    for_slabs(work, len(queries), least=_QUERIES)
    return index, distance


def best_among(
    queries: np.ndarray, among: NeighbourIndex, factors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Find the best of the k nearest candidates of every query by the modified distance, in the
    caller's thread.

    Parameters
    ----------
    queries : (Q, D) int16
    among : Candidates
    factors : (N,) float64
        From `usage_factors`.

    Returns
    -------
    match : (Q,) int32
    distance : (Q,) int64
        Unmodified, squared.
    """
    queries = _check_queries(queries, among)
    match, apart = np.empty(len(queries), np.int32), np.empty(len(queries), np.int64)
    index, distance = (
        np.empty((_QUERIES, among.k), np.int32),
        np.empty((_QUERIES, among.k), np.int64),
    )
    for first in range(0, len(queries), _QUERIES):
        part = slice(first, min(first + _QUERIES, len(queries)))
        near, far = index[: part.stop - first], distance[: part.stop - first]
        _search(queries[part], among, near, far)
        match[part], apart[part] = rerank(near, far, factors)
    return match, apart


def _search(
    queries: np.ndarray, among: NeighbourIndex, index: np.ndarray, distance: np.ndarray
) -> None:
    moved = queries - among.middle
    scores = np.column_stack([moved, np.ones(len(moved), np.float32)]) @ among.boughs
    leaves = (among.tiles, among.index, among.centres, among.radius)
    search_leaves(queries, moved, scores, leaves, among.reaches, index, distance)


def index_histogram(match: np.ndarray, count: int, active: np.ndarray | None = None) -> np.ndarray:
    """Return H of section 4.2: the share (float64, sum 1) of neighbourhoods that chose each of
    `count` candidates.

    Places below 0 (no neighbourhood there), and where `active` is False, are left out.
    """

    def tally(start: int, stop: int) -> np.ndarray:
        part = match[start:stop]
        there = part >= 0 if active is None else (part >= 0) & active[start:stop]
        return np.bincount(part[there], minlength=count)

    counts = sum_slabs(tally, len(match))
    return np.asarray(counts / max(int(counts.sum()), 1))


def rerank(
    index: np.ndarray, distance: np.ndarray, factors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Choose the best of `k` candidates by the modified distance w_d d.

    An exact match (d = 0) always stays the best.

    Parameters
    ----------
    index, distance : (Q, k) int32, int64
        From `k_nearest`.
    factors : (N,) float64
        w_d, from `usage_factors`.

    Returns
    -------
    match : (Q,) int32
    distance : (Q,) int64
        Unmodified.
    """
    best = np.argmin(distance * factors[index], axis=1)[:, None]
    return np.take_along_axis(index, best, 1)[:, 0], np.take_along_axis(distance, best, 1)[:, 0]


def usage_factors(
    histogram: np.ndarray, *, weight: float = 1.0, theta: float | None = None
) -> np.ndarray:
    """Return w_d = 1 + weight max(0, H(index) - theta) of every candidate.

    H is frozen for the round: every query uses the same one, so their order does not matter.

    Parameters
    ----------
    histogram : (N,) float64
        H of the round before, from `index_histogram`.
    weight : float
        0 or more. 1 takes H and theta as the probabilities that the paper calls them; the number of
        queries turns them into counts; `w * N` makes a candidate chosen twice as often as even use
        cost `1 + w`.
    theta : float, optional
        The share that costs nothing. Default: 1 / N, even use of all N.

    References
    ----------
    Zhang, Chen, Wang, Wang (2017), Computer Aided Geometric Design, section 4.2; Chen and Wang
    (2010), doi:10.1007/s00371-009-0408-3.
    """
    excess = np.maximum(histogram - (1 / len(histogram) if theta is None else theta), 0)
    return np.asarray(1 + weight * excess)


def _check_queries(queries: np.ndarray, among: NeighbourIndex) -> np.ndarray:
    queries = as_feature_table(queries, "queries")
    if queries.shape[1] != len(among.middle):
        raise InputError(
            f"queries have {queries.shape[1]} components, the candidates {len(among.middle)}: "
            "use one basis"
        )
    return queries


@inline
def _scan(leaf, query, smooth, tiles, index, near, passed, eights, best, distance):
    """Open one leaf: `best` and `distance` (k,) stay sorted by distance, then place; `near`,
    `passed`, `eights` are scratch.
    """
    # lanes are not a constant here: an unrolled loop would not be vectorised
    tile, lanes = tiles[leaf], len(near)
    # A float32 sum may be wrong by one rounding per term: no candidate that could be nearer
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
    """Find the best centre of every sixteenth: a maximum that is vectorised."""
    highest[:] = -np.inf
    where[:] = 0
    for first in range(0, len(score), LEAF):
        for j in range(min(LEAF, len(score) - first)):
            better = score[first + j] > highest[j]
            highest[j] = score[first + j] if better else highest[j]
            where[j] = first + j if better else where[j]


@kernel
def search_leaves(queries, moved, scores, leaves, reaches, best, distance):
    """Search the nearest candidates of a few queries. scores (Q, B) float32: q c - |c|^2 / 2 for
    every bough's centre c; spoiled.

    |q - c| <= reach + radius, with reach the k-th best so far, is tested as 2 score + (reach +
    radius)^2 >= |q|^2, less what rounding may take. First every query opens a few near boughs, so
    that its reach is nearly final. Then bough after bough is opened for all queries that need it,
    while it is in the cache.
    """
    tiles, index, centres, radius = leaves
    near, passed = np.empty(LEAF, np.float32), np.empty(LEAF, np.bool_)
    highest, where = np.empty(LEAF, np.float32), np.empty(LEAF, np.int32)
    lanes = np.empty(BOUGH, np.float32)
    smooth = np.zeros((len(queries), tiles.shape[1]), np.float32)
    lowest = np.empty(len(queries), np.float32)
    count, widest = len(reaches), np.float64(reaches.max())
    opened = np.zeros((len(queries), -(-count // 8) * 8), np.bool_)
    eights, together = passed.view(np.uint64), opened.view(np.uint64)
    opening, scratch = (tiles, index, radius), (near, passed, eights, lanes)
    for q in range(len(queries)):
        query, found = (queries[q], smooth[q]), (best[q], distance[q])
        score = scores[q]
        best[q], distance[q] = 2**31 - 1, 2**62
        square = np.float64(0)
        for d in range(moved.shape[1]):
            smooth[q, d] = queries[q, d]
            square += np.float64(moved[q, d]) ** 2
        _highest(score, highest, where)
        lowest[q] = -np.inf
        for _ in range(min(_FIRST, count)):
            lane = highest.argmax()
            bough = where[lane]
            if highest[lane] == -np.inf:
                break
            leaf = _score_leaves(bough, moved[q], centres, lanes)
            _scan(bough * BOUGH + leaf, *query, tiles, index, near, passed, eights, *found)
            lanes[leaf] = -np.inf
            lowest[q] = _lowest(square, distance[q, -1], widest, moved.shape[1])
            _open_leaves(bough, query, opening, lowest[q], found, scratch)
            highest[lane] = score[bough] = -np.inf
        reach = np.float32(np.sqrt(np.float64(distance[q, -1])))
        lowest[q] = _lowest(square, distance[q, -1], widest, moved.shape[1])
        _open(score, reaches, reach, lowest[q], opened[q])
    for eight in range(together.shape[1]):
        for q in range(len(queries)):
            if together[q, eight] == 0:
                continue
            query, found = (queries[q], smooth[q]), (best[q], distance[q])
            for bough in range(8 * eight, min(8 * eight + 8, count)):
                far = np.float32(np.sqrt(np.float64(distance[q, -1]))) + reaches[bough]
                if opened[q, bough] and np.float32(2) * scores[q, bough] + far * far >= lowest[q]:
                    _score_leaves(bough, moved[q], centres, lanes)
                    _open_leaves(bough, query, opening, lowest[q], found, scratch)


@inline
def _lowest(square, farthest, widest, depth):
    """Compute |q|^2 less what rounding may take from a test within the k-th best so far."""
    reach = np.sqrt(np.float64(farthest)) + widest
    return np.float32(square - 8 * (depth + 8) * _ROUNDING * (square + reach * reach))


@inline
def _score_leaves(bough, moved, centres, lanes):
    """Write q c - |c|^2 / 2 of the leaves of a bough; return the place of the highest."""
    tile = centres[bough]
    depth, count = len(moved), len(lanes)
    for j in range(count):
        lanes[j] = tile[depth, j]
    for d in range(depth):
        factor = moved[d]
        for j in range(count):
            lanes[j] += factor * tile[d, j]
    return lanes.argmax()


@inline
def _open_leaves(bough, query, leaves, lowest, found, scratch):
    """Open the leaves of a bough that may hold one of the nearest.

    The tuples are taken apart before the loop: inside it, and in `_scan`, they cost a quarter of
    the time.
    """
    (values, smooth), (tiles, index, radius) = query, leaves
    (near, passed, eights, lanes), (best, distance) = scratch, found
    for j in range(len(lanes)):
        far = np.float32(np.sqrt(np.float64(distance[-1]))) + radius[bough, j]
        if np.float32(2) * lanes[j] + far * far >= lowest:
            leaf = bough * BOUGH + j
            _scan(leaf, values, smooth, tiles, index, near, passed, eights, best, distance)


@inline
def _open(score, radius, reach, lowest, opened):
    for leaf in range(len(score)):
        far = reach + radius[leaf]
        opened[leaf] = np.float32(2) * score[leaf] + far * far >= lowest
