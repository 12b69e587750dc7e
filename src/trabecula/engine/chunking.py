"""Boxes of a volume, and the order in which they are made."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

Box = tuple[tuple[int, int], ...]
"""First voxel and the one after the last, along every axis."""


class Task(NamedTuple):
    """A box of a level to make: of level 0 by a method, of the others from the level below."""

    level: int
    box: Box


def boxes_of(shape: Sequence[int], side: int) -> list[Box]:
    """Return the blocks of `side` voxels that cover a shape; the last along an axis holds what
    remains.

    Examples
    --------
    >>> boxes_of((2, 5), 3)
    [((0, 2), (0, 3)), ((0, 2), (3, 5))]
    """
    cuts = [[(first, min(first + side, end)) for first in range(0, end, side)] for end in shape]
    return list(product(*cuts))


def slices_of(box: Box) -> tuple[slice, ...]:
    """Return the slices that cut a box out of an array."""
    return tuple(slice(first, last) for first, last in box)


def tasks_of(shapes: Sequence[Sequence[int]], *, side: int, chunk: int) -> list[Task]:
    """Return the tasks for levels of these shapes, each after the tasks that it depends on.

    Parameters
    ----------
    shapes : sequence of shapes
        Of the levels, each half the one before.
    side : int
        Edge of the blocks of level 0.
    chunk : int
        Edge of those of the others.
    """
    last = [-(-length // side) - 1 for length in shapes[0]]

    def place(task: Task) -> tuple[int, int]:
        """Return the number of the last block of level 0 that a task covers, then its level."""
        ends = [
            min(((end << task.level) - 1) // side, most)
            for (_, end), most in zip(task.box, last, strict=True)
        ]
        return int(np.ravel_multi_index(ends, [most + 1 for most in last])), task.level

    blocks = [Task(0, box) for box in boxes_of(shapes[0], side)]
    coarser = [
        Task(level, box)
        for level in range(1, len(shapes))
        for box in boxes_of(shapes[level], chunk)
    ]
    return sorted([*blocks, *coarser], key=place)


def sources_of(
    tasks: Sequence[Task], shapes: Sequence[Sequence[int]], *, side: int, chunk: int
) -> list[list[int]]:
    """Return for each task the places in the list of the tasks that it depends on; arguments as for
    `tasks_of`.
    """
    places = {
        (task.level, tuple(first for first, _ in task.box)): place
        for place, task in enumerate(tasks)
    }
    found: list[list[int]] = []
    for level, box in tasks:
        cells = (
            cells_of(below(box, shapes[level - 1]), side if level == 1 else chunk) if level else []
        )
        found.append([places[level - 1, cell] for cell in cells if (level - 1, cell) in places])
    return found


def below(box: Box, shape: Sequence[int]) -> Box:
    """Return the box of the level below, of this shape, that a box of a level averages."""
    return tuple(
        (2 * first, min(2 * last, side)) for (first, last), side in zip(box, shape, strict=True)
    )


def cells_of(box: Box, side: int) -> list[tuple[int, ...]]:
    """Return the first voxels of the cubes of a grid, of edge `side`, that a box meets."""
    return list(product(*(range(first // side * side, last, side) for first, last in box)))
