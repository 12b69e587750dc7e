"""Cut tetrahedra where a level changes its sign: nodes near the cut move onto it, edges that still
cross it are halved there.

Labelle and Shewchuk 2007, doi:10.1145/1276377.1276448: on a body-centred lattice, with these
distances, no dihedral angle is flat or sharp. What differs: edges are halved one after another
in place of a table of stencils; nodes of interfaces that were cut before and of
faces of the box stay on them; no node moves where a tetrahedron would become flat, which on a
lattice that was cut before it may. Nodes that do not move count as on the cut.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.rows import copy_row
from trabecula.mesh.tetrahedra.quality import cosines

_LONG, _SHORT = 0.24999, 0.41189  # of an edge: a cut nearer to its end moves the end
_BETWEEN = 0.93  # of a cell's side: long and short edges of the lattice
_FLAT = np.cos(np.radians(12))  # of the least angle that a move may leave


class CellCut(NamedTuple):
    """Tetrahedra after a cut.

    `points` (N, 3), `cells` (M, 4) int32, `planes` (N,) uint8 as of a lattice, `fixed` (N,) bool:
    nodes on interfaces; `whole` (M,): the cell before the cut that each is a part of; `side` (M,)
    int8: 1 where the level is above 0, -1 below, 0 where all nodes lie on the cut.
    """

    points: np.ndarray
    cells: np.ndarray
    planes: np.ndarray
    fixed: np.ndarray
    whole: np.ndarray
    side: np.ndarray


def cut_cells(
    points: np.ndarray,
    cells: np.ndarray,
    planes: np.ndarray,
    fixed: np.ndarray,
    level: np.ndarray,
    step: float,
    free: np.ndarray,
) -> CellCut:
    """Cut cells where `free` (M,) by a level at the nodes (N,); others are halved at the edges that
    they share with those.
    """
    points, level, fixed = points.copy(), level.copy(), fixed.copy()
    keys = _crossing_edges(cells[free], level)
    ends = np.stack([keys // len(points), keys % len(points)], axis=1)
    _snap(points, cells, planes, fixed, level, ends, step)
    crossing = level[ends[:, 0]] * level[ends[:, 1]] < 0
    keys, ends = keys[crossing], ends[crossing]
    part = level[ends[:, 0]] / (level[ends[:, 0]] - level[ends[:, 1]])
    one, other = points[ends[:, 0]], points[ends[:, 1]]
    places = one + part[:, None] * (other - one)
    count = len(points)
    nothing = np.empty((0, 4), np.int32), np.empty(0, np.int32), np.empty(0, np.int8)
    made = _split(cells, level, keys, count, *nothing)
    new, whole, side = (
        np.empty((made, 4), np.int32),
        np.empty(made, np.int32),
        np.empty(made, np.int8),
    )
    _split(cells, level, keys, count, new, whole, side)
    return CellCut(
        np.concatenate([points, places]),
        new,
        np.concatenate([planes, planes[ends[:, 0]] & planes[ends[:, 1]]]),
        np.concatenate([fixed | (level == 0), np.ones(len(places), bool)]),
        whole,
        side,
    )


def _crossing_edges(cells: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Return the edges whose ends lie on both sides: low end times nodes, plus high end; sorted."""
    sign = np.sign(level).astype(np.int8)[cells]
    mixed = cells[(sign.min(axis=1) < 0) & (sign.max(axis=1) > 0)].astype(np.int64)
    keys = []
    for a in range(4):
        for b in range(a + 1, 4):
            one, other = mixed[:, a], mixed[:, b]
            crosses = level[one] * level[other] < 0
            low = np.minimum(one, other)[crosses]
            keys.append(low * len(level) + np.maximum(one, other)[crosses])
    return np.unique(np.concatenate(keys)) if keys else np.empty(0, np.int64)


