"""Union-find inside kernels: the root of a tree is its smallest member, so that numbering does not
depend on the order in which pairs are joined.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline


@inline
def root_of(parent, k):
    """Return the root of k's tree; halve the path to it."""
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@inline
def join(parent, i, j):
    """Unite the trees of i and j."""
    i, j = root_of(parent, i), root_of(parent, j)
    parent[max(i, j)] = min(i, j)


@inline
def number_trees(parent):
    """Label the trees by their first member: the number of every member, and the count."""
    number = np.empty(len(parent), np.int64)
    count = 0
    for k in range(len(parent)):
        root = root_of(parent, k)
        if root == k:
            number[k] = count
            count += 1
        else:
            number[k] = number[root]
    return number, count
