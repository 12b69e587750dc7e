"""Places that push each other apart, step by step."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from trabecula.core.progress import track
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_items

_GROWN = 0.5  # of the steps, until places push over their whole distance
_RENEW = 5  # steps with one list of neighbours
_DONE = 0.005  # of their size that places lack on average, where steps end


def push_apart(
    places: np.ndarray,
    near: Callable[[np.ndarray], np.ndarray],
    push: Callable[[np.ndarray, float], Callable[[np.ndarray, np.ndarray, int, int], object]],
    moved: Callable[[np.ndarray, np.ndarray], np.ndarray],
    *,
    steps: int,
    size: float,
    label: str,
) -> tuple[np.ndarray, float]:
    """Push places apart, over half of their distances first and over all of them from half of the
    steps on.

    Parameters
    ----------
    places : (n, 3) float64
    near : callable
        Of places: pairs of those that may push each other, (P, 2) int64.
    push : callable
        Of places, and the share of their distances: a kernel that writes for pairs start..stop into
        pushes (P, 4) the move of the second place, and what the two lack of their distance.
    moved : callable
        Of places and moves: the places after these.
    steps : int
        At most.
    size : float
        Of all places together: what they lack is over it.
    label : str
        Of the progress; empty for none.

    Returns
    -------
    places : (n, 3) float64
    lacking : float
        What places lack of their distances, over their size.
    """
    pairs, lacking = np.empty((0, 2), np.int64), 0.0
    for number in track(range(steps), label) if label else range(steps):
        if number % _RENEW == 0:
            pairs = near(places)
        grown = min(1.0, 0.5 + 0.5 * number / (_GROWN * steps))
        pushes = np.empty((len(pairs), 4))
        for_items(partial(push(places, grown), pairs, pushes), len(pairs), least=512)
        lacking = float(pushes[:, 3].sum()) / size
        if grown == 1 and lacking < _DONE:
            break
        moves = np.zeros_like(places)
        _add_pushes(pairs, pushes, moves)
        places = moved(places, moves)
    return places, lacking


@inline
def write_push(push, far, dz, dy, dx, length):
    """Write the move (3) by so far along a way of this length."""
    push[0], push[1], push[2] = far * dz / length, far * dy / length, far * dx / length


@kernel
def _add_pushes(pairs, pushes, moves):
    """Add the pushes (P, 3 or more) to the moves (n, 3) of both of every pair, in their order: away
    for the second, back for the first.
    """
    for k in range(len(pairs)):
        i, j = pairs[k]
        for axis in range(3):
            moves[i, axis] -= pushes[k, axis]
            moves[j, axis] += pushes[k, axis]
