"""Draws that come out as often as they should."""

from __future__ import annotations

import numpy as np


def drawn_evenly(weights: np.ndarray, count: int, draw: np.random.Generator) -> np.ndarray:
    """Return `count` of the numbers of weights that sum to 1, in random order, each as often as its
    weight says up to one.
    """
    order = draw.permutation(len(weights))
    marks = (np.arange(count) + draw.random()) / count
    found = np.searchsorted(np.cumsum(weights[order]), marks)
    return np.asarray(draw.permutation(order[np.minimum(found, len(order) - 1)]))
