"""Kernels of growth by particles: what every contour position asks for, who wins, and what the
winners reach next.

Volumes are (Z, Y, X), pictures (1, Y, X); positions are flat indices. `near` holds, for every
voxel, the one bubble that it is within the separation of, FREE, or SHARED between several; `claim`
the bubble that asks for it in this round.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.random import below, philox

FREE, SHARED = -1, -2


@inline
def _moved(place, step, sides, wraps):
    """The flat index `step` away from a place (z, y, x), or -1 outside."""
    index = 0
    for axis in range(3):
        at = place[axis] + step[axis]
        side = sides[axis]
        if at < 0 or at >= side:
            if not wraps[axis]:
                return -1
            at %= side
        index = index * side + at
    return index


@inline
def _place(index, sides):
    across = sides[1] * sides[2]
    return index // across, index // sides[2] % sides[1], index % sides[2]


@kernel
def draw(rank, key):
    """Ranks of the bubbles for a round: by chance, no two alike."""
    for i in range(len(rank)):
        rank[i] = np.int64(philox(key, i, 0, 0, 0)[0]) << 31 | i


@kernel
def ask(positions, bubbles, rank, near, claim, keep):
    """Every contour position asks for its voxel; of several the lowest rank is noted. `keep` is
    False where none can.

    The same wish twice is kept once: the second finds the first.
    """
    for k in range(len(positions)):
        v, i = positions[k], bubbles[k]
        keep[k] = (near[v] == FREE or near[v] == i) and claim[v] != i
        if keep[k] and (claim[v] == FREE or rank[i] < rank[claim[v]]):
            claim[v] = i


@kernel
def judge(positions, bubbles, rank, claim, ball, sides, wraps, keep, won):
    """A wish is granted where no other bubble of lower rank asks for a voxel within the separation."""
    for k in range(len(positions)):
        v, i = positions[k], bubbles[k]
        won[k] = keep[k] and claim[v] == i
        if not won[k]:
            continue
        place = _place(v, sides)
        for b in range(len(ball)):
            w = _moved(place, ball[b], sides, wraps)
            if w >= 0 and claim[w] >= 0 and claim[w] != i and rank[claim[w]] < rank[i]:
                won[k] = False
                break


@kernel
def occupy(positions, bubbles, won, near, ball, sides, wraps, open_):
    """Winners take their voxels: these are air, and what lies within the separation is closed to
    every other bubble.
    """
    for k in range(len(positions)):
        if not won[k]:
            continue
        i = bubbles[k]
        open_[positions[k]] = 1
        place = _place(positions[k], sides)
        for b in range(len(ball)):
            w = _moved(place, ball[b], sides, wraps)
            if w >= 0 and near[w] != i:
                near[w] = i if near[w] == FREE else SHARED


@kernel
def spread(
    positions,
    bubbles,
    won,
    directions,
    allowed,
    threshold,
    steps,
    sides,
    wraps,
    open_,
    key,
    found,
    owner,
):
    """The neighbours that winners add to their contours (algorithm 2): the one along the flow, and
    others by chance.

    Returns how many were written to `found` and `owner`. Without a direction every neighbour is
    added (algorithm 1).
    """
    count = 0
    ahead = np.zeros(3, np.int64)
    for k in range(len(positions)):
        if not won[k]:
            continue
        v = positions[k]
        place = _place(v, sides)
        flows = _ahead(directions, v, ahead, key)
        for s in range(len(steps)):
            w = _moved(place, steps[s], sides, wraps)
            if w < 0 or open_[w] or not allowed[w]:
                continue
            along = steps[s, 0] == ahead[0] and steps[s, 1] == ahead[1] and steps[s, 2] == ahead[2]
            if flows and not along and philox(key, v & 0xFFFFFFFF, v >> 32, s, 0)[0] >= threshold:
                continue
            found[count] = w
            owner[count] = bubbles[k]
            count += 1
    return count


@inline
def _ahead(directions, v, ahead, key):
    """The neighbour that the flow leads to, drawn so that steps follow its direction on average;
    False without a flow.

    The nearest neighbour of the solution, as the paper takes it, turns all directions into
    multiples of 45 degrees.
    """
    if directions.shape[0] == 0:
        return False
    axes = directions.shape[1]
    most = 0
    for a in range(axes):
        most = max(most, abs(int(directions[v, a])))
    words = philox(key, v & 0xFFFFFFFF, v >> 32, 0, 1)
    ahead[:] = 0
    for a in range(axes):
        size = np.int64(directions[v, a])
        if most > 0 and below(words[a], most) < abs(size):
            ahead[3 - axes + a] = 1 if size > 0 else -1
    return most > 0
