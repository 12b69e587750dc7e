"""Paths through the background from one component to the body, the shortest within a reach
(`measure.joins` has the minimum spanning tree of all).

`shortest_join` finds the path block by block. All shortest paths
from a component have an order: by the voxel that they start from, then by the side through which
each next voxel is entered. A search in a box finds the first of those inside it. A path is no
longer than `reach`, so blocks of the component, with a halo of `reach` voxels, hold every path; the
first of theirs is the first of all, and the search takes the memory of one block.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.chunking import Box, boxes_of, slices_of
from trabecula.engine.compile import kernel
from trabecula.engine.rows import copy_row
from trabecula.measure.runs import Runs

SIDE = 128
"""Voxels along an edge of a block that is searched from."""

_BODY, _LOOSE, _OPEN, _CLOSED = 1, 2, 3, 4

_STEPS = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
"""Steps to the neighbours of a voxel, in the order in which they are tried."""


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
