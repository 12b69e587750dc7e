"""Pairs of voxels at all offsets within reach, plane after plane.

Pairs are counted with the slab of their later end: those of the slab and the last planes before it,
less those of these last planes alone.
"""

from __future__ import annotations

import math

import numpy as np

from trabecula.measure.correlation.fourier import count_mirror_pairs, transform_bytes
from trabecula.measure.correlation.pair_geometry import Radial, probability


class RadialPairTally:
    """Pairs of a phase whose distance rounds to r, given plane after plane.

    Parameters
    ----------
    pairs : Radial
        Of the whole volume; no axis periodic, no mask.
    """

    def __init__(self, pairs: Radial) -> None:
        self._pairs = pairs
        self._fits = pairs.fits()
        self._exact = pairs.sparse(self._fits)
        self._last: np.ndarray | None = None
        self._counts = np.zeros(tuple(far + 1 for far in pairs.reach))

    def add(self, inside: np.ndarray) -> None:
        """Take the next planes: a bool array, (planes, Y, X)."""
        if self._last is not None:
            inside = np.concatenate([self._last, inside])
            self._counts -= self._count(self._last)
        self._counts += self._count(inside)
        reach = self._pairs.reach[0]
        self._last = inside[max(0, len(inside) - reach) :].copy() if reach else None

    def _count(self, inside: np.ndarray) -> np.ndarray:
        return count_mirror_pairs(
            inside, None, self._pairs.reach, self._pairs.window.wraps, exact=self._exact
        )

    def result(self) -> np.ndarray:
        """Return S2(r), as `two_point` gives it, (r_max + 1,)."""
        return probability(self._pairs.sum(self._counts), self._fits)


def pairs_bytes(pairs: Radial, depth: int) -> int:
    """Forecast the memory of taking `depth` planes at a time."""
    _, height, width = pairs.window.shape
    planes = min(depth + pairs.reach[0], pairs.window.shape[0])
    exact = pairs.sparse(pairs.fits())
    return transform_bytes((planes, height, width), pairs.reach, exact=exact) + 2 * math.prod(
        (planes, height, width)
    )
