"""Joins of components to the body, the largest of them, through the background within a reach
(`measure.joins` has the minimum spanning tree of all, at any distance).

Each is found block by block. All shortest paths from a component have an order: by the voxel that
they start from, then by the side through which each next voxel is entered. A search in a box finds
the first of those inside it. A path is no longer than `reach`, so blocks of the component, with a
halo of `reach` voxels, hold every path; the first of theirs is the first of all, and the search
takes the memory of one block.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.chunking import Box, boxes_of, slices_of
from trabecula.engine.compile import kernel
from trabecula.engine.rows import copy_row
from trabecula.measure.runs import Runs

SIDE = 128
"""Voxels along an edge of a block that is searched from, where no other is named."""

JOINED_AT_ONCE = 32
"""Components that are joined before pages of memory-mapped arrays are released."""

_BODY, _LOOSE, _OPEN, _CLOSED = 1, 2, 3, 4

_STEPS = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
"""Steps to the neighbours of a voxel, in the order in which they are tried."""


def join_near(
    values: np.ndarray,
    runs: Runs,
    again: Callable[[], Runs],
    background: int,
    *,
    reach: int,
    brush: int,
    least: int,
    inside: np.ndarray | None = None,
    side: int | None = None,
) -> tuple[dict[str, int], Runs]:
    """Join the components within reach of the largest one, in place, until none is within reach.

    Parameters
    ----------
    values : (Z, Y, X) uint8 labels
    runs : Runs
        Their components.
    again : callable
        Returns those of the values as they are.
    background : int
        Label that joins run through.
    reach : int
        Longest join, in voxels of background.
    brush : int
        Thickness of a join, in voxels.
    least : int
        Voxels of a component that is joined.
    inside : (Z, Y, X) bool, optional
        Voxels that joins may fill. Default: all.
    side : int, optional
        Voxels along an edge of a block that is searched from: the smaller, the less memory.
        Default: `SIDE`.

    Returns
    -------
    found : dict
        `joins`, `added` (voxels that they fill) and `longest` (voxels of background along it).
    runs : Runs
        The components afterwards.
    """
    found = {"joins": 0, "added": 0, "longest": 0}
    while True:
        joins, filled, longest = _join_each(
            values,
            runs,
            background,
            reach=reach,
            brush=brush,
            least=least,
            inside=inside,
            side=side or SIDE,
        )
        if not joins:
            return found, runs
        found = {
            "joins": found["joins"] + joins,
            "added": found["added"] + filled,
            "longest": max(found["longest"], longest),
        }
        del runs  # before the next ones are allocated
        runs = again()


def _join_each(
    values: np.ndarray,
    runs: Runs,
    background: int,
    *,
    reach: int,
    brush: int,
    least: int,
    inside: np.ndarray | None,
    side: int,
) -> tuple[int, int, int]:
    """Join every component within reach of the body, in place.

    Returns the number of joins, the voxels filled, and the length of the longest join.
    """
    if len(runs.sizes) < 2:
        return 0, 0, 0
    body = int(np.argmax(runs.sizes)) + 1
    chosen = runs.sizes >= least
    chosen[body - 1] = False
    if not chosen.any() or reach == 0:
        return 0, 0, 0
    worth = np.concatenate([[False], chosen])
    joins = filled = longest = 0
    for number, (component, bounds) in enumerate(
        zip(np.flatnonzero(chosen) + 1, runs.boxes(chosen).tolist(), strict=True)
    ):
        path = _shortest_join(
            values,
            runs,
            bounds,
            (component, body),
            background,
            worth,
            reach=reach,
            inside=inside,
            side=side,
        )
        if len(path):
            joins += 1
            filled += fill_path(values, path, background, brush, inside)
            longest = max(longest, len(path) - 1)
        if number % JOINED_AT_ONCE == 0:
            memmap.release_pages()
    return joins, filled, longest


def fill_path(
    values: np.ndarray,
    path: np.ndarray,
    background: int,
    brush: int,
    inside: np.ndarray | None = None,
    wraps: Sequence[bool] = (False, False, False),
) -> int:
    """Paint a path (n, 3) with a cube of side `brush` in the label of its first voxel, in place;
    return the voxels painted.

    Only background is painted over, nothing that is not `inside`, and beyond a face only where it
    is periodic.
    """
    where = np.empty((0, 0, 0), np.bool_) if inside is None else inside
    return int(_fill(values, path, background, brush, where, np.array(wraps)))


def _shortest_join(
    values: np.ndarray,
    runs: Runs,
    bounds: Sequence[int],
    ends: tuple[int, int],
    background: int,
    worth: np.ndarray,
    *,
    reach: int,
    inside: np.ndarray | None,
    side: int,
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
    ends : two ints
        Numbers of the component and of the body.
    background : int
        Label that the path runs through.
    worth : (n + 1,) bool
        True for components that will stay; element 0 is of no component.
    reach : int
        Longest path, in voxels of background.
    inside : (Z, Y, X) bool, or None
        Voxels that paths may run through; None: all.
    side : int
        Voxels along an edge of a block.
    """
    best: tuple[tuple[int, ...], np.ndarray] | None = None
    low = np.array(bounds[:3])
    cores = boxes_of(
        [stop - start for start, stop in zip(bounds[:3], bounds[3:], strict=True)], side
    )
    for core in cores:
        box = _around(core, low, reach + 1, values.shape)
        state = _states(runs.labels(box), values[slices_of(box)], *ends, background, worth)
        if inside is not None:
            state[(state == _OPEN) & ~inside[slices_of(box)]] = _CLOSED
        path = _shortest_path(state, reach) + np.array([start for start, _ in box])
        if len(cores) > 1:
            memmap.release_pages()
        if len(path) and (best is None or _order(path) < best[0]):
            best, reach = (_order(path), path), len(path) - 1
    return np.empty((0, 3), np.int64) if best is None else best[1]


def search_bytes(shape: Sequence[int], reach: int, side: int | None = None) -> int:
    """Return the memory of a search."""
    most = (side or SIDE) + 2 * (reach + 1)
    sides = [min(have, most) for have in shape]
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
                    v = queue[k]
                    copy_row(path[row], (v // (height * width), v // width % height, v % width))
                    k = origin[k]
                return path
            if flat[other] == _OPEN:
                flat[other] = _CLOSED
                queue[count] = other
                origin[count] = head
                count += 1
        head += 1
    return np.empty((0, 3), np.int64)


@kernel
def _fill(values, path, background, brush, inside, wraps):
    """Paint a path as `fill_path` does; an empty `inside` means everywhere."""
    depth, height, width = values.shape
    label = values[path[0, 0], path[0, 1], path[0, 2]]
    before = (brush - 1) // 2
    filled = 0
    for n in range(1, len(path)):
        first = path[n] - before
        for c in range(first[0], first[0] + brush):
            if not (wraps[0] or 0 <= c < depth):
                continue
            for b in range(first[1], first[1] + brush):
                if not (wraps[1] or 0 <= b < height):
                    continue
                for a in range(first[2], first[2] + brush):
                    if not (wraps[2] or 0 <= a < width):
                        continue
                    z, y, x = c % depth, b % height, a % width
                    if values[z, y, x] == background and (inside.size == 0 or inside[z, y, x]):
                        values[z, y, x] = label
                        filled += 1
    return filled
