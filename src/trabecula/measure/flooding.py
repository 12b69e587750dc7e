"""Widest paths: for every voxel the best of all paths from some seeds, where a path is as good as
its worst voxel.

The values are whole numbers (ranks), so that the front is a queue for each of them, taken from the
highest down: a priority flood (Barnes et al. 2014, doi:10.1016/j.cageo.2013.04.024). A voxel is
reached for the first time by its best path, hence every voxel is visited once.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.measure.neighbours import voxel_at


def widest_paths(
    rank: np.ndarray, seeds: np.ndarray, *, top: int, connectivity: int, wraps: tuple[bool, ...]
) -> np.ndarray:
    """Return for every voxel the largest rank that a path from a seed can keep up.

    Parameters
    ----------
    rank : int32 array, (Z, Y, X)
        From 1 to `top`; 0 where no path leads.
    seeds : bool array, (Z, Y, X)
        Where paths start, as far as the rank is not 0.
    top : int
    connectivity : {4, 6, 8, 18, 26}
    wraps : three bool
        Paths lead through the faces of these axes.

    Returns
    -------
    best : int32 array, (Z, Y, X)
        The lowest rank along the best path, both ends included; 0 where there is none.
    """
    reach = {4: 1, 6: 1, 8: 2, 18: 2, 26: 3}[connectivity]
    steps = np.array([s for s in product((-1, 0, 1), repeat=3) if 0 < sum(map(abs, s)) <= reach])
    best = np.zeros(rank.shape, np.int32)
    head = np.full(top + 1, -1, np.int64)
    following = np.empty(rank.size, np.int32 if rank.size < 2**31 else np.int64)
    _flood(rank, seeds, steps, np.array(wraps), head, following, best)
    return best


@kernel
def _flood(rank, seeds, steps, wraps, head, following, best):
    """Take the front from the highest rank down. `head` and `following` are linked lists of the
    voxels of a level: best[voxel].
    """
    _, height, width = rank.shape
    levels, starts, reached = rank.ravel(), seeds.ravel(), best.ravel()
    for voxel in range(rank.size):
        level = levels[voxel]
        if level > 0 and starts[voxel]:
            reached[voxel] = level
            following[voxel] = head[level]
            head[level] = voxel
    for level in range(len(head) - 1, 0, -1):
        while head[level] >= 0:
            voxel = head[level]
            head[level] = following[voxel]
            row = voxel // width
            x0 = voxel - row * width
            z0 = row // height
            y0 = row - z0 * height
            for step in range(len(steps)):
                z, y, x = z0 + steps[step, 0], y0 + steps[step, 1], x0 + steps[step, 2]
                other = voxel_at(z, y, x, rank.shape, wraps)
                if other >= 0 and levels[other] > 0 and reached[other] == 0:
                    to = min(levels[other], level)
                    reached[other] = to
                    following[other] = head[to]
                    head[to] = other
