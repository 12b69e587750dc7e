"""Terms learned from sweep to sweep that draw the output's statistics to the picture's: a bias by
local sums, and couplings of pairs.

Bias: for every channel of the features, the sum over a slice neighbourhood falls into one of a few
cells; how often a group of levels is the centre of each cell is the joint statistic. After a sweep
the bias of a group in a cell moves by the logarithm of its frequency in the picture over that in
the output. The levels' overall shares are not part of it (`fraction_control`).

Couplings: a neighbourhood sees few voxels, so structure at larger distances is in no slice's
density. Pairs of voxels up to some distance have an energy that depends on their offset alone, one
multiplier for every statistic, moved by how far the statistic is off (Zhu, Wu, Mumford 1998,
"Filters, random fields and maximum entropy (FRAME)", doi:10.1023/A:1007925832420, section 3).
Offsets are sorted by their distance and their nearest axis; those that no picture holds have no
energy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.memory import Array, Stage, Workspace
from trabecula.engine.parallel import for_slabs
from trabecula.synth.mrf.density import UNIT
from trabecula.synth.shared.statistics.pairs import Pairs, Planes

if TYPE_CHECKING:
    from trabecula.synth.mrf.candidates import SliceNeighbourhoods
    from trabecula.synth.mrf.picture_levels import PictureLevels


_ROWS = 4096  # neighbourhoods that are summed at once

_MOST = 12.0  # factors of two in a bias


@dataclass(frozen=True)
class JointHistogram:
    """Frequency (C, B, G) float64 of a group of levels with its local sum in a cell; `edges` (C, B
    - 1) int32 separate the cells.
    """

    edges: np.ndarray
    share: np.ndarray


def joint_histogram(
    neighbourhoods: SliceNeighbourhoods, content: PictureLevels, bins: int
) -> JointHistogram:
    """Measure the joint statistic of a picture's neighbourhoods, with cells of about equal
    share.
    """
    features = content.features
    groups = int(content.groups.max()) + 1
    edges = np.empty((features.shape[1], bins - 1), np.int32)
    share = np.zeros((features.shape[1], bins, groups))
    for c in range(features.shape[1]):
        column = features[:, c].astype(np.int32)
        parts = np.array_split(neighbourhoods.around, 1 + len(neighbourhoods.around) // _ROWS)
        sums = np.concatenate([column[part].sum(1, dtype=np.int32) for part in parts])
        edges[c] = np.sort(sums)[np.arange(1, bins) * len(sums) // bins]
        np.add.at(
            share[c],
            (np.searchsorted(edges[c], sums, side="left"), content.groups[neighbourhoods.centres]),
            1,
        )
    return JointHistogram(edges, share / len(neighbourhoods.centres))


def bias_change(joint: JointHistogram, counted: np.ndarray) -> np.ndarray:
    """Return the change of the bias (C, B, G) float64 of a group in a cell after `counted` (C, B,
    G), at most 1 factor of two.

    It follows how often a group occurs in a cell, given the cell. Its effect on the groups' overall
    shares is removed, since `fraction_control` sets these. One count is added on both sides, so
    that rare events do not move it by chance.
    """
    wanted = joint.share * counted[0].sum() + 1
    seen = counted + 1
    given = np.log2(wanted / wanted.sum(2, keepdims=True)) - np.log2(
        seen / seen.sum(2, keepdims=True)
    )
    given = np.clip(given - given.mean(2, keepdims=True), -1, 1)
    given -= (joint.share.sum(2, keepdims=True) * given).sum(1, keepdims=True)
    return given


def to_units(bias: np.ndarray) -> np.ndarray:
    """Convert factors of two to whole units (int64)."""
    return np.rint(np.clip(bias, -_MOST, _MOST) * UNIT).astype(np.int64)


@kernel
def local_cells(sums, edges, cells):
    """Return the cell (S, C) uint8 of every local sum (S, C) int32: the number of edges
    below it.
    """
    for s in range(len(sums)):
        for c in range(len(edges)):
            cell = 0
            while cell < edges.shape[1] and sums[s, c] > edges[c, cell]:
                cell += 1
            cells[s, c] = cell


@kernel
def add_bias(cells, bias, groups, out):
    """Add the bias (C, B, G) of the cells to every level: `out` (S, L) int64."""
    for s in range(len(cells)):
        for c in range(len(bias)):
            row = bias[c, cells[s, c]]
            for level in range(len(groups)):
                out[s, level] += row[groups[level]]


@kernel
def count_cells(cells, groups, chosen, table):
    """Count the levels chosen (S,) by cell and group: `table` (C, B, G) int64."""
    for s in range(len(cells)):
        for c in range(len(table)):
            table[c, cells[s, c], groups[chosen[s]]] += 1


BiasTables = list[np.ndarray]
"""By cell and group (C, B, G) int64, for each learner: counts, or a bias in units."""


class BiasFeedback:
    """A bias by cell of the local sum and group of levels, one for each learner.

    Parameters
    ----------
    joints : sequence of JointHistogram
        The statistics of every learner.
    views : int
        Views that act on a site at once.
    rate : float
        Setting `feedback`.

    Attributes
    ----------
    by_cell : list of (C, B, G) float64
    """

    def __init__(self, joints: Sequence[JointHistogram], views: int, *, rate: float) -> None:
        self._joints = list(joints)
        # Every view and every channel adds its own bias: divided, they move as far as the rate
        # says together.
        self._rate = rate / (views * len(joints[0].share))
        self.by_cell = [np.zeros(joint.share.shape) for joint in joints]

    def bias(self) -> BiasTables:
        """Return the bias of every group by cell, in units."""
        return [to_units(part) for part in self.by_cell]

    def empty_tables(self) -> BiasTables:
        """Allocate the counts of a sweep."""
        return [np.zeros(part.shape, np.int64) for part in self.by_cell]

    def learn(self, counted: BiasTables) -> None:
        """Learn from the counts of a whole sweep; learners without counts stay as they are."""
        for n, (joint, table) in enumerate(zip(self._joints, counted, strict=True)):
            if table.any():
                self.by_cell[n] = self.by_cell[n] + self._rate * bias_change(joint, table)

    def state(self) -> dict[str, np.ndarray]:
        """Return the arrays of a checkpoint."""
        return {f"by_cell{n}": part for n, part in enumerate(self.by_cell)}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore the arrays of a checkpoint."""
        self.by_cell = [arrays[f"by_cell{n}"] for n in range(len(self.by_cell))]