def _snap(
    points: np.ndarray,
    cells: np.ndarray,
    planes: np.ndarray,
    fixed: np.ndarray,
    level: np.ndarray,
    ends: np.ndarray,
    step: float,
) -> None:
    """Put nodes on the cut that lie near it along an edge, the nearest first."""
    one, other = ends[:, 0], ends[:, 1]
    length = np.sqrt(((points[one] - points[other]) ** 2).sum(axis=1))
    part = level[one] / (level[one] - level[other])
    near = np.where(length > _BETWEEN * step, _LONG, _SHORT)
    for_one, for_other = part < near, 1 - part < near
    node = np.concatenate([one[for_one], other[for_other]])
    far = np.concatenate([other[for_one], one[for_other]])
    along = np.concatenate([part[for_one], 1 - part[for_other]])
    away = np.concatenate([(part * length)[for_one], ((1 - part) * length)[for_other]])
    order = np.lexsort((far, node, away))
    pairs = np.stack([node, far], axis=1)[order]
    # cells of the nodes that may move, listed node by node
    listed = np.zeros(len(points), bool)
    listed[node] = True
    corner = np.flatnonzero(listed[cells.ravel()])
    corner = corner[np.argsort(cells.ravel()[corner], kind="stable")]
    start = np.searchsorted(cells.ravel()[corner], np.arange(len(points) + 1))
    _move(points, planes, fixed, level, pairs, along[order], cells, corner // 4, start)


@kernel
def _move(points, planes, fixed, level, pairs, along, cells, around, start):
    moved = np.zeros(len(level), np.bool_)
    before, normals = np.empty(3), np.empty((4, 3))
    for n in range(len(pairs)):
        a, b = pairs[n, 0], pairs[n, 1]
        if moved[a] or moved[b]:
            continue
        moved[a] = True
        level[a] = 0
        if fixed[a] or planes[a] & planes[b] != planes[a]:
            continue
        for axis in range(3):
            before[axis] = points[a, axis]
            points[a, axis] += along[n] * (points[b, axis] - points[a, axis])
        for m in range(start[a], start[a + 1]):
            if cosines(points, cells[around[m]], normals)[0] > _FLAT:
                copy_row(points[a], before)
                break


@inline
def _find(keys, key):
    low, high = 0, len(keys)
    while low < high:
        middle = (low + high) // 2
        if keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def _split(cells, level, keys, count, new, whole, side):
    """Halve every cell at its crossing edges, in their order; return how many there are then, and
    write them where there is room.

    The order is that of all edges, so cells that share a face divide it alike.
    """
    made = 0
    parts = np.empty((8, 4), np.int32)
    found = np.empty(4, np.int64)
    for n in range(len(cells)):
        crossed = 0
        for a in range(4):
            value = level[cells[n, a]]
            for b in range(a + 1, 4):
                if value * level[cells[n, b]] < 0:
                    low = min(cells[n, a], cells[n, b])
                    high = max(cells[n, a], cells[n, b])
                    key = np.int64(low) * count + high
                    at = _find(keys, key)
                    if at == len(keys) or keys[at] != key:
                        continue
                    place = crossed
                    while place > 0 and found[place - 1] > at:
                        found[place] = found[place - 1]
                        place -= 1
                    found[place] = at
                    crossed += 1
        copy_row(parts[0], cells[n])
        size = 1
        for k in range(crossed):
            key = keys[found[k]]
            low, high = key // count, key % count
            for m in range(size):
                first = second = -1
                for a in range(4):
                    if parts[m, a] == low:
                        first = a
                    elif parts[m, a] == high:
                        second = a
                if first >= 0 and second >= 0:
                    copy_row(parts[size], parts[m])
                    parts[m, second] = count + found[k]
                    parts[size, first] = count + found[k]
                    size += 1
        for m in range(size):
            made += 1
            if made > len(new):
                continue
            sign = 0
            for a in range(4):
                if parts[m, a] < count and level[parts[m, a]] != 0:
                    sign = 1 if level[parts[m, a]] > 0 else -1
            copy_row(new[made - 1], parts[m])
            whole[made - 1], side[made - 1] = n, sign
    return made
