"""Paths through the background that join components: as a minimum spanning tree, or each to the
body.

`cheapest_joins` finds the tree; the cost of a join is the number of background voxels that it
fills.

1. Give every voxel the number of its nearest component through the background (by faces of voxels),
   and the distance to it: two sweeps where all other voxels are background, more of them around
   closed ones.
2. Boruvka's rounds: every tree of components takes the cheapest path to another one, and the two
   are one tree from then on. Paths run where two numbers meet; that such paths hold a minimum
   spanning tree of all paths is theorem 1 of Mehlhorn 1988, doi:10.1016/0020-0190(88)90066-X.
3. Follow every path to both ends, and draw it straight between them where that is as short and
   open.

All passes run over slabs along z one after the other, and the arrays may be memory-mapped.

`shortest_join` finds the path from one component to the body, block by block. All shortest paths
from a component have an order: by the voxel that they start from, then by the side through which
each next voxel is entered. A search in a box finds the first of those inside it. A path is no
longer than `reach`, so blocks of the component, with a halo of `reach` voxels, hold every path; the
first of theirs is the first of all, and the search takes the memory of one block.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.chunking import Box, boxes_of, slices_of
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import in_order, sum_slabs
from trabecula.measure.runs import Runs
from trabecula.measure.union_find import root_of

NOWHERE = np.iinfo(np.uint16).max
"""Distance of voxels that no path reaches: one more than that of the longest path."""

SIDE = 128
"""Voxels along an edge of a block that is searched from."""

_BODY, _LOOSE, _OPEN, _CLOSED = 1, 2, 3, 4

_STEPS = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
"""Steps to the neighbours of a voxel, in the order in which they are tried."""


def cheapest_joins(
    values: np.ndarray,
    runs: Runs,
    worth: np.ndarray,
    background: int,
    inside: np.ndarray | None = None,
    wraps: Sequence[bool] = (False, False, False),
) -> list[np.ndarray]:
    """Return paths that join components through the fewest background voxels, cheapest first.

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
    open_to, around = _open_voxels(values, runs, worth, background, inside), np.array(wraps)
    owner = memmap.zeros(values.shape, np.uint16 if count < 2**16 else np.int32)
    far = memmap.empty(values.shape, np.uint16)
    seeds = (runs.first, runs.begin, runs.end, runs.label, numbers, owner, far)
    in_order(lambda start, stop: _seed(*seeds, start, stop), len(values))
    held = int(runs.sizes[worth].sum()) + sum_slabs(
        lambda a, b: np.count_nonzero(open_to[a:b]), len(values)
    )
    again = held < values.size or bool(around.any())
    _spread_owners(owner, far, open_to, around, again=again)
    sizes = np.concatenate([[0], runs.sizes[worth]])
    found = [
        _straighten(_follow(owner, far, place, axis, sizes, around), open_to)
        for place, axis in _tree(owner, far, count, around)
    ]
    return sorted(found, key=len)


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


def _spread_owners(
    owner: np.ndarray, far: np.ndarray, open_to: np.ndarray, wraps: np.ndarray, *, again: bool
) -> None:
    """Write the nearest component and the distance to it into every open voxel.

    Where no voxel is closed and no axis periodic, a shortest path never turns back along an axis,
    and one sweep in each direction finds all of them; else the two are repeated (`again`) until
    nothing changes.
    """
    depth, changed = len(owner), [True]
    while changed[0]:
        changed[0] = False

        def forward(start: int, stop: int) -> None:
            changed[0] |= bool(_sweep(owner, far, open_to, wraps, 1, start, stop))

        def backward(start: int, stop: int) -> None:
            first, last = depth - stop, depth - start
            changed[0] |= bool(_sweep(owner, far, open_to, wraps, -1, first, last))

        in_order(forward, depth)
        in_order(backward, depth)
        if not again:
            return


def _tree(
    owner: np.ndarray, far: np.ndarray, count: int, wraps: np.ndarray
) -> list[tuple[int, int]]:
    """Find the paths of the minimum spanning tree by Boruvka's rounds.

    Each is the flat index and the axis of the two neighbouring voxels at which its halves meet.
    """
    parent = np.arange(count + 1, dtype=np.int32)
    paths: list[tuple[int, int]] = []
    while True:
        cost = np.full(count + 1, 2 * NOWHERE, np.int64)
        place = np.full(count + 1, -1, np.int64)
        axis = np.zeros(count + 1, np.int64)
        in_order(partial(_cheapest, owner, far, wraps, parent, cost, place, axis), len(owner))
        before = len(paths)
        # Paths have a strict order (cost, then place and axis), so that no ring closes; two trees
        # may name the same path.
        for tree in np.flatnonzero(place >= 0):
            if _unite(owner, parent, int(place[tree]), int(axis[tree])):
                paths.append((int(place[tree]), int(axis[tree])))
        if len(paths) == before:
            return paths


