"""Kernels of triple-phase lines: the voxel edges where three phases meet, and the chords of their
chains.

A vertex (z, y, x) is the low corner of that voxel, and an edge is named by the vertex that it
leaves and its axis d. Sets of phases are whole numbers whose bits are labels; `wanted` is the set
of the three phases.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel

REACH = 2
"""Edges on either side of an edge that its chord reaches over."""


@inline
def _around(labels, d, z, y, x):
    """Return the labels around the edge that leaves vertex (z, y, x) along axis d, as bits; the
    vertex is a voxel's corner.
    """
    if d == 0:
        first, second = labels[z, y - 1, x - 1], labels[z, y - 1, x]
        third, last = labels[z, y, x - 1], labels[z, y, x]
    elif d == 1:
        first, second = labels[z - 1, y, x - 1], labels[z - 1, y, x]
        third, last = labels[z, y, x - 1], labels[z, y, x]
    else:
        first, second = labels[z - 1, y - 1, x], labels[z - 1, y, x]
        third, last = labels[z, y - 1, x], labels[z, y, x]
    return (
        (1 << np.int64(first))
        | (1 << np.int64(second))
        | (1 << np.int64(third))
        | (1 << np.int64(last))
    )


@inline
def _spanning_around(labels, spans, d, z, y, x):
    """Return, as `_around`, the labels of voxels in `spans` alone."""
    found = np.int64(0)
    for i in range(2):
        for j in range(2):
            at_z = z - (i if d > 0 else 0)
            at_y = y - (i if d == 0 else j if d == 2 else 0)
            at_x = x - (j if d < 2 else 0)
            if spans[at_z, at_y, at_x]:
                found |= 1 << np.int64(labels[at_z, at_y, at_x])
    return found


@inline
def _has_edge(d, z, y, x):
    """Return whether four voxels share the edge that leaves a vertex along axis d."""
    return (d == 0 or z > 0) and (d == 1 or y > 0) and (d == 2 or x > 0)


@kernel
def mark_sets(labels, seen, start, stop):
    """Mark in `seen` the sets of labels around the edges that leave vertices of planes
    start..stop.
    """
    _, height, width = labels.shape
    for z in range(start, stop):
        for y in range(height):
            for x in range(width):
                for d in range(3):
                    if _has_edge(d, z, y, x):
                        seen[_around(labels, d, z, y, x)] = True


@kernel
def find_edges(labels, wanted, edges, start, stop):
    """Set bit d of edges[z, y, x] where the three phases meet at the edge that leaves vertex (z, y,
    x) along axis d.
    """
    _, height, width = labels.shape
    for z in range(start, stop):
        for y in range(height):
            # Where there is no row below or before, any row does: no edge is looked at there.
            here, before = labels[z, y], labels[z, max(y - 1, 0)]
            below, across = labels[max(z - 1, 0), y], labels[max(z - 1, 0), max(y - 1, 0)]
            last = np.int64(0)
            for x in range(width):
                column = 1 << np.int64(here[x]) | 1 << np.int64(before[x])
                column |= 1 << np.int64(below[x]) | 1 << np.int64(across[x])
                found = 0
                if (column | last) & wanted == wanted:
                    for d in range(3):
                        if _has_edge(d, z, y, x) and _around(labels, d, z, y, x) & wanted == wanted:
                            found |= 1 << d
                edges[z, y, x] = found
                last = column


@inline
def _leaves(edges, way, z, y, x):
    """Return whether an edge leaves a vertex: ways 0, 1, 2 go up along z, y, x, ways 3, 4, 5
    down.
    """
    if way >= 3:
        z, y, x = z - (way == 3), y - (way == 4), x - (way == 5)
    depth, height, width = edges.shape
    if z < 0 or y < 0 or x < 0 or z >= depth or y >= height or x >= width:
        return False
    return (edges[z, y, x] >> (way % 3)) & 1 == 1


@inline
def _follow(edges, way, z, y, x, steps):
    """Follow a chain that arrived at a vertex by `way`, to where it ends or branches; returns the
    last vertex, and the edges taken."""
    taken = 0
    while taken < steps:
        leaving, onward = 0, -1
        for other in range(6):
            if _leaves(edges, other, z, y, x):
                leaving += 1
                if other != (way + 3) % 6:
                    onward = other
        if leaving != 2:
            break
        step = 1 if onward < 3 else -1
        z, y, x = (
            z + step * (onward % 3 == 0),
            y + step * (onward % 3 == 1),
            x + step * (onward % 3 == 2),
        )
        way = onward
        taken += 1
    return z, y, x, taken


@kernel
def add_chords(labels, spans, edges, spacing, wanted, lengths, start, stop):
    """Add the length of every edge's chord to lengths[z, d, 0], and to [z, d, 1] where the edge is
    active.
    """
    _, height, width = labels.shape
    for z in range(start, stop):
        for y in range(height):
            for x in range(width):
                for d in range(3):
                    if not (edges[z, y, x] >> d) & 1:
                        continue
                    up_z, up_y, up_x, ahead = _follow(
                        edges, d, z + (d == 0), y + (d == 1), x + (d == 2), REACH
                    )
                    low_z, low_y, low_x, behind = _follow(edges, d + 3, z, y, x, REACH)
                    away = ((up_z - low_z) * spacing[0]) ** 2
                    away += ((up_y - low_y) * spacing[1]) ** 2 + ((up_x - low_x) * spacing[2]) ** 2
                    length = np.sqrt(away) / (ahead + behind + 1)
                    if _around(labels, d, z, y, x) != wanted:
                        length /= 2  # four phases
                    lengths[z, d, 0] += length
                    if _spanning_around(labels, spans, d, z, y, x) & wanted == wanted:
                        lengths[z, d, 1] += length
