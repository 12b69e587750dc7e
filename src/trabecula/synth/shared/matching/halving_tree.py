"""A tree that halves the candidates by one feature after another: where a neighbourhood would be in
it are a few candidates that are likely to be near.

The nearest one may be in another leaf, so this is no exact search. The coherent search knows but
the matches of neighbours and random ones, and stays with what it once found; a leaf says every
round anew what there is for a field that has changed meanwhile. He and Sun ("Computing
nearest-neighbor fields via propagation-assisted kd-trees", CVPR 2012) put both together.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import inline

_LEAF = 16  # candidates of a leaf, at least, where there are as many
_SAMPLES = 256  # candidates of a branch that tell its widest feature


class HalvingTree(NamedTuple):
    """Branches in the order of a heap, the root first, and the candidates leaf by leaf.

    Attributes
    ----------
    axes, cuts : (2^depth - 1,) int32 and int16
        Of every branch the feature that is looked at, and the least value that leads right.
    starts : (2^depth + 1,) int64
        Where every leaf begins in `order`.
    order : (n,) int32
        Numbers of candidates.
    """

    axes: np.ndarray
    cuts: np.ndarray
    starts: np.ndarray
    order: np.ndarray


def build_tree(features: np.ndarray, numbers: np.ndarray) -> HalvingTree:
    """Halve the candidates `numbers` (n,) of features (N, D) int16 until a leaf holds 16 to 32."""
    depth = max(0, (len(numbers) // _LEAF).bit_length() - 1)
    parts, axes, cuts = [numbers.astype(np.int32)], [], []
    for _ in range(depth):
        halves = []
        for part in parts:
            axis = _widest_axis(features[part[:: -(-len(part) // _SAMPLES)]])
            values = features[part, axis]
            half = len(part) // 2
            cut = np.partition(values, half)[half]
            left = values < cut
            # equals of the cut are on both sides: which of them, no library decides
            left[np.flatnonzero(values == cut)[: half - np.count_nonzero(left)]] = True
            axes.append(axis)
            cuts.append(cut)
            halves += [part[left], part[~left]]
        parts = halves
    return HalvingTree(
        np.array(axes, np.int32),
        np.array(cuts, np.int16),
        np.cumsum([0, *map(len, parts)]).astype(np.int64),
        np.concatenate(parts),
    )


def _widest_axis(features: np.ndarray) -> int:
    """Return the feature of the largest variance, in integers."""
    values = features.astype(np.int64)
    spread = len(values) * (values**2).sum(0) - values.sum(0) ** 2
    return int(spread.argmax())


@inline
def find_leaf(features, place, axes, cuts):
    """Return the leaf where the site at (z, y, x) of the features would be."""
    z, y, x = place
    branch = 0
    while branch < len(axes):
        right = features[z, y, x, axes[branch]] >= cuts[branch]
        branch = 2 * branch + (2 if right else 1)
    return branch - len(axes)
