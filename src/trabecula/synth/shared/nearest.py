"""Exact k nearest neighbours among a fixed set of feature vectors, and their second ordering by how
often each was chosen.

A leaf is 16 candidates that lie close together, found by halving the set across its widest axis.
Distances to the centres of all leaves come from one float32 matrix product; a leaf is opened where
its centre is not farther than the k-th best so far plus the leaf's radius. In high dimensions a
tree walked node by node opens nearly as many leaves, and pays for the walk.

The float32 products only *exclude*, with a bound on their rounding error, and what remains is
compared in integers. So the result is that of a search in exact arithmetic, whatever the BLAS, the
threads and the order of the leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.engine.parallel import for_slabs, sum_slabs
from trabecula.synth.shared.nearest_kernels import LEAF, search_leaves

_QUERIES = 64  # queries of one matrix product: their products with all centres stay in the cache
_MOST = 1000
_SAMPLES = 4096  # vectors that are looked at together; so many say which axis is the widest
_AT_ONCE = 128  # leaves whose centres are worked out at once


@dataclass(frozen=True)
class NeighbourIndex:
    """Feature vectors prepared for `k_nearest`."""

    # (L, D, LEAF) int16, a leaf's features side by side; D filled with zeros to a multiple of 4
    tiles: np.ndarray
    index: np.ndarray  # (L, LEAF) int32, their place in the caller's array; -1 fills the last leaf
    centres: np.ndarray  # (D + 1, L) float32, and as last row minus half the squared length
    radius: np.ndarray  # (L,) float32, rounded up
    # (D,) float32 of whole numbers: centres are relative to it, so that rounding stays small
    middle: np.ndarray
    k: int  # how many nearest ones may be asked for


def build_index(
    features: np.ndarray, *, k: int = 10, allowed: np.ndarray | None = None
) -> NeighbourIndex:
    """Prepare feature vectors for exact search.

    Parameters
    ----------
    features : (N, D) int16
    k : int
        How many nearest ones will be wanted, 1 .. 1000. Of equal vectors no more than the first k
        are kept, since no later one can be among the nearest k: a phase that saturates has
        thousands of equals.
    allowed : (N,) bool, optional
        Which of them may be found. Default: all.

    Raises
    ------
    InputError
        `features` is not a table of int16, `k` is out of range, `allowed` does not fit or excludes
        everything.
    """
    features = _table(features, "features")
    chosen: np.ndarray = np.arange(len(features))
    if allowed is not None:
        if np.shape(allowed) != (len(features),) or np.asarray(allowed).dtype != bool:
            raise InputError(
                f"allowed is {np.shape(allowed)}: give one truth value for each of {len(features)} candidates"
            )
        chosen = np.flatnonzero(allowed)
    if not len(chosen):
        raise InputError("there is no candidate to choose from: allow at least one")
    k = min(int(as_number(k, name="k", low=1, high=_MOST, whole=True)), len(chosen))
    chosen = _first_of_equals(features, chosen, k)
    leaves = _leaves(features, chosen)
    count, depth = len(leaves), features.shape[1]
    index = np.full((count, LEAF), -1, np.int32)
    for row, leaf in zip(index, leaves, strict=True):
        row[: len(leaf)] = leaf
    tiles = np.zeros((count, -(-depth // 4) * 4, LEAF), np.int16)
    pieces = (chosen[first : first + _SAMPLES] for first in range(0, len(chosen), _SAMPLES))
    sums = sum(features[piece].sum(0, dtype=np.int64) for piece in pieces)
    middle = np.rint(sums / len(chosen)).astype(np.float32)
    centres, radius = np.empty((depth + 1, count), np.float32), np.empty(count, np.float32)
    for first in range(0, count, _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        filled = np.where(index[part] < 0, index[part, :1], index[part])
        tiles[part, :depth] = features[filled].transpose(0, 2, 1)
        points = tiles[part, :depth] - middle[:, None]
        centre = points.mean(2, keepdims=True)
        centres[:depth, part] = centre[:, :, 0].T
        centres[depth, part] = -0.5 * (centre[:, :, 0].astype(np.float64) ** 2).sum(1)
        radius[part] = np.sqrt(((points - centre.astype(np.float64)) ** 2).sum(1).max(1)) * (
            1 + 1e-6
        )
    return NeighbourIndex(tiles, index, centres, radius, middle, k)


def search_bytes(count: int, k: int) -> int:
    """Memory that a search among `count` candidates takes per thread."""
    return _QUERIES * (5 * count // LEAF + 64 * k)


def k_nearest(queries: np.ndarray, among: NeighbourIndex) -> tuple[np.ndarray, np.ndarray]:
    """The k nearest candidates of every query by Euclidean distance, exactly; of equals the one
    that comes first.

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
    queries = _fitting(queries, among)
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
    """Of the k nearest candidates of every query the best by the modified distance, in the caller's
    thread.

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
    queries = _fitting(queries, among)
    match, apart = np.empty(len(queries), np.int32), np.empty(len(queries), np.int64)
    index, distance = (
        np.empty((_QUERIES, among.k), np.int32),
        np.empty((_QUERIES, among.k), np.int64),
    )
    for first in range(0, len(queries), _QUERIES):
        part = slice(first, min(first + _QUERIES, len(queries)))
        near, far = index[: part.stop - first], distance[: part.stop - first]
        _search(queries[part], among, near, far)
        match[part], apart[part] = _best(near, far, factors)
    return match, apart


def _search(
    queries: np.ndarray, among: NeighbourIndex, index: np.ndarray, distance: np.ndarray
) -> None:
    moved = queries - among.middle
    scores = np.column_stack([moved, np.ones(len(moved), np.float32)]) @ among.centres
    search_leaves(queries, moved, scores, among.tiles, among.index, among.radius, index, distance)


def index_histogram(match: np.ndarray, count: int, active: np.ndarray | None = None) -> np.ndarray:
    """H of section 4.2: the share (float64, sum 1) of neighbourhoods that chose each of `count`
    candidates.

    Places below 0 (no neighbourhood there), and where `active` is False, are left out.
    """

    def counted(start: int, stop: int) -> np.ndarray:
        part = match[start:stop]
        there = part >= 0 if active is None else (part >= 0) & active[start:stop]
        return np.bincount(part[there], minlength=count)

    counts = sum_slabs(counted, len(match))
    return np.asarray(counts / max(int(counts.sum()), 1))


def reranked(
    index: np.ndarray,
    distance: np.ndarray,
    histogram: np.ndarray,
    *,
    weight: float = 1.0,
    theta: float | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The best of `k` candidates by the modified distance w_d d, w_d = 1 + weight max(0, H(index) -
    theta).

    H is frozen for the round: every query sees the same one, so their order does not matter. An
    exact match (d = 0) always stays the best.

    Parameters
    ----------
    index, distance : (Q, k) int32, int64
        From `k_nearest`.
    histogram : (N,) float64
        Of the round before, from `index_histogram`.
    weight : float
        0 or more. 1 takes H and theta as the probabilities that the paper calls them; the number of
        queries turns them into counts; `w * N` makes a candidate chosen twice as often as even use
        cost `1 + w`.
    theta : float, optional
        The share that costs nothing. Default: 1 / N, even use of all N.

    Returns
    -------
    match : (Q,) int32
    distance : (Q,) int64
        Unmodified.

    References
    ----------
    Zhang, Chen, Wang, Wang (2017), Computer Aided Geometric Design, section 4.2; Chen and Wang
    (2010), doi:10.1007/s00371-009-0408-3.
    """
    return _best(index, distance, usage_factors(histogram, weight=weight, theta=theta))


