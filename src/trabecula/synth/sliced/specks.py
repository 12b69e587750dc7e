"""Pieces too small to be anything go to their surroundings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.measure import label_components

_OUT = np.int16(32000)  # a vote that decides


def without_specks(votes: np.ndarray, values: np.ndarray, present: Sequence[int], least: int) -> np.ndarray:
    """Votes that no longer give `values` their pieces of fewer than `least` voxels.

    Parameters
    ----------
    votes : (C, Z, Y, X) int16
        Of one channel, whose sign tells two phases apart, or of one for each phase.
    values : (Z, Y, X) uint8
        The labels that the votes gave.
    present : sequence of int
        The labels that there are, in the order of the channels.
    least : int
        Voxels that a piece of a phase needs to stay.

    Returns
    -------
    (C, Z, Y, X) int16
    """
    result = votes.copy()
    for place, label in enumerate(present):
        labels, sizes = label_components(values == label)
        small = np.concatenate([[False], sizes < least])[labels]
        if len(present) == 2:
            result[0][small] = -_OUT if place else _OUT
        else:
            result[place][small] = -_OUT
    return result
