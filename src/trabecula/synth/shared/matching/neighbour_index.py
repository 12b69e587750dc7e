"""An index of feature vectors for exact search.

A leaf is 16 candidates close together, found by halving the set across its widest axis; a bough is
32 leaves that follow one another. In high dimensions a tree walked node by node opens nearly as
many leaves, and pays for the walk.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError

LEAF = 16
"""Candidates of a leaf: one AVX-512 register of float32, two of AVX2."""

BOUGH = 32
"""Leaves of a bough: about the square root of the leaves of half a million candidates, halved."""

_MOST = 1000
_SAMPLES = 4096  # vectors that are looked at together; so many say which axis is the widest


@dataclass(frozen=True)
class NeighbourIndex:
    """Feature vectors prepared for `k_nearest`."""

    # (L, D, LEAF) int16, a leaf's features side by side; D filled with zeros to a multiple of 4
    tiles: np.ndarray
    index: np.ndarray  # (L, LEAF) int32, their place in the caller's array; -1 fills the last leaf
    # (B, D + 1, BOUGH) float32, and as last row minus half the squared length: -inf for no leaf
    centres: np.ndarray
    radius: np.ndarray  # (B, BOUGH) float32, rounded up
    boughs: np.ndarray  # (D + 1, B) float32, as the centres of leaves
    reaches: np.ndarray  # (B,) float32, the radius of a bough, rounded up
    # (D,) float32 of whole numbers: centres are relative to it, so that rounding stays small
    middle: np.ndarray
    k: int  # nearest ones that a search returns, at most


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
    features = as_feature_table(features, "features")
    chosen: np.ndarray = np.arange(len(features))
    if allowed is not None:
        if np.shape(allowed) != (len(features),) or np.asarray(allowed).dtype != bool:
            raise InputError(
                f"allowed is {np.shape(allowed)}: give one truth value for each of "
                f"{len(features)} candidates"
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
    groups = -(-count // BOUGH)
    centres = np.zeros((groups * BOUGH, depth + 1), np.float32)
    centres[count:, depth] = -np.inf
    radius = np.zeros(groups * BOUGH, np.float32)
    boughs, reaches = np.empty((depth + 1, groups), np.float32), np.empty(groups, np.float32)
    for group in range(groups):
        part = slice(group * BOUGH, min(group * BOUGH + BOUGH, count))
        filled = np.where(index[part] < 0, index[part, :1], index[part])
        tiles[part, :depth] = features[filled].transpose(0, 2, 1)
        points = tiles[part, :depth] - middle[:, None]
        centres[part], radius[part] = _balls(points)
        boughs[:, group : group + 1], reaches[group : group + 1] = (
            ball.T for ball in _balls(points.transpose(1, 0, 2).reshape(1, depth, -1))
        )
    centres = centres.reshape(groups, BOUGH, depth + 1).transpose(0, 2, 1)
    return NeighbourIndex(
        tiles,
        index,
        np.ascontiguousarray(centres),
        radius.reshape(groups, BOUGH),
        boughs,
        reaches,
        middle,
        k,
    )


def _balls(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, D + 1) centres of n sets of points (n, D, m), each with minus half its squared
    length, and their radii, rounded up.
    """
    centre = points.mean(2, dtype=np.float32)
    halves = -0.5 * (centre.astype(np.float64) ** 2).sum(1, keepdims=True)
    apart = points - centre[:, :, None].astype(np.float64)
    radius = np.sqrt((apart**2).sum(1).max(1)) * (1 + 1e-6)
    # float32 rounds half of the radii down, by less than the factor above
    return np.concatenate([centre, halves.astype(np.float32)], 1), radius.astype(np.float32)


def as_feature_table(features: np.ndarray, name: str) -> np.ndarray:
    """Check a table of features, and return it contiguous."""
    features = np.asarray(features)
    if features.ndim != 2 or features.dtype != np.int16 or 0 in features.shape[1:]:
        raise InputError(
            f"{name} are {features.dtype} of shape {features.shape}: give a table (n, D) of int16"
        )
    return np.ascontiguousarray(features)


def _first_of_equals(features: np.ndarray, chosen: np.ndarray, k: int) -> np.ndarray:
    """Select those of `chosen` (rising) that have fewer than k equals before them.

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
    """Split the candidates into groups of LEAF places (the last smaller): halved across the axis of
    largest variance, again and again.
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
