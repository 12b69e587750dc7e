"""Passes of edge collapses over a closed surface: plain arrays and kernels.

A pass tries every edge once. Where one collapses the list of its faces is written anew, at the
end of all lists; faces that went stay in the lists of their other vertices. So passes are made on
compact arrays.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.rows import copy_row
from trabecula.mesh.triangle_grid import (
    TriangleGrid,
    is_within,
    longest_side,
    samples_along,
    squared_distance,
)

_ROOM = 9  # numbers in the lists of faces, per face; three to begin with
_MOST_AROUND = 48  # faces of a vertex; where there are more it is left alone
_MOST_NEAR = 1 << 14  # original vertices near the faces of an edge
_UPRIGHT = 0.25  # least cosine between a triangle's normal before and after
_SAMPLED = 1.2  # tolerances between samples of new triangles
_NEEDLE = 0.03  # least height over side of a triangle, unless it was a worse one


class Surface(NamedTuple):
    """A surface while it is decimated.

    `positions` (V, 3), `faces` (F, 3) int32; `quadrics` (V, 11): of every vertex the sum over the
    triangles that went into it of area times the squared distance to their planes, as the upper
    half of a matrix by rows, and the area. The original vertices nearest to face f are a chain:
    `first[f]`, then `after[...]`, until -1. `clock[0]` counts collapses: the edge from corner k of
    face f was tried in vain at `tried[f, k]`, the faces of v `changed[v]` last.
    """

    positions: np.ndarray
    faces: np.ndarray
    quadrics: np.ndarray
    first: np.ndarray
    after: np.ndarray
    tried: np.ndarray
    changed: np.ndarray
    clock: np.ndarray

    @classmethod
    def of(cls, vertices: np.ndarray, faces: np.ndarray) -> Surface:
        """Begin with the original surface."""
        surface = cls(
            vertices.copy(),
            faces.copy(),
            np.zeros((len(vertices), 11)),
            np.full(len(faces), -1, np.int32),
            np.full(len(vertices), -1, np.int32),
            np.full(faces.shape, -1, np.int32),
            np.zeros(len(vertices), np.int32),
            np.zeros(1, np.int32),
        )
        _add_planes(surface)
        _assign(surface)
        return surface


class Limits(NamedTuple):
    """What a collapse may do: new triangles lie within `tolerance` of the surface in `grid`, and
    its `vertices` (V, 3) within it of the new triangles; places stay in the `box` (2, 3).
    """

    grid: TriangleGrid
    vertices: np.ndarray
    box: np.ndarray
    tolerance: float


class _Lists(NamedTuple):
    """The faces of vertex v: `around[begin[v] : begin[v] + size[v]]`, those that went among them;
    `written` (1,) is where the next list begins.
    """

    begin: np.ndarray
    size: np.ndarray
    around: np.ndarray
    written: np.ndarray


class _Star(NamedTuple):
    """The surroundings of one edge.

    `faces`: the two that would go, then those that would stay, whose `corners` (n, 3, 3) are those
    afterwards; `ring`: the vertices around; `chain`: the original vertices near these faces, and
    the number of the face that stays that each is `nearest` to; `place` (3,) where the edge would
    go, `quadric` (11,) of both ends; `mark` (V,) is 0 between edges.
    """

    faces: np.ndarray
    corners: np.ndarray
    ring: np.ndarray
    chain: np.ndarray
    nearest: np.ndarray
    place: np.ndarray
    quadric: np.ndarray
    mark: np.ndarray


def limits_of(grid: TriangleGrid, vertices: np.ndarray, tolerance: float) -> Limits:
    """Hold the original surface for collapses."""
    box = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    return Limits(grid, vertices, box, tolerance)


def collapse_edges(surface: Surface, limits: Limits, cost: float) -> int:
    """Collapse edges that cost at most so much, in place; faces that go have vertex -1. Return the
    number of these.
    """
    count = len(surface.positions)
    begin = np.zeros(count + 1, np.int64)
    around = np.empty(_ROOM * len(surface.faces), np.int32)
    _list_faces(surface.faces, begin, around)
    written = np.array([3 * len(surface.faces)])
    lists = _Lists(begin[:-1].copy(), np.diff(begin), around, written)
    star = _Star(
        np.empty(2 + 2 * _MOST_AROUND, np.int32),
        np.empty((2 * _MOST_AROUND, 3, 3)),
        np.empty(4 * _MOST_AROUND, np.int32),
        np.empty(_MOST_NEAR, np.int32),
        np.empty(_MOST_NEAR, np.int32),
        np.empty(3),
        np.empty(11),
        np.zeros(count, np.int32),
    )
    return int(_collapse(surface, lists, limits, star, cost))


def compact(surface: Surface) -> Surface:
    """Leave out the faces that went, and the vertices that no face names."""
    kept = surface.faces[:, 0] >= 0
    faces = surface.faces[kept]
    used = np.zeros(len(surface.positions), bool)
    used[faces] = True
    number = np.cumsum(used, dtype=np.int32) - 1
    return Surface(
        surface.positions[used],
        number[faces].astype(np.int32),
        surface.quadrics[used],
        surface.first[kept],
        surface.after,
        surface.tried[kept],
        surface.changed[used],
        surface.clock,
    )


@inline
def _normal(a, b, c, n):
    """Write the cross product of two sides."""
    n[0] = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    n[1] = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    n[2] = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@kernel
def _assign(surface):
    """Give every vertex to one of its faces."""
    given = np.zeros(len(surface.after), np.bool_)
    for f in range(len(surface.faces)):
        for corner in range(3):
            v = surface.faces[f, corner]
            if not given[v]:
                given[v] = True
                surface.after[v] = surface.first[f]
                surface.first[f] = v


@kernel
def _add_planes(surface):
    """Add the plane of every face to the quadrics of its corners."""
    vertices, faces, found = surface.positions, surface.faces, surface.quadrics
    n = np.empty(3)
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        _normal(a, b, c, n)
        twice = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
        if twice == 0:
            continue
        area = twice / 2
        n0, n1, n2 = n[0] / twice, n[1] / twice, n[2] / twice
        d = -(n0 * a[0] + n1 * a[1] + n2 * a[2])
        terms = (n0 * n0, n0 * n1, n0 * n2, n0 * d, n1 * n1, n1 * n2, n1 * d, n2 * n2, n2 * d)
        for corner in range(3):
            v = faces[f, corner]
            for k in range(9):
                found[v, k] += area * terms[k]
            found[v, 9] += area * d * d
            found[v, 10] += area


@kernel
def _list_faces(faces, offsets, around):
    """List the faces of every vertex."""
    for f in range(len(faces)):
        for corner in range(3):
            offsets[faces[f, corner] + 1] += 1
    for v in range(len(offsets) - 1):
        offsets[v + 1] += offsets[v]
    place = offsets[:-1].copy()
    for f in range(len(faces)):
        for corner in range(3):
            v = faces[f, corner]
            around[place[v]] = f
            place[v] += 1


@inline
def _cost(q, p):
    """Return the mean squared distance of a point to the planes of a quadric."""
    x, y, z = p[0], p[1], p[2]
    total = (
        q[0] * x * x
        + 2 * q[1] * x * y
        + 2 * q[2] * x * z
        + 2 * q[3] * x
        + q[4] * y * y
        + 2 * q[5] * y * z
        + 2 * q[6] * y
        + q[7] * z * z
        + 2 * q[8] * z
        + q[9]
    )
    return max(total, 0.0) / q[10]


@inline
def _best_place(q, a, b, p):
    """Write the place of least cost; where that is far off, the best of the ends and their
    middle.
    """
    c0 = q[4] * q[7] - q[5] * q[5]
    c1 = q[2] * q[5] - q[1] * q[7]
    c2 = q[1] * q[5] - q[2] * q[4]
    determinant = q[0] * c0 + q[1] * c1 + q[2] * c2
    size = (q[0] + q[4] + q[7]) / 3
    length = (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2
    if determinant > 1e-4 * size * size * size:
        d1 = q[0] * q[7] - q[2] * q[2]
        d2 = q[1] * q[2] - q[0] * q[5]
        e2 = q[0] * q[4] - q[1] * q[1]
        p[0] = -(c0 * q[3] + c1 * q[6] + c2 * q[8]) / determinant
        p[1] = -(c1 * q[3] + d1 * q[6] + d2 * q[8]) / determinant
        p[2] = -(c2 * q[3] + d2 * q[6] + e2 * q[8]) / determinant
        off = 0.0
        for axis in range(3):
            off += (p[axis] - (a[axis] + b[axis]) / 2) ** 2
        if off <= length:
            return _cost(q, p)
    least = np.inf
    best = 0.5
    for t in (0.5, 0.0, 1.0):
        for axis in range(3):
            p[axis] = (1 - t) * a[axis] + t * b[axis]
        value = _cost(q, p)
        if value < least:
            least, best = value, t
    for axis in range(3):
        p[axis] = (1 - best) * a[axis] + best * b[axis]
    return least


@inline
def _shape(a, b, c, n):
    """Return the least height of a triangle over its longest side, from its cross product."""
    longest = longest_side(a, b, c)
    if longest == 0:
        return 0.0
    return math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) / longest**2


@inline
def _gather(surface, lists, star, i, j):
    """Write the faces around an edge and its ring; return how many faces stay, how many vertices
    are in the ring, and whether the edge may collapse: its ends have two neighbours in common, and
    the vertices across from it keep three faces.
    """
    faces, mark = surface.faces, star.mark
    count, others, common, dying = 0, 0, 0, 0
    for end in range(2):
        v, other = (i, j) if end == 0 else (j, i)
        for n in range(lists.begin[v], lists.begin[v] + lists.size[v]):
            f = lists.around[n]
            if faces[f, 0] < 0 or count == len(star.corners) or others > len(star.ring) - 2:
                continue
            has_both = False
            for corner in range(3):
                w = faces[f, corner]
                has_both = has_both or w == other
                if w in (i, j):
                    continue
                if mark[w] == 0:
                    mark[w] = 1 + end
                    star.ring[others] = w
                    others += 1
                elif mark[w] == 1 and end == 1:
                    mark[w] = 3
                    common += 1
            if not has_both:
                star.faces[2 + count] = f
                count += 1
            elif end == 0:
                star.faces[min(dying, 1)] = f
                dying += 1
    for n in range(others):
        mark[star.ring[n]] = 0
    able = common == 2 and dying >= 2 and 3 <= count <= _MOST_AROUND
    for m in range(2 if able else 0):
        for corner in range(3):
            w = faces[star.faces[m], corner]
            if w not in (i, j):
                alive = 0
                for n in range(lists.begin[w], lists.begin[w] + lists.size[w]):
                    alive += faces[lists.around[n], 0] >= 0
                able = able and alive > 3
    return count, others, able


@inline
def _keep_volume(surface, star, count, i, j, tolerance):
    """Shift the place of an edge so that the volume under its star stays as it is.

    Seen from the place itself the new triangles enclose nothing, so what the old ones enclose is
    the change; it is linear in the place (Lindstrom and Turk 1998, doi:10.1109/VISUAL.1998.745314).
    """
    positions, faces, p = surface.positions, surface.faces, star.place
    a, b, c, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    slope = np.zeros(3)
    change = 0.0
    for m in range(2 + count):
        f = star.faces[m]
        for axis in range(3):
            a[axis] = positions[faces[f, 0], axis] - p[axis]
            b[axis] = positions[faces[f, 1], axis] - p[axis]
            c[axis] = positions[faces[f, 2], axis] - p[axis]
        change += (
            a[0] * (b[1] * c[2] - b[2] * c[1])
            + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
        )
        if m < 2:
            continue
        for corner in range(3):
            if faces[f, corner] in (i, j):
                one, two = faces[f, (corner + 1) % 3], faces[f, (corner + 2) % 3]
                _normal(p, positions[one], positions[two], n)
                for axis in range(3):
                    slope[axis] += n[axis]
    square = slope[0] ** 2 + slope[1] ** 2 + slope[2] ** 2
    if square > 0 and abs(change) / math.sqrt(square) <= tolerance / 2:
        for axis in range(3):
            p[axis] += slope[axis] * change / square


@inline
def _keeps_shapes(surface, star, count, i, j):
    """Write the corners afterwards; return whether no triangle turns over or becomes a needle."""
    positions, faces, corners = surface.positions, surface.faces, star.corners
    old, new = np.empty(3), np.empty(3)
    for n in range(count):
        f = star.faces[2 + n]
        for corner in range(3):
            w = faces[f, corner]
            for axis in range(3):
                corners[n, corner, axis] = star.place[axis] if w in (i, j) else positions[w, axis]
        a, b, c = positions[faces[f, 0]], positions[faces[f, 1]], positions[faces[f, 2]]
        _normal(a, b, c, old)
        _normal(corners[n, 0], corners[n, 1], corners[n, 2], new)
        dot = old[0] * new[0] + old[1] * new[1] + old[2] * new[2]
        sizes = math.sqrt(
            (old[0] ** 2 + old[1] ** 2 + old[2] ** 2) * (new[0] ** 2 + new[1] ** 2 + new[2] ** 2)
        )
        if dot < _UPRIGHT * sizes:
            return False
        shape = _shape(corners[n, 0], corners[n, 1], corners[n, 2], new)
        if shape < _NEEDLE and shape < _shape(a, b, c, old):
            return False
    return True


@inline
def _lies_near(limits, star, count):
    """Return whether samples of the new triangles lie near the surface."""
    if not is_within(limits.grid, star.place, limits.tolerance):
        return False
    sample = np.empty(3)
    for n in range(count):
        a, b, c = star.corners[n, 0], star.corners[n, 1], star.corners[n, 2]
        steps = samples_along(a, b, c, _SAMPLED * limits.tolerance)
        for s in range(steps + 1):
            for t in range(steps + 1 - s):
                if s == steps or t == steps or s + t == 0:
                    continue  # a corner
                for axis in range(3):
                    sample[axis] = (s * a[axis] + t * b[axis] + (steps - s - t) * c[axis]) / steps
                if not is_within(limits.grid, sample, limits.tolerance):
                    return False
    return True


@inline
def _find_nearest(surface, limits, star, count):
    """Write the original vertices that are near the faces of an edge, and the new triangle nearest
    to each; return their number, -1 where one is too far from all of them.
    """
    held = 0
    for n in range(2 + count):
        v = surface.first[star.faces[n]]
        while v >= 0 and held < len(star.chain):
            star.chain[held] = v
            held += 1
            v = surface.after[v]
    if held == len(star.chain):
        return -1
    tolerance = limits.tolerance
    for m in range(held):
        least = np.inf
        for n in range(count):
            corners = star.corners[n]
            d = squared_distance(limits.vertices[star.chain[m]], corners[0], corners[1], corners[2])
            if d < least:
                least = d
                star.nearest[m] = n
        if least > tolerance * tolerance:
            return -1
    return held


@inline
def _replace_edge(surface, lists, star, i, j, counts):
    """Put one vertex in place of an edge; `counts` are the faces that stay, the ring, the chain."""
    count, others, held = counts
    for n in range(count):
        f = star.faces[2 + n]
        surface.first[f] = -1
        for corner in range(3):
            if surface.faces[f, corner] == j:
                surface.faces[f, corner] = i
    for m in range(held):
        f, v = star.faces[2 + star.nearest[m]], star.chain[m]
        surface.after[v] = surface.first[f]
        surface.first[f] = v
    surface.faces[star.faces[0], :] = -1
    surface.faces[star.faces[1], :] = -1
    copy_row(surface.positions[i], star.place)
    copy_row(surface.quadrics[i], star.quadric)
    start = lists.written[0]
    lists.begin[i], lists.size[i] = start, count
    for n in range(count):
        lists.around[start + n] = star.faces[2 + n]
    lists.written[0] = start + count
    surface.clock[0] += 1
    surface.changed[i] = surface.clock[0]
    for n in range(others):
        surface.changed[star.ring[n]] = surface.clock[0]


@kernel
def _collapse(surface, lists, limits, star, cost):
    """Try every edge once; return the number of faces that went."""
    faces, changed = surface.faces, surface.changed
    gone = 0
    for start in range(len(faces)):
        for side in range(3):
            if faces[start, 0] < 0:
                break
            i, j = faces[start, side], faces[start, (side + 1) % 3]
            if i > j or surface.tried[start, side] >= max(changed[i], changed[j]):
                continue
            if lists.written[0] + lists.size[i] + lists.size[j] > len(lists.around):
                return gone
            for k in range(11):
                star.quadric[k] = surface.quadrics[i, k] + surface.quadrics[j, k]
            one, other = surface.positions[i], surface.positions[j]
            if _best_place(star.quadric, one, other, star.place) > cost:
                continue
            surface.tried[start, side] = surface.clock[0]
            count, others, able = _gather(surface, lists, star, i, j)
            if not able:
                continue
            _keep_volume(surface, star, count, i, j, limits.tolerance)
            for axis in range(3):  # flat faces on the box of the surface stay on it
                low, high = limits.box[0, axis], limits.box[1, axis]
                star.place[axis] = min(max(star.place[axis], low), high)
            if not _keeps_shapes(surface, star, count, i, j):
                continue
            if not _lies_near(limits, star, count):
                continue
            held = _find_nearest(surface, limits, star, count)
            if held >= 0:
                _replace_edge(surface, lists, star, i, j, (count, others, held))
                gone += 2
    return gone
