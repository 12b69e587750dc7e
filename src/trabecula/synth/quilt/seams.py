"""The join of a patch with its surroundings: a minimum cut through the overlap (section 3.3, step
3), and struts where no patch keeps the structure connected.

Voxels of the overlap are the nodes. With m(p) = 1 where old and new differ at p, separating
neighbours p and q costs m(p) + m(q) (Kwatra et al. 2003, doi:10.1145/882262.882264, equation 1, for
labels); a neighbour that only the old or only the new has differs as p does. The cut is exact:
Dinic's algorithm (blocking flows along shortest paths) on whole numbers. Of all minimum cuts the
one is taken that keeps least of the old, so that the new patch comes out as it is, unless that
tears connected voxels apart.

A component that a patch would close is within reach of voxels to make, or of a component that
continues there: otherwise it would have been closed before. A strut follows the path through the
box along which most of the judged candidates have the same class, so that it looks like a part of
them; it is as thick as the exemplar's structures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.synth.quilt.canvas import EMPTY, FIXED, OUT, inner_box
from trabecula.synth.quilt.connectivity import (
    CLOSED,
    FINE,
    SOLID,
    VOID,
    ComponentTracker,
    ConnectivityCheck,
)
from trabecula.synth.quilt.patch_library import PatchLibrary, void_label

_HELD = 1 << 28  # more than any cut

LEAST, MOST, ALL = 0, 1, 2
"""Parts of the old that a seam keeps: of all minimum cuts the least, or the most; or all of it,
without a cut.
"""


def cut_in(
    window: np.ndarray, margin: tuple[int, ...], patch: np.ndarray, *, keep: int = LEAST
) -> tuple[np.ndarray, int]:
    """Cut a patch into the box of a window, along the cheapest seam.

    Parameters
    ----------
    window : (z, y, x) uint8
        Labels, EMPTY, OUT; labels of measured voxels have FIXED added and stay.
    margin : three ints
        Voxels around the box.
    patch : uint8, the box's shape
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
        np.copyto(box, patch, where=box == EMPTY)
        return made, -1
    count = patch.size
    to_sink = np.zeros(count, np.int32)
    from_source = np.zeros(count, np.int32)
    ways = np.zeros((count, 6), np.int32)
    cost = _build_network(window, margin, patch, ways, from_source, to_sink)
    cost += max_flow(ways, from_source, to_sink, patch.shape)
    if keep == MOST:
        _keep_most(ways, to_sink, from_source, patch.shape)
    _lay_patch(window, margin, patch, from_source, made)
    return made, int(cost)


@inline
def _differs(old, new):
    """Return 1 where a voxel's old and new label differ."""
    return 1 if (old & (FIXED - 1)) != new else 0