def _follow(
    owner: np.ndarray, far: np.ndarray, place: int, axis: int, sizes: np.ndarray, wraps: np.ndarray
) -> np.ndarray:
    """Return a path from a voxel of the smaller of its two components to one of the larger.

    Beyond a periodic face its voxels go on: they are not taken back to the opposite one.
    """
    here = np.array(np.unravel_index(place, owner.shape), np.int64)
    there = here.copy()
    there[axis] = (there[axis] + 1) % owner.shape[axis]
    if sizes[owner[tuple(here)]] > sizes[owner[tuple(there)]]:
        here, there = there, here
    first, last = _descend(owner, far, wraps, here), _descend(owner, far, wraps, there)
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
def _seed(first, begin, end, label, numbers, owner, far, start, stop):
    """Write distance 0 and the owner into the components to join."""
    height = owner.shape[1]
    far[start:stop] = NOWHERE
    for row in range(start * height, stop * height):
        z, y = row // height, row % height
        for k in range(first[row], first[row + 1]):
            number = numbers[label[k]]
            if number:
                owner[z, y, begin[k] : end[k]] = number
                far[z, y, begin[k] : end[k]] = 0


@inline
def _step_to(place, side, wraps):
    """Return a neighbour's place along an axis, beyond a periodic face the opposite one; else -1
    beyond a face.
    """
    if place < 0:
        return side - 1 if wraps else -1
    if place == side:
        return 0 if wraps else -1
    return place


@kernel
def _sweep(owner, far, open_to, wraps, way, start, stop):
    """Propagate owners in raster order (way 1) or against it (-1); return whether any changed."""
    depth, height, width = owner.shape
    changed = False
    for i in range(stop - start):
        z = start + i if way > 0 else stop - 1 - i
        c = _step_to(z - way, depth, wraps[0])
        for j in range(height):
            y = j if way > 0 else height - 1 - j
            b = _step_to(y - way, height, wraps[1])
            for k in range(width):
                x = k if way > 0 else width - 1 - k
                if not open_to[z, y, x]:
                    continue
                best = np.int64(far[z, y, x])
                number = np.int64(owner[z, y, x])
                before = best
                a = _step_to(x - way, width, wraps[2])
                if c >= 0 and far[c, y, x] < best - 1:
                    best, number = np.int64(far[c, y, x]) + 1, np.int64(owner[c, y, x])
                if b >= 0 and far[z, b, x] < best - 1:
                    best, number = np.int64(far[z, b, x]) + 1, np.int64(owner[z, b, x])
                if a >= 0 and far[z, y, a] < best - 1:
                    best, number = np.int64(far[z, y, a]) + 1, np.int64(owner[z, y, a])
                if best < before:
                    far[z, y, x] = best
                    owner[z, y, x] = number
                    changed = True
    return changed


@kernel
def _cheapest(owner, far, wraps, parent, cost, place, axis, start, stop):
    """Find, for every tree of components, the first of the cheapest paths to another tree."""
    depth, height, width = owner.shape
    for z in range(start, stop):
        below = _step_to(z + 1, depth, wraps[0])
        for y in range(height):
            behind = _step_to(y + 1, height, wraps[1])
            for x in range(width):
                here = owner[z, y, x]
                if here == 0:
                    continue
                beside = _step_to(x + 1, width, wraps[2])
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
def _descend(owner, far, wraps, voxel):
    """Follow the distance down from `voxel` to its component; return the voxels (n, 3)."""
    length = np.int64(far[voxel[0], voxel[1], voxel[2]])
    path = np.empty((length + 1, 3), np.int64)
    path[0] = voxel
    for n in range(1, length + 1):
        z, y, x = path[n - 1]
        for side in range(6):
            step, axis = 2 * (side % 2) - 1, side // 2
            k = _step_to(z + step * (axis == 0), far.shape[0], wraps[0])
            j = _step_to(y + step * (axis == 1), far.shape[1], wraps[1])
            i = _step_to(x + step * (axis == 2), far.shape[2], wraps[2])
            if k < 0 or j < 0 or i < 0:
                continue
            if far[k, j, i] == length - n and owner[k, j, i] == owner[z, y, x]:
                path[n, 0], path[n, 1], path[n, 2] = k, j, i
                break
    return path


