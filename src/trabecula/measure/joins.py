"""Paths that join components, as a minimum spanning tree of them; the cost of a path is the number
of voxels that it fills, or the sum of their costs.

1. Give every voxel the number of its nearest component through the background (by faces of voxels),
   and the distance to it: two sweeps where all other voxels are background and cost the same, else
   more of them.
2. Boruvka's rounds: every tree of components takes the cheapest path to another one, and the two
   are one tree from then on. Paths run where two numbers meet; that such paths hold a minimum
   spanning tree of all paths is theorem 1 of Mehlhorn 1988, doi:10.1016/0020-0190(88)90066-X.
3. Follow every path to both ends, and draw it straight between them where that is as short and
   open, and all voxels cost the same.

All passes run over slabs along z one after the other, and the arrays may be memory-mapped.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import in_order, sum_slabs
from trabecula.engine.rows import copy_row
from trabecula.measure.neighbours import place_along
from trabecula.measure.runs import Runs
from trabecula.measure.union_find import root_of

NOWHERE = np.iinfo(np.uint16).max
"""Distance of voxels that no path reaches: one more than that of the longest path."""


class NearestComponents(NamedTuple):
    """The nearest component of every voxel through the open ones, and how it is reached.

    Attributes
    ----------
    owner : (Z, Y, X) uint16 or int32
        Number of the component, 0 where no path leads.
    far : (Z, Y, X) uint16
        Cost of the path to it, NOWHERE where there is none.
    cost : (Z, Y, X) uint8
        Cost of each open voxel; empty where all cost 1.
    wraps : (3,) bool
        Paths continue at the opposite face.
    """

    owner: np.ndarray
    far: np.ndarray
    cost: np.ndarray
    wraps: np.ndarray


def cheapest_joins(
    values: np.ndarray,
    runs: Runs,
    worth: np.ndarray,
    background: int,
    inside: np.ndarray | None = None,
    wraps: Sequence[bool] = (False, False, False),
    cost: np.ndarray | None = None,
) -> list[np.ndarray]:
    """Return paths that join components through the fewest background voxels, or the cheapest ones;
    the shortest first.

    Parameters
    ----------
    values : (Z, Y, X) uint8 labels
    runs : Runs
        Their components.
    worth : (n,) bool
        True for the components to join. Paths may run through the others and the background.
    background : int
        Label of the background.
    inside : (Z, Y, X) bool, optional
        Voxels that paths may run through. Default: all.
    wraps : three bool
        Paths continue at the opposite face.
    cost : (Z, Y, X) uint8, optional
        Cost of each background voxel, 1 or more. Default: 1.

    Returns
    -------
    paths : list of (n, 3) int64
        The first voxel is one of the smaller of two components, the others are open; the last one
        touches the other component. A path across a periodic face has voxels beyond it.
    """
    numbers = np.zeros(len(runs.sizes) + 1, np.int32)
    numbers[1:][worth] = np.arange(1, np.count_nonzero(worth) + 1)
    count = int(numbers.max())
    if count < 2:
        return []
    open_to = _open_voxels(values, runs, worth, background, inside)
    nearest = NearestComponents(
        owner=memmap.zeros(values.shape, np.uint16 if count < 2**16 else np.int32),
        far=memmap.empty(values.shape, np.uint16),
        cost=np.empty((0, 0, 0), np.uint8) if cost is None else cost,
        wraps=np.array(wraps),
    )
    seeds = (runs.first, runs.begin, runs.end, runs.label, numbers)
    in_order(lambda start, stop: _seed(*seeds, nearest, start, stop), len(values))
    held = int(runs.sizes[worth].sum()) + sum_slabs(
        lambda a, b: np.count_nonzero(open_to[a:b]), len(values)
    )
    again = held < values.size or any(wraps) or cost is not None
    _spread_owners(nearest, open_to, again=again)
    sizes = np.concatenate([[0], runs.sizes[worth]])
    paths = [_follow(nearest, place, axis, sizes) for place, axis in _tree(nearest, count)]
    if cost is None:
        return sorted((_straighten(path, open_to) for path in paths), key=len)
    return sorted((path[:-1] for path in paths), key=len)


def _open_voxels(
    values: np.ndarray, runs: Runs, worth: np.ndarray, background: int, inside: np.ndarray | None
) -> np.ndarray:
    """Return the voxels (Z, Y, X) that paths may run through, a bool array."""
    free = memmap.zeros(values.shape, np.bool_)

    def mark(start: int, stop: int) -> None:
        free[start:stop] = values[start:stop] == background

    in_order(mark, len(values))
    runs.write(free.view(np.uint8), ~worth, 1)  # specks will be removed
    if inside is not None:

        def close(start: int, stop: int) -> None:
            free[start:stop] &= inside[start:stop]

        in_order(close, len(values))
    return free


def _spread_owners(nearest: NearestComponents, open_to: np.ndarray, *, again: bool) -> None:
    """Write the nearest component and the distance to it into every open voxel.

    Where no voxel is closed, all cost the same and no axis is periodic, a shortest path never turns
    back along an axis, and one sweep in each direction finds all of them; else the two are repeated
    (`again`) until nothing changes.
    """
    depth, number, changed = len(open_to), 0, [True]
    last = np.ones(open_to.shape[:2], np.int32)  # sweep in which a row changed
    while changed[0]:
        changed[0], number = False, number + 2

        def forward(start: int, stop: int, at: int = number - 1) -> None:
            changed[0] |= bool(_sweep(nearest, open_to, last, at, 1, start, stop))

        def backward(start: int, stop: int, at: int = number) -> None:
            first, end = depth - stop, depth - start
            changed[0] |= bool(_sweep(nearest, open_to, last, at, -1, first, end))

        in_order(forward, depth)
        in_order(backward, depth)
        if not again:
            return


def _tree(nearest: NearestComponents, count: int) -> list[tuple[int, int]]:
    """Find the paths of the minimum spanning tree by Boruvka's rounds.

    Each is the flat index and the axis of the two neighbouring voxels at which its halves meet.
    """
    parent, depth = np.arange(count + 1, dtype=np.int32), len(nearest.owner)
    paths: list[tuple[int, int]] = []
    while True:
        cost = np.full(count + 1, 2 * NOWHERE, np.int64)
        place = np.full(count + 1, -1, np.int64)
        axis = np.zeros(count + 1, np.int64)
        in_order(partial(_cheapest, nearest, parent, cost, place, axis), depth)
        before = len(paths)
        # Paths have a strict order (cost, then place and axis), so that no ring closes; two trees
        # may name the same path.
        for tree in np.flatnonzero(place >= 0):
            if _unite(nearest.owner, parent, int(place[tree]), int(axis[tree])):
                paths.append((int(place[tree]), int(axis[tree])))
        if len(paths) == before:
            return paths


def _follow(nearest: NearestComponents, place: int, axis: int, sizes: np.ndarray) -> np.ndarray:
    """Return a path from a voxel of the smaller of its two components to one of the larger.

    Beyond a periodic face its voxels go on: they are not taken back to the opposite one.
    """
    owner = nearest.owner
    here = np.array(np.unravel_index(place, owner.shape), np.int64)
    there = here.copy()
    there[axis] = (there[axis] + 1) % owner.shape[axis]
    if sizes[owner[tuple(here)]] > sizes[owner[tuple(there)]]:
        here, there = there, here
    first, last = (_descend(nearest, end) for end in (here, there))
    path = np.concatenate([first[::-1], last])
    steps = np.diff(path, axis=0)
    across = np.abs(steps) > 1  # from one face to the opposite one
    steps[across] -= (np.sign(steps) * owner.shape)[across]
    return np.concatenate([path[:1], path[0] + np.cumsum(steps, axis=0)])


def _straighten(path: np.ndarray, open_to: np.ndarray) -> np.ndarray:
    """Return a path without its last voxel, drawn as a straight line where that is open.

    Only where the line, by faces of voxels, is as short as the path.
    """
    apart = path[-1] - path[0]
    count = int(np.abs(apart).sum())
    if count != len(path) - 1:
        return path[:-1]
    line, lag = np.repeat(path[:1], count, axis=0), np.zeros(3)
    for n in range(1, count):
        lag += np.abs(apart) / count
        axis = int(np.argmax(lag))
        lag[axis] -= 1
        line[n] = line[n - 1]
        line[n, axis] += np.sign(apart[axis])
    return line if open_to[tuple((line[1:] % open_to.shape).T)].all() else path[:-1]


@kernel
def _seed(first, begin, end, label, numbers, nearest, start, stop):
    """Write distance 0 and the owner into the components to join."""
    owner, far = nearest.owner, nearest.far
    height = owner.shape[1]
    far[start:stop] = NOWHERE
    for row in range(start * height, stop * height):
        z, y = row // height, row % height
        for k in range(first[row], first[row + 1]):
            number = numbers[label[k]]
            if number:
                owner[z, y, begin[k] : end[k]] = number
                far[z, y, begin[k] : end[k]] = 0


@kernel
def _sweep(nearest, open_to, last, number, way, start, stop):
    """Propagate owners in raster order (way 1) or against it (-1); return whether any changed.

    A row is left out where neither it nor the rows before it changed in the last sweep or in this
    one, sweep `number`: it has seen all of them. Around a periodic axis a row comes before the
    one that it continues, so that it counts for one sweep more.
    """
    owner, far, cost, wraps = nearest
    oldest = number - (2 if wraps.any() else 1)
    depth, height, width = owner.shape
    changed = False
    for i in range(stop - start):
        z = start + i if way > 0 else stop - 1 - i
        c = place_along(z - way, depth, wraps[0])
        for j in range(height):
            y = j if way > 0 else height - 1 - j
            b = place_along(y - way, height, wraps[1])
            seen = max(last[z, y], last[c, y] if c >= 0 else 0, last[z, b] if b >= 0 else 0)
            if seen < oldest:
                continue
            for k in range(width):
                x = k if way > 0 else width - 1 - k
                if not open_to[z, y, x]:
                    continue
                best = np.int64(far[z, y, x])
                component = np.int64(owner[z, y, x])
                before = best
                price = np.int64(cost[z, y, x]) if cost.size else np.int64(1)
                a = place_along(x - way, width, wraps[2])
                if c >= 0 and far[c, y, x] < best - price:
                    best, component = np.int64(far[c, y, x]) + price, np.int64(owner[c, y, x])
                if b >= 0 and far[z, b, x] < best - price:
                    best, component = np.int64(far[z, b, x]) + price, np.int64(owner[z, b, x])
                if a >= 0 and far[z, y, a] < best - price:
                    best, component = np.int64(far[z, y, a]) + price, np.int64(owner[z, y, a])
                if best < before:
                    far[z, y, x] = best
                    owner[z, y, x] = component
                    last[z, y] = number
                    changed = True
    return changed


@kernel
def _cheapest(nearest, parent, cost, place, axis, start, stop):
    """Find, for every tree of components, the first of the cheapest paths to another tree."""
    owner, far, _, wraps = nearest
    depth, height, width = owner.shape
    for z in range(start, stop):
        below = place_along(z + 1, depth, wraps[0])
        for y in range(height):
            behind = place_along(y + 1, height, wraps[1])
            for x in range(width):
                here = owner[z, y, x]
                if here == 0:
                    continue
                beside = place_along(x + 1, width, wraps[2])
                for step in range(3):
                    k = below if step == 0 else z
                    j = behind if step == 1 else y
                    i = beside if step == 2 else x
                    if k < 0 or j < 0 or i < 0:
                        continue
                    there = owner[k, j, i]
                    if there == 0 or there == here:
                        continue
                    length = np.int64(far[z, y, x]) + np.int64(far[k, j, i])
                    a, b = root_of(parent, here), root_of(parent, there)
                    if a == b:
                        continue
                    at = (z * height + y) * width + x
                    if length < cost[a]:
                        cost[a], place[a], axis[a] = length, at, step
                    if length < cost[b]:
                        cost[b], place[b], axis[b] = length, at, step


@kernel
def _unite(owner, parent, place, axis):
    """Join the trees on both sides of a meeting place; return whether they were two."""
    depth, height, width = owner.shape
    z, y, x = place // (height * width), place // width % height, place % width
    k, j, i = (z + (axis == 0)) % depth, (y + (axis == 1)) % height, (x + (axis == 2)) % width
    a, b = root_of(parent, owner[z, y, x]), root_of(parent, owner[k, j, i])
    parent[max(a, b)] = min(a, b)
    return a != b


@kernel
def _descend(nearest, voxel):
    """Follow the distance down from `voxel` to its component; return the voxels (n, 3)."""
    owner, far, cost, wraps = nearest
    path = np.empty((np.int64(far[voxel[0], voxel[1], voxel[2]]) + 1, 3), np.int64)
    copy_row(path[0], voxel)
    n = 0
    while True:
        z, y, x = path[n]
        left = np.int64(far[z, y, x])
        if left == 0:
            return path[: n + 1]
        left -= np.int64(cost[z, y, x]) if cost.size else np.int64(1)
        n += 1
        for side in range(6):
            step, axis = 2 * (side % 2) - 1, side // 2
            k = place_along(z + step * (axis == 0), far.shape[0], wraps[0])
            j = place_along(y + step * (axis == 1), far.shape[1], wraps[1])
            i = place_along(x + step * (axis == 2), far.shape[2], wraps[2])
            if k < 0 or j < 0 or i < 0:
                continue
            if far[k, j, i] == left and owner[k, j, i] == owner[z, y, x]:
                path[n, 0], path[n, 1], path[n, 2] = k, j, i
                break