CONES = 2
"""Cones of directions per axis. With one, excess along an axis is balanced by the diagonals."""

_NEAR = 2  # voxels: nearer pairs are left to the densities

_LEAST = 4  # voxels of a scale that couplings reach at least

_MOST_PULL = 30.0  # factors of two that they move a site by, at most

_GRAIN = 1 << 10  # steps of a field in a factor of two: the last bits of a transform decide nothing

Pictures = Sequence[tuple[int, np.ndarray]]


def coupled_pairs(
    shape: Sequence[int], *, edges: Sequence[float], reach: int, shortest: int
) -> Pairs:
    """Return the pairs of a lattice that are coupled: up to `reach`, or what half of the lattice
    and of the `shortest` side of a picture leave.
    """
    far = max(1, min(max(reach, _LEAST), shortest // 2 - 1, min(shape) // 2 - 1))
    return Pairs(tuple(shape), far, (True, True, True), tuple(edges), cones=CONES)


def coupling_stages(pairs: Pairs, channels: int) -> tuple[Stage, ...]:
    """Declare the arrays of the couplings of such pairs."""
    held = {"field": Array((channels, *pairs.shape), np.int16)}
    inverse = {
        "kernel": pairs.kernel,
        "product": pairs.spectrum,
        "pull": Array(pairs.shape, np.float32),
    }
    return (
        Stage("measure pairs", {}, 6 * pairs.table_bytes),
        Stage("hold the field", held),
        Stage(
            "compare pairs",
            {**held, "spectrum": pairs.spectrum, "lines": pairs.kernel},
            pairs.slab_bytes + 4 * pairs.table_bytes,
        ),
        Stage(
            "update the field", {**held, "spectrum": pairs.spectrum, **inverse}, pairs.slab_bytes
        ),
    )


class PairCouplings:
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
        Setting `coupling`.

    Attributes
    ----------
    strength : (C, bins) float64
        Of every bin of offsets: factor of the mean standardised feature there times the site's
        own, in the logarithm of a density.
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
        self._values = _standardise(pictures, features)
        self._rate, self._edges = rate, tuple(edges)
        self._pairs = coupled_pairs(shape, edges=edges, reach=reach, shortest=shortest)
        self._work = Workspace(coupling_stages(self._pairs, features.shape[1]))
        self._work.enter("measure pairs")
        self._wanted, held = self._targets(pictures)
        far = self._pairs.r_max
        r = np.arange(self._pairs.bins) % (far + 1)
        self._held = held & (self._pairs.fits > 0) & (r >= min(_NEAR, far))
        self.strength = np.zeros_like(self._wanted)
        self.misfit = 0.0
        self._work.enter("hold the field")
        self._work.zeros("field")

    def _targets(self, pictures: Pictures) -> tuple[np.ndarray, np.ndarray]:
        """Measure the pictures' autocorrelation (C, bins), and mark the bins that they hold."""
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
        self, coarse: np.ndarray | None, levels: np.ndarray, domain: np.ndarray | None = None
    ) -> None:
        """Take over the strengths of a coarser scale (None: there is none), whose voxels are twice
        as long, before the first sweep.
        """
        if coarse is not None:
            count, bins = len(self.strength), self._pairs.r_max + 1
            known = coarse.reshape(count, 3 * CONES, -1)
            at = np.arange(bins) / 2
            finer = [
                [np.interp(at, np.arange(known.shape[2]), row) / 2 for row in channel]
                for channel in known
            ]
            self.strength = np.where(self._held, np.reshape(finer, (count, -1)), 0.0)
        self.update_field(levels, domain)

    def learn(self, levels: np.ndarray, domain: np.ndarray | None = None) -> None:
        """Move the strengths after a sweep that left `levels` (Z, Y, X); `domain` marks the voxels
        that count (None: all).
        """
        apart = np.zeros_like(self.strength)
        both = self._pair_shares(domain)
        for c in range(len(apart)):
            now = self._curve(self._channel_planes(levels, domain, c)) / both
            apart[c] = np.where(self._held, self._wanted[c] - now / max(float(now[0]), 1e-6), 0.0)
        self.misfit = (
            float(np.sqrt(np.mean(apart[:, self._held] ** 2))) if self._held.any() else 0.0
        )
        self.strength = self.strength + self._rate * apart
        if len(apart) == 1:  # its transform is still there
            self._update_channel(0)
            self._work.enter("hold the field")
        else:
            self.update_field(levels, domain)

    def update_field(self, levels: np.ndarray, domain: np.ndarray | None = None) -> None:
        """Compute the field of the couplings at every site, given all others."""
        for c in range(len(self.strength)):
            self._transform(self._channel_planes(levels, domain, c))
            self._update_channel(c)
        self._work.enter("hold the field")

    def _transform(self, planes: Planes) -> np.ndarray:
        """Transform values in place of those before."""
        self._work.enter("hold the field")
        self._work.enter("compare pairs")
        return self._work.adopt("spectrum", self._pairs.forward(planes))

    def _curve(self, planes: Planes) -> np.ndarray:
        """Return the mean product of values over the pairs of each bin, (bins,)."""
        spectrum = self._transform(planes)
        return self._pairs.curve(spectrum, spectrum)

    def _update_channel(self, channel: int) -> None:
        """Compute the field of a channel from the transform of its values."""
        self._work.enter("update the field")
        # The strength of a bin is that of the mean over its offsets.
        into = self._work["field"][channel]
        each = self.strength[channel] * into.size / np.maximum(self._pairs.fits, 1)
        found = self._work.adopt("pull", self._pairs.convolve(self._work["spectrum"], each))

        def work(first: int, last: int) -> None:
            for z in range(first, last):
                units = np.clip(found[z] * np.float32(1 / np.log(2)), -_MOST_PULL, _MOST_PULL)
                into[z] = np.rint(units * _GRAIN)

        for_slabs(work, len(into))

    def add_to_scores(self, sites: np.ndarray, out: np.ndarray) -> None:
        """Add the energy of pairs of every level at the sites to `out` (S, L) int64, in units."""
        own = np.rint(self._values.astype(np.float64) * _GRAIN).astype(np.int64)
        for c in range(own.shape[1]):
            field = self._work["field"][c].reshape(-1)[sites, None].astype(np.int64)
            out += field * own[:, c] // (_GRAIN * _GRAIN // UNIT)

    def _pair_shares(self, domain: np.ndarray | None) -> np.ndarray | float:
        """Return the share of each bin's pairs of which both voxels count."""
        if domain is None:
            return 1.0
        marks = domain
        shares = self._curve(lambda a, b: marks[a:b].astype(np.float32))
        return np.maximum(shares, 1 / domain.size)

    def _channel_planes(
        self, levels: np.ndarray, domain: np.ndarray | None, channel: int
    ) -> Planes:
        """Return a function that gives some planes of the values of a channel."""
        values = np.ascontiguousarray(self._values[:, channel])
        if domain is None:
            return lambda a, b: values[levels[a:b]]
        marks = domain
        return lambda a, b: np.where(marks[a:b], values[levels[a:b]], np.float32(0))


def _standardise(pictures: Pictures, features: np.ndarray) -> np.ndarray:
    """Scale features (L, C) float32 to the pictures' mean 0 and variance 1."""
    counts = np.sum(
        [np.bincount(picture.ravel(), minlength=len(features)) for _, picture in pictures], axis=0
    )
    share = counts / counts.sum()
    plain = features.astype(np.float64)
    mean = share @ plain
    variance = share @ (plain - mean) ** 2
    return ((plain - mean) / np.sqrt(np.maximum(variance, 1e-9))).astype(np.float32)