def shortest_join(
    values: np.ndarray,
    runs: Runs,
    bounds: Sequence[int],
    component: int,
    body: int,
    background: int,
    worth: np.ndarray,
    reach: int,
    inside: np.ndarray | None = None,
) -> np.ndarray:
    """Return the first of the shortest paths (n, 3), beginning with a voxel of the component.

    Empty where it is longer than `reach`.

    Parameters
    ----------
    values : (Z, Y, X) labels
    runs : Runs
        Their components.
    bounds : six ints
        The component's first voxel and the one past its last, along z, y, x.
    component, body : int
        Numbers of the two components.
    background : int
        Label that the path runs through.
    worth : (n + 1,) bool
        True for components that will stay; element 0 is of no component.
    reach : int
        Longest path, in voxels of background.
    inside : (Z, Y, X) bool, optional
        Voxels that paths may run through. Default: all.
    """
    best: tuple[tuple[int, ...], np.ndarray] | None = None
    low = np.array(bounds[:3])
    cores = boxes_of(
        [stop - start for start, stop in zip(bounds[:3], bounds[3:], strict=True)], SIDE
    )
    for core in cores:
        box = _around(core, low, reach + 1, values.shape)
        state = _states(
            runs.labels(box), values[slices_of(box)], component, body, background, worth
        )
        if inside is not None:
            state[(state == _OPEN) & ~inside[slices_of(box)]] = _CLOSED
        path = _shortest_path(state, reach) + np.array([start for start, _ in box])
        if len(cores) > 1:
            memmap.release_pages()
        if len(path) and (best is None or _order(path) < best[0]):
            best, reach = (_order(path), path), len(path) - 1
    return np.empty((0, 3), np.int64) if best is None else best[1]


def search_bytes(shape: Sequence[int], reach: int) -> int:
    """Return the memory of a search."""
    sides = [min(side, SIDE + 2 * (reach + 1)) for side in shape]
    return 24 * int(np.prod(sides, dtype=np.int64))


def _around(core: Box, low: np.ndarray, margin: int, shape: Sequence[int]) -> Box:
    """Return a block that is counted from `low`, with a margin clipped to the volume."""
    ends = zip(core, low.tolist(), shape, strict=True)
    return tuple(
        (max(low + first - margin, 0), min(low + last + margin, side))
        for (first, last), low, side in ends
    )


def _order(path: np.ndarray) -> tuple[int, ...]:
    """Return the sort key of a path: its length, its start, the sides that it takes."""
    sides = [_STEPS.index(tuple(step)) for step in np.diff(path, axis=0).tolist()]
    return (len(path), *path[0].tolist(), *sides)


def _states(
    labels: np.ndarray,
    values: np.ndarray,
    component: int,
    body: int,
    background: int,
    worth: np.ndarray,
) -> np.ndarray:
    """Return the state of every voxel in the search.

    Specks are open, as they will be removed; other components and phases are closed.
    """
    state = np.where(worth[labels] | (values != background), np.uint8(_CLOSED), np.uint8(_OPEN))
    state[(labels > 0) & ~worth[labels]] = _OPEN
    state[labels == component] = _LOOSE
    state[labels == body] = _BODY
    return state


@kernel
def _shortest_path(state, reach):
    """Find the open voxels (n, 3) from the loose component to the body, breadth first.

    The first voxel is one of the component. Empty where the path is longer than `reach`.
    """
    depth, height, width = state.shape
    step = np.array([height * width, -height * width, width, -width, 1, -1])
    flat = state.copy().ravel()
    queue = np.empty(len(flat), np.int64)
    origin = np.empty(len(flat), np.int64)  # place in the queue from which a voxel was reached
    count = 0
    for at in range(len(flat)):
        if flat[at] == _LOOSE:
            queue[count] = at
            origin[count] = -1
            count += 1
    head, end, length = 0, count, 0
    while head < count:
        if head == end:
            length, end = length + 1, count
            if length > reach:
                break
        at = queue[head]
        z, y, x = at // (height * width), at // width % height, at % width
        there = (z + 1 < depth, z > 0, y + 1 < height, y > 0, x + 1 < width, x > 0)
        for side in range(6):
            if not there[side]:
                continue
            other = at + step[side]
            if flat[other] == _BODY and length > 0:
                path = np.empty((length + 1, 3), np.int64)
                k = head
                for row in range(length, -1, -1):
                    path[row] = (
                        queue[k] // (height * width),
                        queue[k] // width % height,
                        queue[k] % width,
                    )
                    k = origin[k]
                return path
            if flat[other] == _OPEN:
                flat[other] = _CLOSED
                queue[count] = other
                origin[count] = head
                count += 1
        head += 1
    return np.empty((0, 3), np.int64)
