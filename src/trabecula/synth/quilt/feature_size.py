"""Minimum feature size by construction: solid that no cube of so many voxels a side fits into."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.synth.quilt.voxel_codes import EMPTY, OUT


def thin_voxels(window: np.ndarray, margin: tuple[int, ...], size: int, solid: np.ndarray) -> int:
    """Voxels of a window's box that lie in no `size`-cube of solid; what is not made yet, or
    outside, may be solid.

    Parameters
    ----------
    window : (z, y, x) uint8
    margin : three ints
    size : int
        Voxels; along an axis of one voxel it is 1.
    solid : (256,) bool
        Which values are solid.
    """
    may_be = solid[window] | (window == EMPTY) | (window == OUT)
    sides = tuple(1 if side == 1 else size for side in window.shape)
    covered = np.zeros(window.shape, np.bool_)
    _cover(may_be, sides, covered)
    thin = solid[window] & ~covered
    return int(
        np.count_nonzero(
            thin[tuple(slice(m, s - m) for m, s in zip(margin, window.shape, strict=True))]
        )
    )


@kernel
def _cover(may_be, sides, covered):
    """Mark every voxel of every full cube; a cube may reach beyond the window."""
    depth, height, width = may_be.shape
    for z in range(1 - sides[0], depth):
        for y in range(1 - sides[1], height):
            for x in range(1 - sides[2], width):
                full = True
                for k in range(max(z, 0), min(z + sides[0], depth)):
                    for j in range(max(y, 0), min(y + sides[1], height)):
                        for i in range(max(x, 0), min(x + sides[2], width)):
                            if not may_be[k, j, i]:
                                full = False
                                break
                        if not full:
                            break
                    if not full:
                        break
                if not full:
                    continue
                for k in range(max(z, 0), min(z + sides[0], depth)):
                    for j in range(max(y, 0), min(y + sides[1], height)):
                        for i in range(max(x, 0), min(x + sides[2], width)):
                            covered[k, j, i] = True
