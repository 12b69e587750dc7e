"""The coarse-to-fine loop of synthesis by search and vote."""

from __future__ import annotations

import numpy as np

_WIDTHS = 2.75  # neighbourhoods that lie side by side in the output on its coarsest level, at least


def levels_for(shape: tuple[int, ...], most: int, *, width: int) -> int:
    """Resolutions at which an output is some neighbourhoods wide: else the first rounds would copy
    the exemplar whole.
    """
    side = float(np.prod(shape, dtype=np.float64)) ** (1 / len(shape))
    count = 1
    while count < most and side / 2**count >= _WIDTHS * width:
        count += 1
    return count