@kernel
def _build_network(window, margin, patch, ways, from_source, to_sink):
    """Compute capacities to the neighbours after and before along z, y, x, and to the terminals;
    return the flow from one terminal to the other through one node alone, which is taken off at
    once.
    """
    depth, height, width = patch.shape
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
                mine = _differs(old, patch[z, y, x])
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
                                    other, patch[nz, ny, nx]
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
    """Push the greatest flow through a grid; return it, and leave residual capacities. Afterwards
    `from_source` is -1 where a residual path leads from the source.

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
                length = _shortest_path(ways, to_sink, jumps, level, reached, tried, path)
                if length == 0:
                    break
                total += _push_flow(ways, from_source, to_sink, jumps, tried, path, length)
    for p in range(count):
        if level[p] >= 0:
            from_source[p] = -1
    return total


@inline
def _levels(ways, from_source, to_sink, jumps, level, queue):
    """Compute the steps from the source to every node, -1 where no path leads.

    Returns the steps to the nearest node with capacity to the sink (the number of nodes for none),
    and how many nodes were found, in their order in `queue`.
    """
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
def _shortest_path(ways, to_sink, jumps, level, reached, tried, path):
    """Find a shortest path from path[0] to the sink and write its nodes into `path`; return their
    number, or 0. Failed steps are not tried again.
    """
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
def _push_flow(ways, from_source, to_sink, jumps, tried, path, length):
    """Push as much flow along a path as fits, and return it."""
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
    """Mark with -1 in `from_source` every node without a residual path to the sink."""
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
def _lay_patch(window, margin, patch, from_source, made):
    """Copy the patch to voxels to make, and to its side of the cut."""
    depth, height, width = patch.shape
    for z in range(depth):
        for y in range(height):
            for x in range(width):
                old = window[z + margin[0], y + margin[1], x + margin[2]]
                if old == OUT or (
                    old != EMPTY
                    and (old >= FIXED or from_source[(z * height + y) * width + x] == -1)
                ):
                    continue
                made[z + margin[0], y + margin[1], x + margin[2]] = patch[z, y, x]


_MOST_STRUTS = 16  # struts of a place

_DEAR, _CHEAP = 128, 8  # cost of a voxel where no candidate has the class, and where all have

# Random part of the cost, so that of equal paths none along the axes is taken.
_CROOKED = 8

_OPEN = 512  # cost of a strut that ends at voxels to make, instead of at another component

_FACES = 1.5  # faces of voxels over the area of the surface that they stand for

_NEVER = 1 << 30


@dataclass(frozen=True)
class StrutBuilder:
    """Labels and radius of the struts of a run.

    Attributes
    ----------
    void, solid : int
        Labels that they are made of.
    radius : int
        Voxels around a way that are filled.
    """

    void: int
    solid: int
    radius: int

    @classmethod
    def build(cls, library: PatchLibrary, feature: int) -> StrutBuilder:
        """Derive the radius from the exemplar's volume over surface, at least half the smallest
        feature.
        """
        labels, void = library.stack[0], void_label(library.images[0].phases)
        inside = labels != void
        counts = np.bincount(labels.ravel(), minlength=void + 2)
        counts[void] = 0
        faces = sum(int(np.count_nonzero(np.diff(inside, axis=axis))) for axis in range(3))
        half = _FACES * int(inside.sum()) / max(faces, 1)
        most = max(1, library.overlap // 2)
        return cls(void, int(counts.argmax()), max(min(round(half - 0.5), most), feature // 2, 0))

    def lay(
        self,
        components: ComponentTracker,
        check: ConnectivityCheck,
        old: np.ndarray,
        new: np.ndarray,
        numbers: np.ndarray,
        share: np.ndarray,
    ) -> np.ndarray | None:
        """Return `new` with struts that make it acceptable; None where there is no path.

        Parameters
        ----------
        components, check
        old, new : uint8
            The window before and after a patch was cut in.
        numbers : int32
            Components of `old`.
        share : (z, y, x) float32
            Share of the judged candidates with solid at a voxel of the box, 0 .. 1.
        """
        new = new.copy()
        for _ in range(_MOST_STRUTS):
            verdict = check.verdict(components, old, new, numbers)
            if verdict == FINE:
                return new
            if verdict != CLOSED or not self._lay_one(components, check, new, share):
                return None
        return None

    def _lay_one(
        self,
        components: ComponentTracker,
        check: ConnectivityCheck,
        new: np.ndarray,
        share: np.ndarray,
    ) -> bool:
        """Lay a strut from the smallest component that would be closed and has a path; return False
        where there is none.
        """
        leaders, shut, kept = check.closing_components()
        z, y, x = np.indices(share.shape)
        crooked = (73856093 * x ^ 19349663 * y ^ 83492791 * z) % _CROOKED
        far, came = np.empty(new.size, np.int32), np.empty(new.size, np.int32)
        for k in shut:
            kind = int(components.classes[new.ravel()[np.argmax(leaders == k)]])
            found = share if kind == SOLID else 1 - share
            cost = np.zeros(new.shape, np.int32)
            inner_box(cost, check.margin)[...] = (
                _CHEAP + np.rint((_DEAR - _CHEAP) * (1 - found)).astype(np.int32) + crooked
            )
            end = _cheapest_path(
                new, leaders, kept, components.classes, kind, int(k), cost, far, came
            )
            if end >= 0:
                label = self.void if kind == VOID else self.solid
                _fill_path(new, leaders, int(k), end, came, check.margin, label, self.radius)
                return True
        return False


@inline
def _neighbour(at, way, shape):
    """Return the neighbour of a voxel in one of six directions, or -1 where the window ends; voxels
    by their number.
    """
    depth, height, width = shape
    x, y, z = at % width, at // width % height, at // (width * height)
    if way == 0:
        return at + 1 if x + 1 < width else -1
    if way == 1:
        return at - 1 if x > 0 else -1
    if way == 2:
        return at + width if y + 1 < height else -1
    if way == 3:
        return at - width if y > 0 else -1
    if way == 4:
        return at + width * height if z + 1 < depth else -1
    return at - width * height if z > 0 else -1


@kernel
def _cheapest_path(window, leaders, kept, classes, kind, own, cost, far, came):
    """Find the cheapest path from a part to another of its class, or to voxels to make; return its
    last voxel, or -1.

    Costs are paid in the box alone (elsewhere they are 0: nothing is laid there), and voxels of the
    class are free. Distances are corrected until none changes, first in, first out.
    """
    values, parts, price = window.ravel(), leaders.ravel(), cost.ravel()
    queue = np.empty(len(values) + 1, np.int32)
    waits = np.zeros(len(values), np.bool_)
    head = tail = 0
    for p in range(len(values)):
        far[p], came[p] = _NEVER, -1
        if parts[p] == own:
            far[p], queue[tail], waits[p] = 0, p, True
            tail += 1
    best, end = _NEVER, -1
    while head != tail:
        p = queue[head]
        head = head + 1 if head + 1 < len(queue) else 0
        waits[p] = False
        for way in range(6):
            q = _neighbour(p, way, window.shape)
            if q < 0:
                continue
            if values[q] == EMPTY:
                if price[p] > 0 and far[p] + _OPEN < best:
                    best, end = far[p] + _OPEN, p
                continue
            same = classes[values[q]] == kind
            if same and parts[q] != own and kept[parts[q]]:
                if far[p] < best:
                    best, end = far[p], p
                continue
            if price[q] == 0 or values[q] >= FIXED:
                continue
            there = far[p] + (0 if same else price[q])
            if there < far[q]:
                far[q], came[q] = there, p
                if not waits[q]:
                    queue[tail], waits[q] = q, True
                    tail = tail + 1 if tail + 1 < len(queue) else 0
    return end


@kernel
def _fill_path(window, leaders, own, end, came, margin, label, radius):
    """Set the label of a path and of the voxels around it, within the box."""
    depth, height, width = window.shape
    parts = leaders.ravel()
    p = end
    while p >= 0 and parts[p] != own:
        x, y, z = p % width, p // width % height, p // (width * height)
        for k in range(max(z - radius, margin[0]), min(z + radius + 1, depth - margin[0])):
            for j in range(max(y - radius, margin[1]), min(y + radius + 1, height - margin[1])):
                for i in range(max(x - radius, margin[2]), min(x + radius + 1, width - margin[2])):
                    near = (k - z) ** 2 + (j - y) ** 2 + (i - x) ** 2 <= radius * (radius + 1)
                    if near and window[k, j, i] < FIXED:
                        window[k, j, i] = label
        p = came[p]
