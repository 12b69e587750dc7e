"""The shortest way from a loose part to the body, through the background: breadth first, block by
block.

All shortest ways from a part have an order: by the voxel that they start from, then by the side by
which each next voxel is entered. A search in a box finds the first of those inside it. A way is no
longer than `reach`, so blocks of the part, with so many voxels around, hold every way; the first of
theirs is the first of all, and the search takes the memory of a block.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.chunking import Box, boxes_of, slices_of
from trabecula.engine.compile import kernel
from trabecula.measure.runs import Runs

SIDE = 128
"""Voxels along an edge of a block that is searched from."""

_BODY, _LOOSE, _OPEN, _CLOSED = 1, 2, 3, 4

_STEPS = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
"""To the sides of a voxel, in the order in which they are tried."""


def shortest_join(
    values: np.ndarray,
    runs: Runs,
    bounds: Sequence[int],
    part: int,
    body: int,
    background: int,
    worth: np.ndarray,
    reach: int,
    inside: np.ndarray | None = None,
) -> np.ndarray:
    """Voxels (n, 3) of the first of the shortest ways, before them the voxel of the part that it
    starts from.

    Empty where more than `reach` would be needed.

    Parameters
    ----------
    values : (Z, Y, X) labels
    runs : Runs
        Their components.
    bounds : six ints
        The part's first voxel and the one past its last, along z, y, x.
    part, body : int
        Components.
    background : int
        Label of what the way goes through.
    worth : (n + 1,) bool
        Of every component and of none: whether it will stay.
    reach : int
    inside : (Z, Y, X) bool, optional
        Where ways may run. Default: everywhere.
    """
    best: tuple[tuple[int, ...], np.ndarray] | None = None
    low = np.array(bounds[:3])
    cores = boxes_of(
        [stop - start for start, stop in zip(bounds[:3], bounds[3:], strict=True)], SIDE
    )
    for core in cores:
        box = _around(core, low, reach + 1, values.shape)
        state = _states(runs.labels(box), values[slices_of(box)], part, body, background, worth)
        if inside is not None:
            state[(state == _OPEN) & ~inside[slices_of(box)]] = _CLOSED
        path = _shortest_path(state, reach) + np.array([start for start, _ in box])
        if len(cores) > 1:
            memmap.release_pages()
        if len(path) and (best is None or _order(path) < best[0]):
            best, reach = (_order(path), path), len(path) - 1
    return np.empty((0, 3), np.int64) if best is None else best[1]


def search_bytes(shape: Sequence[int], reach: int) -> int:
    """Memory that a search takes."""
    sides = [min(side, SIDE + 2 * (reach + 1)) for side in shape]
    return 24 * int(np.prod(sides, dtype=np.int64))


def _around(core: Box, low: np.ndarray, margin: int, shape: Sequence[int]) -> Box:
    """A block that is counted from `low`, with a margin as far as there are voxels."""
    ends = zip(core, low.tolist(), shape, strict=True)
    return tuple(
        (max(low + first - margin, 0), min(low + last + margin, side))
        for (first, last), low, side in ends
    )


def _order(path: np.ndarray) -> tuple[int, ...]:
    """What sorts ways: their length, where they start, the sides that they take."""
    sides = [_STEPS.index(tuple(step)) for step in np.diff(path, axis=0).tolist()]
    return (len(path), *path[0].tolist(), *sides)


def _states(
    labels: np.ndarray, values: np.ndarray, part: int, body: int, background: int, worth: np.ndarray
) -> np.ndarray:
    """What a voxel is to the search. Specks are open, as they will be removed; other parts and
    phases are closed.
    """
    state = np.where(worth[labels] | (values != background), np.uint8(_CLOSED), np.uint8(_OPEN))
    state[(labels > 0) & ~worth[labels]] = _OPEN
    state[labels == part] = _LOOSE
    state[labels == body] = _BODY
    return state


@kernel
def _shortest_path(state, reach):
    """Open voxels (n, 3) that lead from the loose part to the body, breadth first; before them the
    voxel they start from.

    Empty where more than `reach` would be needed.
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
