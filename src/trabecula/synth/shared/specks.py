"""Small connected components that a result should not have."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.measure.runs import runs_of
from trabecula.synth.shared.slabs import make_by_slabs

_OUT = 32000  # a vote that decides
_FACES = 6  # neighbours share one


def remove_specks(
    votes: np.ndarray, values: np.ndarray, present: Sequence[int], least: int
) -> np.ndarray:
    """Return votes that no longer give `values` their connected components of fewer than `least`
    voxels.

    Parameters
    ----------
    votes : (C, Z, Y, X) int16
        Of one channel, whose sign tells two phases apart, or of one for each phase.
    values : (Z, Y, X) uint8
        The labels that the votes gave.
    present : sequence of int
        The labels that there are, in the order of the channels.
    least : int
        Voxels that a component of a phase needs to stay.

    Returns
    -------
    (C, Z, Y, X) int16
    """
    result = make_by_slabs(lambda a, b: votes[:, a:b], votes.shape, votes.dtype)
    for place, label in enumerate(present):
        runs = runs_of(values, np.arange(256) == label, _FACES)
        small = runs.sizes < least
        if len(present) == 2:
            runs.write(result[0], small, -_OUT if place else _OUT)
        else:
            runs.write(result[place], small, -_OUT)
    return result
