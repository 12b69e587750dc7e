"""Union-find inside kernels: the root of a tree is its smallest member, so that numbering does not
depend on the order in which pairs are joined."""

from __future__ import annotations

from trabecula.engine.compile import inline


@inline
def root_of(parent, k):
    """The root of k's tree; halves the way to it."""
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@inline
def join(parent, i, j):
    """i and j belong together from now on."""
    i, j = root_of(parent, i), root_of(parent, j)
    parent[max(i, j)] = min(i, j)
