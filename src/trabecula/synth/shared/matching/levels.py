"""How finely the neighbourhoods of a level are told apart, and how many levels a result has."""

from __future__ import annotations

import numpy as np

_WIDE = 8  # voxels: a neighbourhood that is described by enough blocks
# of the variance that may be dropped, the share that is left for sums over blocks
_BLOCKS_MISS = 0.4
_WIDTHS = 2.75  # neighbourhoods that lie side by side in the output on its coarsest level, at least


def grain_of(width: int, *, smooth: bool) -> int:
    """Edge of the blocks whose sums describe neighbourhoods of a width: 2 where the field is
    smooth, else 1.

    Distances on the finest level are so smooth that ten components hold them, and those of blocks
    are nearly the same ones.
    """
    return 2 if smooth and width >= _WIDE and width % 2 == 0 else 1


def variance_in(grain: int, variance: float) -> float:
    """The share of the blocks' variance to keep for `variance` of all: what varies within a block
    is missing from it.
    """
    return variance if grain == 1 else 1 - (1 - variance) * _BLOCKS_MISS


def levels_for(shape: tuple[int, ...], most: int, *, width: int) -> int:
    """Resolutions at which an output is some neighbourhoods wide: else the first rounds would copy
    the exemplar whole.
    """
    side = float(np.prod(shape, dtype=np.float64)) ** (1 / len(shape))
    count = 1
    while count < most and side / 2**count >= _WIDTHS * width:
        count += 1
    return count
