"""Time that a run will take: boxes of it are made for about a second, and the time of a whole block
is estimated from them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from math import prod

import numpy as np

from trabecula.engine.chunking import Box, boxes_of

LEAST = 16
"""Edge of the first box that is timed, voxels."""

_EDGES = (24, 36, 48, 72, 96, 144, 192, 288)
"""Of the volumes that are timed where no box can be made alone, voxels."""

_SECONDS = 1.0
"""After the second box the next is made where it is expected to take no longer than this."""

_WRITTEN = 30e-9
"""Seconds a voxel for packing, writing, coarser levels and digest, as measured of labels on a plain
processor.
"""


def seconds_of(
    make: Callable[[Box], np.ndarray],
    shape: Sequence[int],
    side: int,
    *,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Return the seconds that making a volume in blocks takes on this machine, as it is now.

    Parameters
    ----------
    make : Box -> array
        Makes any box of the volume.
    shape : sequence of int
        Of the volume.
    side : int
        Edge of the blocks.
    clock : function, optional
        Gives seconds.

    Notes
    -----
    A box of side s needs what is around it as well, so its time is close to c (s + h)^3. Boxes of
    sides 16, 32, ... up to the block's are timed, two at least, as long as the next one can be
    expected to take a second; c and h follow from the last two (h = 0 where the larger box was as
    expensive a voxel). Beside the boxes, what the very first call does once, and 30 ns a voxel for
    writing.
    """
    blocks = boxes_of(shape, side)
    block = max(last - first for first, last in blocks[0])
    start = clock()
    make(_box(shape, 8))
    once = clock() - start  # kernels are loaded, tables are made
    timed: list[tuple[int, float]] = []
    edge = min(LEAST, block)
    while True:
        start = clock()
        make(_box(shape, edge))
        timed.append((edge, max(clock() - start, 1e-6)))
        if edge == block or (len(timed) > 1 and 8 * timed[-1][1] > _SECONDS):
            break
        edge = min(2 * edge, block)
    total = sum(_estimate(timed, shape, box) for box in blocks)
    return once + total + _WRITTEN * prod(shape)


def seconds_of_whole(
    make: Callable[[tuple[int, ...]], object],
    shape: Sequence[int],
    *,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Return the seconds that making a volume as a whole takes on this machine, as it is now.

    Parameters
    ----------
    make : shape -> anything
        Makes a volume of any shape.
    shape : sequence of int
        Of the volume.
    clock : function, optional
        Gives seconds.

    Notes
    -----
    Volumes of edge 24, 36, 48, 72, ... are timed, two at least, as long as the next one can be
    expected to take a second; what a further voxel costs follows from the last two. Coarse levels
    that only large volumes have add little.
    """
    make(_cube(shape, _EDGES[0]))  # kernels are loaded, tables are made
    timed: list[tuple[int, float]] = []
    for edge in _EDGES:
        sides = _cube(shape, edge)
        start = clock()
        make(sides)
        timed.append((prod(sides), max(clock() - start, 1e-6)))
        if sides == tuple(shape) or (len(timed) > 1 and 3 * timed[-1][1] > _SECONDS):
            break
    (voxels, seconds), more = timed[-1], timed[-1][1] / timed[-1][0]
    if len(timed) > 1 and voxels > timed[-2][0]:
        more = max((seconds - timed[-2][1]) / (voxels - timed[-2][0]), 0.5 * more)
    return seconds + more * (prod(shape) - voxels) + _WRITTEN * prod(shape)


def _cube(shape: Sequence[int], edge: int) -> tuple[int, ...]:
    return tuple(min(edge, length) for length in shape)


def _box(shape: Sequence[int], edge: int) -> Box:
    """Return a box in the middle of a shape."""
    return tuple(
        ((length - min(edge, length)) // 2, (length + min(edge, length)) // 2) for length in shape
    )


def _estimate(timed: Sequence[tuple[int, float]], shape: Sequence[int], box: Box) -> float:
    """Return the seconds of a box, from those of boxes that were timed."""
    sides = [last - first for first, last in box]
    (edge, seconds), around = timed[-1], 0.0
    if len(timed) > 1 and len(shape) == 3 and min(shape) >= edge:
        before, quicker = timed[-2]
        ratio = (seconds / quicker) ** (1 / 3)
        if 1 < ratio < edge / before:
            around = (edge - ratio * before) / (ratio - 1)
    return seconds * prod(
        (side + around) / (min(edge, length) + around)
        for side, length in zip(sides, shape, strict=True)
    )
