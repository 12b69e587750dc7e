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
from trabecula.mesh.triangle_grid import is_within, samples_along, squared_distance

_ROOM = 9  # numbers in the lists of faces, per face; three to begin with
_MOST_AROUND = 48  # faces of a vertex; where there are more it is left alone
_UPRIGHT = 0.25  # least cosine between a triangle's normal before and after
_SAMPLED = 1.2  # tolerances between samples of new triangles
_NEEDLE = 0.03  # least height over side of a triangle, unless it was a worse one


class Surface(NamedTuple):
    """A surface while it is decimated.

    `positions` (V, 3), `faces` (F, 3) int32; the original vertices nearest to face f are a chain:
    `first[f]`, then `after[...]`, until -1. `clock[0]` counts collapses: the edge from corner k of
    face f was tried in vain at `tried[f, k]`, the faces of v `changed[v]` last.
    """

    positions: np.ndarray
    faces: np.ndarray
    first: np.ndarray
    after: np.ndarray
    tried: np.ndarray
    changed: np.ndarray
    clock: np.ndarray

    @classmethod
    def of(cls, vertices: np.ndarray, faces: np.ndarray) -> Surface:
        """Begin with the original surface."""
        first = np.full(len(faces), -1, np.int32)
        after = np.full(len(vertices), -1, np.int32)
        _assign(faces, first, after)
        tried, changed = np.full(faces.shape, -1, np.int32), np.zeros(len(vertices), np.int32)
        clock = np.zeros(1, np.int32)
        return cls(vertices.copy(), faces.copy(), first, after, tried, changed, clock)


