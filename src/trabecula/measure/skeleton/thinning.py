"""Thinning: peel a phase to lines one voxel wide without changing its topology.

Lee, Kashyap and Chu 1994, "Building skeleton models via 3-D medial surface/axis thinning
algorithms", doi:10.1006/cgip.1994.1042. An iteration has six sub-iterations, one for the border of
each direction:

1. candidates: voxels whose neighbour in that direction is outside, that are simple, and no end of a
   line;
2. one after another each candidate is looked at again, as others have gone in the meantime, and
   removed.

The second look tests the Euler number too, not the connectivity alone, so the topology is kept
whatever the order. Only voxels of the border are visited, and of those only what has changed around
since the last time.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image
from trabecula.engine.compile import kernel
from trabecula.measure.phases import as_inside, indicator
from trabecula.measure.skeleton.simple import (
    around,
    euler_changes,
    is_end,
    is_simple,
    neighbourhood,
)

_INSIDE, _LISTED, _SETTLED = 1, 2, 4
_UNSETTLED = 255 - _SETTLED


def thin(image: Image | ArrayLike, *, phase: str | int | None = None) -> np.ndarray:
    """Thin a phase to its skeleton: lines one voxel wide along its medial axis.

    Lee, Kashyap and Chu 1994 (doi:10.1006/cgip.1994.1042), section 4, with 26 neighbours inside and
    6 outside.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".

    Returns
    -------
    skeleton : bool array, the image's shape
        Has the components, tunnels and cavities of the phase. Around a cavity a shell of one voxel
        remains. What is beyond the faces counts as outside, so a strut that a face cuts may end
        up to its radius before the face.

    Raises
    ------
    InputError
        Not labels, or no such phase.

    Notes
    -----
    Thinning what is thin changes nothing. Voxels are peeled layer by layer in voxels, whatever the
    spacing.

    Examples
    --------
    >>> bar = np.zeros((5, 9), int)
    >>> bar[1:4, 1:8] = 1
    >>> thin(bar)[2].astype(int).tolist()
    [0, 1, 1, 1, 1, 1, 1, 1, 0]
    """
    image, inside = indicator(image, phase)
    return thin_array(inside)


def thin_array(inside: np.ndarray) -> np.ndarray:
    """Apply `thin` to a boolean array, (Z, Y, X) or (Y, X)."""
    state = np.pad(as_inside(inside), 1).view(np.uint8)
    _, height, width = state.shape
    steps = np.array([-height * width, height * width, -width, width, -1, 1])
    # A slice of a 2-D image has its whole face open: peeling from there would not keep the middle.
    sides = steps if inside.ndim == 3 else steps[2:]
    _peel(state.reshape(-1), sides, around(state.shape), euler_changes())
    kept = (state[1:-1, 1:-1, 1:-1] & _INSIDE).astype(bool)
    return kept.reshape(inside.shape)


@kernel
def _peel(state, sides, steps, changes):
    count = 0
    for at in range(len(state)):
        count += state[at] == _INSIDE
    border = np.empty(count, np.int64)
    chosen = np.empty(count, np.int64)
    count = 0
    for at in range(len(state)):
        if state[at] & _INSIDE:
            for side in sides:
                if not state[at + side] & _INSIDE:
                    border[count] = at
                    count += 1
                    state[at] |= _LISTED
                    break
    removed = 1
    while removed > 0:
        removed = 0
        for side in sides:
            candidates = _candidates(state, border, count, side, steps, changes, chosen)
            for n in range(candidates):
                at = chosen[n]
                # Whether it is an end by now is not asked: a pimple of the surface, whose
                # neighbours have just gone, would become a branch.
                if not is_simple(neighbourhood(state, at, steps), changes):
                    continue
                removed += 1
                state[at] = 0
                for step in steps:
                    state[at + step] &= _UNSETTLED
                for step in sides:
                    if state[at + step] & (_INSIDE | _LISTED) == _INSIDE:
                        border[count] = at + step
                        count += 1
                        state[at + step] |= _LISTED
        count = _still_inside(state, border, count)


@kernel
def _candidates(state, border, count, side, steps, changes, chosen):
    """Fill `chosen` with what may go from this side; how many. What can go from no side is settled
    until it changes.
    """
    candidates = 0
    for n in range(count):
        at = border[n]
        if state[at] & (_INSIDE | _SETTLED) != _INSIDE or state[at + side] & _INSIDE:
            continue
        found = neighbourhood(state, at, steps)
        if is_end(found) or not is_simple(found, changes):
            state[at] |= _SETTLED
        else:
            chosen[candidates] = at
            candidates += 1
    return candidates


@kernel
def _still_inside(state, border, count):
    """Close the gaps that removed voxels leave in the list; its new length."""
    kept = 0
    for n in range(count):
        if state[border[n]] & _INSIDE:
            border[kept] = border[n]
            kept += 1
    return kept
