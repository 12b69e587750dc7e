"""Tiles of a volume, with what is around them: what depends on few voxels goes by them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

TILE = 64
"""Voxels a side."""


def tiles_of(shape: Sequence[int]) -> Iterator[tuple[slice, ...]]:
    """Yield boxes that fill a volume."""
    cuts = ([slice(a, min(a + TILE, side)) for a in range(0, side, TILE)] for side in shape)
    yield from product(*cuts)


def tile_voxels(shape: Sequence[int], reach: Sequence[int]) -> int:
    """Count the voxels of a tile with its halo."""
    sides = (min(TILE, side) + 2 * far for side, far in zip(shape, reach, strict=True))
    return int(np.prod(list(sides)))


def tile_with_halo(
    values: np.ndarray, tile: tuple[slice, ...], reach: Sequence[int], periodic: Sequence[bool]
) -> tuple[np.ndarray, tuple[slice, ...]]:
    """Return a tile of (Z, Y, X, ...) with what is around it, and the tile's place therein; beyond
    an open face the last voxel is repeated.
    """
    places, inner = [], []
    for cut, far, wraps, side in zip(tile, reach, periodic, values.shape[:3], strict=True):
        place = np.arange(cut.start - far, cut.stop + far)
        places.append(place % side if wraps else place.clip(0, side - 1))
        inner.append(slice(far, far + cut.stop - cut.start))
    return values[np.ix_(*places)], tuple(inner)