def quadrics(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return for every vertex the sum over its triangles of area times the squared distance to
    their planes: (V, 11), the upper half of the matrix by rows, and the area.
    """
    found = np.zeros((len(vertices), 11))
    _add_planes(vertices, faces, found)
    return found


def collapse_edges(
    surface: Surface,
    squared: np.ndarray,
    grid: object,
    tolerance: float,
    cost: float,
    original: np.ndarray,
) -> int:
    """Collapse edges that cost at most so much, in place; faces that go have vertex -1. Return the
    number of these.
    """
    offsets = np.zeros(len(surface.positions) + 1, np.int64)
    around = np.empty(_ROOM * len(surface.faces), np.int32)
    _list_faces(surface.faces, offsets, around)
    lists = offsets[:-1].copy(), np.diff(offsets)
    box = np.stack([original.min(axis=0), original.max(axis=0)])
    return int(_collapse(*surface, squared, *lists, around, grid, tolerance, cost, original, box))


def compact(surface: Surface, squared: np.ndarray) -> tuple[Surface, np.ndarray]:
    """Leave out the faces that went, and the vertices that no face names."""
    kept = surface.faces[:, 0] >= 0
    faces = surface.faces[kept]
    used = np.zeros(len(surface.positions), bool)
    used[faces] = True
    number = np.cumsum(used, dtype=np.int32) - 1
    slim = Surface(
        surface.positions[used],
        number[faces].astype(np.int32),
        surface.first[kept],
        surface.after,
        surface.tried[kept],
        surface.changed[used],
        surface.clock,
    )
    return slim, squared[used]


@kernel
def _assign(faces, first, after):
    """Give every vertex to one of its faces."""
    given = np.zeros(len(after), np.bool_)
    for f in range(len(faces)):
        for corner in range(3):
            v = faces[f, corner]
            if not given[v]:
                given[v] = True
                after[v] = first[f]
                first[f] = v


@kernel
def _add_planes(vertices, faces, found):
    for f in range(len(faces)):
        a, b, c = vertices[faces[f, 0]], vertices[faces[f, 1]], vertices[faces[f, 2]]
        n0 = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
        n1 = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
        n2 = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        twice = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        if twice == 0:
            continue
        area = twice / 2
        n0, n1, n2 = n0 / twice, n1 / twice, n2 / twice
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
def _normal(a, b, c, n):
    """Write the cross product of two sides."""
    n[0] = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    n[1] = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    n[2] = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@inline
def _shape(a, b, c, n):
    """Return the least height of a triangle over its longest side, from its cross product."""
    longest = 0.0
    for one, other in ((a, b), (b, c), (c, a)):
        length = 0.0
        for axis in range(3):
            length += (one[axis] - other[axis]) ** 2
        longest = max(longest, length)
    if longest == 0:
        return 0.0
    return math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) / longest


@inline
def _keep_volume(positions, faces, star, dying0, dying1, i, j, tolerance, p):
    """Shift a place so that the volume under the star of an edge stays as it is.

    Seen from the place itself the new triangles enclose nothing, so what the old ones enclose is
    the change; it is linear in the place (Lindstrom and Turk 1998, doi:10.1109/VISUAL.1998.745314).
    """
    a, b, c, n = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    slope = np.zeros(3)
    change = 0.0
    for m in range(-2, len(star)):
        f = dying0 if m == -2 else (dying1 if m == -1 else star[m])
        for axis in range(3):
            a[axis] = positions[faces[f, 0], axis] - p[axis]
            b[axis] = positions[faces[f, 1], axis] - p[axis]
            c[axis] = positions[faces[f, 2], axis] - p[axis]
        change += (
            a[0] * (b[1] * c[2] - b[2] * c[1])
            + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
        )
        if m >= 0:
            for corner in range(3):
                w = faces[f, corner]
                if w in (i, j):
                    one, two = faces[f, (corner + 1) % 3], faces[f, (corner + 2) % 3]
                    _normal(p, positions[one], positions[two], n)
                    for axis in range(3):
                        slope[axis] += n[axis]
    square = slope[0] ** 2 + slope[1] ** 2 + slope[2] ** 2
    if square == 0:
        return
    length = abs(change) / math.sqrt(square)
    if length <= tolerance / 2:
        for axis in range(3):
            p[axis] += slope[axis] * change / square


@kernel
def _collapse(
    positions,
    faces,
    first,
    after,
    tried,
    changed,
    clock,
    squared,
    begin,
    size,
    around,
    grid,
    tolerance,
    cost,
    original,
    box,
):
    written = 3 * len(faces)
    mark = np.zeros(len(positions), np.int32)  # 1: next to one end, 2: next to both
    star = np.empty(2 * _MOST_AROUND, np.int32)  # faces that stay
    ring = np.empty(4 * _MOST_AROUND, np.int32)
    corners = np.empty((2 * _MOST_AROUND, 3, 3))  # of these, afterwards
    chain = np.empty(1 << 14, np.int32)
    nearest = np.empty(1 << 14, np.int32)
    p, q, sample = np.empty(3), np.empty(11), np.empty(3)
    old, new = np.empty(3), np.empty(3)
    gone = 0
    for start in range(len(faces)):
        for side in range(3):
            if faces[start, 0] < 0:
                break
            i, j = faces[start, side], faces[start, (side + 1) % 3]
            if i > j or tried[start, side] >= max(changed[i], changed[j]):
                continue
            if written + size[i] + size[j] > len(around):
                return gone
            for k in range(11):
                q[k] = squared[i, k] + squared[j, k]
            if _best_place(q, positions[i], positions[j], p) > cost:
                continue

            tried[start, side] = clock[0]

            # the faces that stay, and the vertices around
            count, others, common = 0, 0, 0
            dying0, dying1 = -1, -1
            for end in range(2):
                v = i if end == 0 else j
                for n in range(begin[v], begin[v] + size[v]):
                    f = around[n]
                    if faces[f, 0] < 0 or count == len(star) or others > len(ring) - 2:
                        continue
                    has_both = False
                    for corner in range(3):
                        w = faces[f, corner]
                        if w == (j if end == 0 else i):
                            has_both = True
                        if w in (i, j):
                            continue
                        if mark[w] == 0:
                            mark[w] = 1 + end
                            ring[others] = w
                            others += 1
                        elif mark[w] == 1 and end == 1:
                            mark[w] = 3
                            common += 1
                    if not has_both:
                        star[count] = f
                        count += 1
                    elif end == 0:
                        dying0, dying1 = (f, dying1) if dying0 < 0 else (dying0, f)
            for n in range(others):
                mark[ring[n]] = 0
            if common != 2 or count < 3 or dying1 < 0 or count > _MOST_AROUND:
                continue
            # a vertex across from the edge keeps three faces
            enough = True
            for f in (dying0, dying1):
                for corner in range(3):
                    w = faces[f, corner]
                    if w not in (i, j):
                        alive = 0
                        for n in range(begin[w], begin[w] + size[w]):
                            alive += faces[around[n], 0] >= 0
                        enough = enough and alive > 3
            if not enough:
                continue

            _keep_volume(positions, faces, star[:count], dying0, dying1, i, j, tolerance, p)
            for axis in range(3):  # flat faces on the box of the surface stay on it
                p[axis] = min(max(p[axis], box[0, axis]), box[1, axis])

            # normals and shapes
            good = True
            for n in range(count):
                f = star[n]
                for corner in range(3):
                    w = faces[f, corner]
                    for axis in range(3):
                        corners[n, corner, axis] = p[axis] if w in (i, j) else positions[w, axis]
                a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
                _normal(positions[a], positions[b], positions[c], old)
                _normal(corners[n, 0], corners[n, 1], corners[n, 2], new)
                dot = old[0] * new[0] + old[1] * new[1] + old[2] * new[2]
                sizes = math.sqrt(
                    (old[0] ** 2 + old[1] ** 2 + old[2] ** 2)
                    * (new[0] ** 2 + new[1] ** 2 + new[2] ** 2)
                )
                after_shape = _shape(corners[n, 0], corners[n, 1], corners[n, 2], new)
                if dot < _UPRIGHT * sizes or (
                    after_shape < _NEEDLE
                    and after_shape < _shape(positions[a], positions[b], positions[c], old)
                ):
                    good = False
                    break
            if not good:
                continue

            # the new triangles lie near the surface
            if not is_within(grid, p, tolerance):
                continue
            for n in range(count):
                a, b, c = corners[n, 0], corners[n, 1], corners[n, 2]
                steps = samples_along(a, b, c, _SAMPLED * tolerance)
                for s in range(steps + 1):
                    for t in range(steps + 1 - s):
                        if s == steps or t == steps or s + t == 0:
                            continue  # a corner
                        for axis in range(3):
                            sample[axis] = (
                                s * a[axis] + t * b[axis] + (steps - s - t) * c[axis]
                            ) / steps
                        if not is_within(grid, sample, tolerance):
                            good = False
                            break
                    if not good:
                        break
                if not good:
                    break
            if not good:
                continue

            # the surface's vertices lie near the new triangles
            held = 0
            for n in range(-2, count):
                f = dying0 if n == -2 else (dying1 if n == -1 else star[n])
                v = first[f]
                while v >= 0 and held < len(chain):
                    chain[held] = v
                    held += 1
                    v = after[v]
            if held == len(chain):
                continue
            for m in range(held):
                least = np.inf
                for n in range(count):
                    d = squared_distance(
                        original[chain[m]], corners[n, 0], corners[n, 1], corners[n, 2]
                    )
                    if d < least:
                        least = d
                        nearest[m] = n
                if least > tolerance * tolerance:
                    good = False
                    break
            if not good:
                continue

            for n in range(count):
                first[star[n]] = -1
                for corner in range(3):
                    if faces[star[n], corner] == j:
                        faces[star[n], corner] = i
            for m in range(held):
                f = star[nearest[m]]
                after[chain[m]] = first[f]
                first[f] = chain[m]
            faces[dying0, :] = -1
            faces[dying1, :] = -1
            positions[i] = p
            squared[i] = q
            begin[i], size[i] = written, count
            for n in range(count):
                around[written + n] = star[n]
            written += count
            clock[0] += 1
            changed[i] = clock[0]
            for n in range(others):
                changed[ring[n]] = clock[0]
            gone += 2
    return gone
