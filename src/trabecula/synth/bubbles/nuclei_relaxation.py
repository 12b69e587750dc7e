"""Kernels of what bubbles do to each other before they grow: nudge apart, and swallow.

Both look at the cells next to a bubble's own, and read only what was drawn: a bubble's lot is the
same in every box.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel


@inline
def _ends(at, count, near):
    """The cells from `near` before to `near` behind one, as far as there are any."""
    return max(at - near, 0), min(at + near, count - 1) + 1


@kernel
def nudge(moved, places, starts, cells, near, apart, push):
    """Move bubbles (N, 3), in whole parts of a voxel, away from those nearer than `apart`: by
    `push` at most, in all.

    Each pushes along the line between both, with 1 - distance / apart.
    """
    for z in range(cells[0]):
        for y in range(cells[1]):
            for x in range(cells[2]):
                row = (z * cells[1] + y) * cells[2] + x
                for i in range(starts[row], starts[row + 1]):
                    az, ay, ax = 0.0, 0.0, 0.0
                    for m in range(*_ends(z, cells[0], near[0])):
                        for n in range(*_ends(y, cells[1], near[1])):
                            low, high = _ends(x, cells[2], near[2])
                            line = (m * cells[1] + n) * cells[2]
                            for j in range(starts[line + low], starts[line + high]):
                                dz = np.float64(places[i, 0] - places[j, 0])
                                dy = np.float64(places[i, 1] - places[j, 1])
                                dx = np.float64(places[i, 2] - places[j, 2])
                                off = np.sqrt(dz * dz + dy * dy + dx * dx)
                                if 0 < off < apart:
                                    force = (1.0 / off - 1.0 / apart) * push
                                    az, ay, ax = az + dz * force, ay + dy * force, ax + dx * force
                    far = np.sqrt(az * az + ay * ay + ax * ax)
                    less = push / far if far > push else 1.0
                    moved[i, 0] = places[i, 0] + np.int64(np.floor(az * less + 0.5))
                    moved[i, 1] = places[i, 1] + np.int64(np.floor(ay * less + 0.5))
                    moved[i, 2] = places[i, 2] + np.int64(np.floor(ax * less + 0.5))


@kernel
def swallow(alive, places, brakes, starts, cells, near, least, touch):
    """Which bubbles live: not those that a faster one encloses in a ball of a radius below `least`,
    or that start in its wall.

    Where two alone grow from places d apart, the slower one's part is a ball of radius d k / (k^2 -
    1), k the ratio of speeds.
    """
    for z in range(cells[0]):
        for y in range(cells[1]):
            for x in range(cells[2]):
                row = (z * cells[1] + y) * cells[2] + x
                for i in range(starts[row], starts[row + 1]):
                    alive[i] = True
                    for m in range(*_ends(z, cells[0], near[0])):
                        for n in range(*_ends(y, cells[1], near[1])):
                            low, high = _ends(x, cells[2], near[2])
                            line = (m * cells[1] + n) * cells[2]
                            for j in range(starts[line + low], starts[line + high]):
                                if brakes[j] < brakes[i]:
                                    ratio = brakes[i] / brakes[j]
                                    dz = np.float64(places[i, 0] - places[j, 0])
                                    dy = np.float64(places[i, 1] - places[j, 1])
                                    dx = np.float64(places[i, 2] - places[j, 2])
                                    off = np.sqrt(dz * dz + dy * dy + dx * dx)
                                    if off < touch or off * ratio < least * (ratio * ratio - 1.0):
                                        alive[i] = False
