"""Specks: pieces of a phase of a few voxels, where a field hardly passes its threshold. Scans have
them as well, but fewer.

A piece is taken away on the evidence of its neighbourhood alone, so that windows agree.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel

LARGEST = 2
"""Edge of the largest box, voxels, whose pieces may be taken away: none of them can hold another.
"""


def without_specks(labels: np.ndarray, edge: int) -> np.ndarray:
    """Labels without the pieces that fit into a box of `edge` voxels along every axis.

    A piece is what is joined across faces of voxels. It becomes what lies before its first voxel
    along x. Pieces that touch the border of the array stay, as nobody knows where they end.

    Parameters
    ----------
    labels : (Z, Y, X) uint8 array
    edge : int
        0 .. 2 voxels; 0 takes nothing away.

    Returns
    -------
    labels : (Z, Y, X) uint8 array
    """
    found = np.ascontiguousarray(labels).copy()
    if edge:
        _clear(np.ascontiguousarray(labels), edge, np.empty((LARGEST**3, 3), np.int64), found)
    return found


@kernel
def _clear(labels, edge, piece, found):
    """Look at every voxel that can be the first of a piece in raster order; `piece` is room for the
    voxels of one.
    """
    depth, height, width = labels.shape
    for z in range(1, depth - 1):
        for y in range(1, height - 1):
            for x in range(1, width - 1):
                label = labels[z, y, x]
                if (
                    labels[z, y, x - 1] == label
                    or labels[z, y - 1, x] == label
                    or labels[z - 1, y, x] == label
                ):
                    continue
                for number in range(_gather(labels, z, y, x, edge, piece)):
                    found[piece[number, 0], piece[number, 1], piece[number, 2]] = labels[
                        z, y, x - 1
                    ]


@inline
def _gather(labels, z, y, x, edge, piece):
    """The voxels of the piece that starts with a voxel, and their number; 0 where it starts before,
    is larger than `edge` or touches the border."""
    low, high = np.array([z, y, x]), np.array([z, y, x])
    piece[0] = low
    count, at = 1, 0
    here = np.empty(3, np.int64)
    while at < count:
        for side in range(6):
            axis = side >> 1
            here[:] = piece[at]
            here[axis] += 1 if side & 1 else -1
            if here[axis] < 0 or here[axis] == labels.shape[axis]:
                return 0
            if labels[here[0], here[1], here[2]] != labels[z, y, x]:
                continue
            known = False
            for number in range(count):
                known = known or (
                    piece[number, 0] == here[0]
                    and piece[number, 1] == here[1]
                    and piece[number, 2] == here[2]
                )
            if known:
                continue
            if here[0] < z or (here[0] == z and (here[1] < y or (here[1] == y and here[2] < x))):
                return 0
            low[axis] = min(low[axis], here[axis])
            high[axis] = max(high[axis], here[axis])
            if high[axis] - low[axis] >= edge:
                return 0
            piece[count] = here
            count += 1
        at += 1
    return count
