"""The seam: a minimum cut through what is made and what is laid over it (section 3.3, step 3).

Voxels of the overlap are the nodes. With m(p) = 1 where old and new differ at p, parting neighbours
p and q costs m(p) + m(q) (Kwatra et al. 2003, doi:10.1145/882262.882264, equation 1, for labels); a
neighbour that only the old or only the new has differs as p does. The cut is exact: Dinic's
algorithm (blocking flows along shortest ways) on whole numbers. Of all minimum cuts the one is
taken that keeps least of the old, so that the new piece comes out as it is, unless that tears what
hangs together.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.synth.quilt.voxel_codes import EMPTY, FIXED, OUT

_HELD = 1 << 28  # more than any cut


LEAST, MOST, ALL = 0, 1, 2
"""How much of the old a seam keeps: of all minimum cuts the least, or the most; or all of it,
without a cut.
"""


def seamed(
    window: np.ndarray, margin: tuple[int, ...], piece: np.ndarray, *, keep: int = LEAST
) -> tuple[np.ndarray, int]:
    """A window with a piece laid into its box, cut out along the cheapest seam.

    Parameters
    ----------
    window : (z, y, x) uint8
        Labels, EMPTY, OUT; labels of measured voxels have FIXED added and stay.
    margin : three ints
        Voxels around the box.
    piece : uint8, the box's shape
        Labels.
    keep : {LEAST, MOST, ALL}

    Returns
    -------
    made : uint8, the window's shape
    cost : int
        Of the cut; -1 without one.
    """
    made = window.copy()
    if keep == ALL:
        box = made[tuple(slice(m, side - m) for m, side in zip(margin, made.shape, strict=True))]
        np.copyto(box, piece, where=box == EMPTY)
        return made, -1
    count = piece.size
    to_sink = np.zeros(count, np.int32)
    from_source = np.zeros(count, np.int32)
    ways = np.zeros((count, 6), np.int32)
    cost = _network(window, margin, piece, ways, from_source, to_sink)
    cost += max_flow(ways, from_source, to_sink, piece.shape)
    if keep == MOST:
        _keep_most(ways, to_sink, from_source, piece.shape)
    _lay(window, margin, piece, from_source, made)
    return made, int(cost)


@inline
def _differs(old, new):
    return 1 if (old & (FIXED - 1)) != new else 0


@kernel
def _network(window, margin, piece, ways, from_source, to_sink):
    """Capacities to the neighbours after and before along z, y, x, and to the terminals; returns
    what flows from one terminal to the other through one node alone, which is taken off at once."""
    depth, height, width = piece.shape
    steps = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    flow = 0
    for z in range(depth):
        for y in range(height):
            for x in range(width):
                node = (z * height + y) * width + x
                wz, wy, wx = z + margin[0], y + margin[1], x + margin[2]
                old = window[wz, wy, wx]
                if old >= OUT:
                    continue
                mine = _differs(old, piece[z, y, x])
                source = _HELD if old >= FIXED else 0
                sink = 0
                for axis in range(3):
                    dz, dy, dx = steps[axis]
                    for side in range(2):
                        sign = 1 - 2 * side
                        nz, ny, nx = z + sign * dz, y + sign * dy, x + sign * dx
                        kz, ky, kx = wz + sign * dz, wy + sign * dy, wx + sign * dx
                        if not (
                            0 <= kz < window.shape[0]
                            and 0 <= ky < window.shape[1]
                            and 0 <= kx < window.shape[2]
                        ):
                            continue
                        other = window[kz, ky, kx]
                        if 0 <= nz < depth and 0 <= ny < height and 0 <= nx < width:
                            if other == EMPTY:
                                sink += 2 * mine
                            elif other < OUT:
                                ways[node, 2 * axis + side] = mine + _differs(
                                    other, piece[nz, ny, nx]
                                )
                        elif other < OUT:
                            source += 2 * mine
                both = min(source, sink)
                from_source[node] = source - both
                to_sink[node] = sink - both
                flow += both
    return flow


@kernel
def max_flow(ways, from_source, to_sink, shape):
    """The greatest flow through a grid; all capacities become what is left of them. Afterwards
    `from_source` is -1 where a way with room leads from the source.

    ways[p, 2 a + s]: capacity from p to its neighbour after (s = 0) or before (1) along axis a.
    """
    count = len(ways)
    jumps = (shape[1] * shape[2], -shape[1] * shape[2], shape[2], -shape[2], 1, -1)
    level = np.empty(count, np.int32)
    queue = np.empty(count, np.int32)
    tried = np.empty(count, np.int8)
    path = np.empty(count, np.int32)
    total = 0
    while True:
        reached, tail = _levels(ways, from_source, to_sink, jumps, level, queue)
        if reached == count:
            break
        tried[:] = 0
        for n in range(tail):
            root = queue[n]
            if level[root] > 0:
                break
            while from_source[root] > 0:
                path[0] = root
                length = _shortest(ways, to_sink, jumps, level, reached, tried, path)
                if length == 0:
                    break
                total += _pushed(ways, from_source, to_sink, jumps, tried, path, length)
    for p in range(count):
        if level[p] >= 0:
            from_source[p] = -1
    return total


@inline
def _levels(ways, from_source, to_sink, jumps, level, queue):
    """Steps from the source to every node, -1 where none lead: how many to the nearest with room to
    the sink (all nodes for none), and how many nodes were found, in their order in `queue`."""
    count = len(ways)
    level[:] = -1
    head = tail = 0
    for p in range(count):
        if from_source[p] > 0:
            level[p], queue[tail] = 0, p
            tail += 1
    reached = count
    while head < tail:
        p = queue[head]
        head += 1
        if level[p] >= reached:
            continue
        if to_sink[p] > 0:
            reached = level[p]
        for way in range(6):
            if ways[p, way] > 0:
                q = p + jumps[way]
                if level[q] < 0:
                    level[q], queue[tail] = level[p] + 1, q
                    tail += 1
    return reached, tail


@inline
def _shortest(ways, to_sink, jumps, level, reached, tried, path):
    """The nodes of a shortest way from path[0] to the sink, written into `path`: how many, or 0 for
    no way. What was tried without success is not tried again."""
    length = 1
    while length > 0:
        p = path[length - 1]
        if to_sink[p] > 0:
            break
        moved = False
        while tried[p] < 6:
            way = tried[p]
            if ways[p, way] > 0 and level[p + jumps[way]] == level[p] + 1 and level[p] < reached:
                path[length] = p + jumps[way]
                length += 1
                moved = True
                break
            tried[p] += 1
        if not moved:
            length -= 1
            if length > 0:
                tried[path[length - 1]] += 1
    return length


@inline
def _pushed(ways, from_source, to_sink, jumps, tried, path, length):
    """Send along a way what it has room for, and say how much."""
    root, end = path[0], path[length - 1]
    push = min(from_source[root], to_sink[end])
    for k in range(length - 1):
        push = min(push, ways[path[k], tried[path[k]]])
    for k in range(length - 1):
        p, way = path[k], tried[path[k]]
        ways[p, way] -= push
        ways[p + jumps[way], way ^ 1] += push
    from_source[root] -= push
    to_sink[end] -= push
    return push


@kernel
def _keep_most(ways, to_sink, from_source, shape):
    """Mark with -1 in `from_source` every node from which no way with room leads to the sink."""
    jumps = (shape[1] * shape[2], -shape[1] * shape[2], shape[2], -shape[2], 1, -1)
    count = len(ways)
    queue = np.empty(count, np.int32)
    tail = 0
    for p in range(count):
        from_source[p] = -1
        if to_sink[p] > 0:
            from_source[p], queue[tail] = 0, p
            tail += 1
    head = 0
    while head < tail:
        p = queue[head]
        head += 1
        for way in range(6):
            q = p + jumps[way]
            if 0 <= q < count and from_source[q] == -1 and ways[q, way ^ 1] > 0:
                from_source[q], queue[tail] = 0, q
                tail += 1


@kernel
def _lay(window, margin, piece, from_source, made):
    """The piece where it is new, and on its side of the cut."""
    depth, height, width = piece.shape
    for z in range(depth):
        for y in range(height):
            for x in range(width):
                old = window[z + margin[0], y + margin[1], x + margin[2]]
                if old == OUT or (
                    old != EMPTY
                    and (old >= FIXED or from_source[(z * height + y) * width + x] == -1)
                ):
                    continue
                made[z + margin[0], y + margin[1], x + margin[2]] = piece[z, y, x]
