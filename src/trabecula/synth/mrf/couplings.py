"""Pair couplings: an energy of pairs of voxels, learnt until the output's two-point function is the
picture's.

A neighbourhood sees few voxels; how things lie farther apart is in no slice's density. So pairs of
voxels up to some distance have an energy that depends on their offset alone, one multiplier for
every statistic, moved by how far the statistic is off (Zhu, Wu, Mumford 1998, "Filters, random
fields and maximum entropy (FRAME)", doi:10.1023/A:1007925832420, section 3). Offsets are told apart
by their distance and by the axis that they lie nearest to; those that no picture holds have none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs
from trabecula.synth.mrf.tables import UNIT
from trabecula.synth.shared.statistics.pairs import Pairs, Planes

CONES = 2
"""Without, what lies along the axes is made up for by what lies along diagonals."""

_NEAR = 2  # voxels: what lies nearer is the densities' own
_LEAST = 4  # voxels of a scale that couplings reach at least
_MOST = 30.0  # factors of two that they move a site by, at most
_GRAIN = 1 << 10  # steps of a field in a factor of two: the last bits of a transform decide nothing

Pictures = Sequence[tuple[int, np.ndarray]]


class Couplings:
    """The couplings of one scale, on a torus.

    Parameters
    ----------
    pictures : sequence of (axis, (R, C) uint8)
        The levels of every view's picture at this scale, and the axis that it is seen across.
    features : (L, C) int16
    shape : three int
        Of the lattice.
    edges : three float
        Of a voxel, in the unit of distances.
    reach : int
        Farthest distance, voxels of this scale.
    rate : float
        How fast they learn.

    Attributes
    ----------
    strength : (C, bins) float64
        Of every bin of offsets: what the mean standardised feature there, times the site's own,
        adds to the logarithm of a density.
    misfit : float
        Root mean square of the last difference in autocorrelation.
    """

    def __init__(
        self,
        pictures: Pictures,
        features: np.ndarray,
        shape: Sequence[int],
        *,
        edges: Sequence[float],
        reach: int,
        rate: float,
    ) -> None:
        shortest = min(min(picture.shape) for _, picture in pictures)
        far = max(1, min(max(reach, _LEAST), shortest // 2 - 1, min(shape) // 2 - 1))
        self._values = _standardised(pictures, features)
        self._rate, self._edges = rate, tuple(edges)
        self._pairs = Pairs(tuple(shape), far, (True, True, True), self._edges, cones=CONES)
        self._wanted, held = self._targets(pictures)
        r = np.arange(self._pairs.bins) % (far + 1)
        self._held = held & (self._pairs.fits > 0) & (r >= min(_NEAR, far))
        self.strength = np.zeros_like(self._wanted)
        self.misfit = 0.0
        self._field = memmap.zeros((features.shape[1], *shape), np.int16)

    def _targets(self, pictures: Pictures) -> tuple[np.ndarray, np.ndarray]:
        """The pictures' autocorrelation (C, bins), and which bins they hold."""
        sums = np.zeros((self._values.shape[1], self._pairs.bins))
        fits = np.zeros(self._pairs.bins)
        for axis, picture in pictures:
            slab = np.expand_dims(picture, axis)
            pairs = Pairs(
                slab.shape, self._pairs.r_max, (False, False, False), self._edges, cones=CONES
            )
            fits += pairs.fits
            for c in range(len(sums)):
                spectrum = pairs.forward(self._values[slab, c])
                sums[c] += pairs.curve(spectrum, spectrum) * pairs.fits
        return sums / np.maximum(fits, 1), fits > 0

    def start(
        self, coarse: Couplings | None, levels: np.ndarray, there: np.ndarray | None = None
    ) -> None:
        """Take over the strengths of a coarser scale, whose voxels are twice as long, before the
        first sweep.
        """
        if coarse is not None:
            count, bins = len(self.strength), self._pairs.r_max + 1
            known = coarse.strength.reshape(count, 3 * CONES, -1)
            at = np.arange(bins) / 2
            finer = [
                [np.interp(at, np.arange(known.shape[2]), row) / 2 for row in channel]
                for channel in known
            ]
            self.strength = np.where(self._held, np.reshape(finer, (count, -1)), 0.0)
        self.act(levels, there)

    def learn(self, levels: np.ndarray, there: np.ndarray | None = None) -> None:
        """Move the strengths after a sweep that left `levels` (Z, Y, X); `there` says which of them
        count (None: all).
        """
        apart = np.zeros_like(self.strength)
        both = self._both(there)
        for c in range(len(apart)):
            spectrum = self._pairs.forward(self._planes(levels, there, c))
            now = self._pairs.curve(spectrum, spectrum) / both
            apart[c] = np.where(self._held, self._wanted[c] - now / max(float(now[0]), 1e-6), 0.0)
            if len(apart) > 1:
                del spectrum  # before the next is made
        self.misfit = (
            float(np.sqrt(np.mean(apart[:, self._held] ** 2))) if self._held.any() else 0.0
        )
        self.strength = self.strength + self._rate * apart
        if len(apart) == 1:
            self._act(0, spectrum)
        else:
            self.act(levels, there)

    def act(self, levels: np.ndarray, there: np.ndarray | None = None) -> None:
        """What the strengths say of every site, given all others."""
        for c in range(len(self.strength)):
            self._act(c, self._pairs.forward(self._planes(levels, there, c)))

    def _act(self, channel: int, spectrum: np.ndarray) -> None:
        """The field of a channel, from the transform of its values."""
        # The strength of a bin is that of the mean over its offsets.
        into = self._field[channel]
        each = self.strength[channel] * into.size / np.maximum(self._pairs.fits, 1)
        found = self._pairs.convolve(spectrum, each)

        def work(first: int, last: int) -> None:
            for z in range(first, last):
                units = np.clip(found[z] * np.float32(1 / np.log(2)), -_MOST, _MOST)
                into[z] = np.rint(units * _GRAIN)

        for_slabs(work, len(into))

    def pull(self, sites: np.ndarray, out: np.ndarray) -> None:
        """Add what pairs say of every level at the sites to `out` (S, L) int64, in units."""
        own = np.rint(self._values.astype(np.float64) * _GRAIN).astype(np.int64)
        for c in range(own.shape[1]):
            field = self._field[c].reshape(-1)[sites, None].astype(np.int64)
            out += field * own[:, c] // (_GRAIN * _GRAIN // UNIT)

    def _both(self, there: np.ndarray | None) -> np.ndarray | float:
        """The share of each bin's pairs of which both count."""
        if there is None:
            return 1.0
        marks = there
        spectrum = self._pairs.forward(lambda z: marks[z].astype(np.float32))
        return np.maximum(self._pairs.curve(spectrum, spectrum), 1 / there.size)

    def _planes(self, levels: np.ndarray, there: np.ndarray | None, channel: int) -> Planes:
        """The values of a channel, plane by plane."""
        values = np.ascontiguousarray(self._values[:, channel])
        if there is None:
            return lambda z: values[levels[z]]
        marks = there
        return lambda z: np.where(marks[z], values[levels[z]], np.float32(0))


def _standardised(pictures: Pictures, features: np.ndarray) -> np.ndarray:
    """Features (L, C) float32 with the pictures' mean 0 and variance 1."""
    counts = np.sum(
        [np.bincount(picture.ravel(), minlength=len(features)) for _, picture in pictures], axis=0
    )
    share = counts / counts.sum()
    plain = features.astype(np.float64)
    mean = share @ plain
    variance = share @ (plain - mean) ** 2
    return ((plain - mean) / np.sqrt(np.maximum(variance, 1e-9))).astype(np.float32)