def usage_factors(
    histogram: np.ndarray, *, weight: float = 1.0, theta: float | None = None
) -> np.ndarray:
    """w_d of every candidate, as `reranked` tells."""
    excess = np.maximum(histogram - (1 / len(histogram) if theta is None else theta), 0)
    return np.asarray(1 + weight * excess)


def _best(
    index: np.ndarray, distance: np.ndarray, factors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    best = np.argmin(distance * factors[index], axis=1)[:, None]
    return np.take_along_axis(index, best, 1)[:, 0], np.take_along_axis(distance, best, 1)[:, 0]


def _fitting(queries: np.ndarray, among: NeighbourIndex) -> np.ndarray:
    queries = _table(queries, "queries")
    if queries.shape[1] != len(among.middle):
        raise InputError(
            f"queries have {queries.shape[1]} components, the candidates {len(among.middle)}: use one basis"
        )
    return queries


def _table(features: np.ndarray, name: str) -> np.ndarray:
    features = np.asarray(features)
    if features.ndim != 2 or features.dtype != np.int16 or 0 in features.shape[1:]:
        raise InputError(
            f"{name} are {features.dtype} of shape {features.shape}: give a table (n, D) of int16"
        )
    return np.ascontiguousarray(features)


def _first_of_equals(features: np.ndarray, chosen: np.ndarray, k: int) -> np.ndarray:
    """Those of `chosen` (rising) that have fewer than k equals before them.

    Rows are sorted by a hash; rows that share a hash but differ from the first with it are kept.
    """
    factors = np.arange(1, 2 * features.shape[1], 2, dtype=np.uint64) * np.uint64(
        0x9E3779B97F4A7C15
    )
    marks = np.zeros(len(chosen), np.uint64)
    for column, factor in zip(features.T, factors, strict=True):
        marks = (marks ^ (column[chosen].astype(np.int64).view(np.uint64) * factor)) * np.uint64(
            0xD6E8FEB86659FD93
        )
        marks ^= marks >> np.uint64(32)
    order = np.argsort(marks, kind="stable")
    fresh = np.ones(len(order), bool)
    fresh[1:] = marks[order[1:]] != marks[order[:-1]]
    first = np.flatnonzero(fresh)[np.cumsum(fresh) - 1]
    late = np.flatnonzero(np.arange(len(order)) - first >= k)
    equal = (features[chosen[order[late]]] == features[chosen[order[first[late]]]]).all(1)
    return np.delete(chosen, order[late[equal]])


def _leaves(features: np.ndarray, chosen: np.ndarray) -> list[np.ndarray]:
    """Groups of LEAF places (the last smaller): halved across the axis of largest variance, again
    and again.
    """
    leaves, stack = [], [chosen]
    while stack:
        group = stack.pop()
        if len(group) <= LEAF:
            leaves.append(group)
            continue
        sample = features[group[:: -(-len(group) // _SAMPLES)]]
        along = features[group, sample.astype(np.float32).var(0).argmax()]
        half = -(-(len(group) // 2) // LEAF) * LEAF
        order = np.argpartition(along, half)
        stack += [group[order[half:]], group[order[:half]]]
    return leaves
