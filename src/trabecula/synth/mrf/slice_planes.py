"""The slices through a site: their planes, their neighbours, and one score from their densities.

A volume that is only looked at along its axes comes out with boxes and rods along them. In an
isotropic material any plane will do; so sweeps use in turn three planes along the axes, and three
oblique ones, rotated by 45 degrees about an axis. Along a diagonal voxels lie sqrt(2) apart: the
k-th neighbour stands for the picture's pixel at rint(k sqrt(2)).

A neighbour outside the domain of a form has weight 0: it is left out of the distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.synth.mrf.candidates import ParzenCandidates, weigh_candidates
from trabecula.synth.mrf.density import LOGS, STEPS, log_units, parzen_densities
from trabecula.synth.mrf.lattice import SiteClasses, SiteLattice, marks_or_all
from trabecula.synth.mrf.picture_levels import PictureLevels
from trabecula.synth.mrf.statistics_feedback import BiasTables, add_bias, local_cells

Offset = tuple[int, int, int]


@dataclass(frozen=True)
class ViewPlane:
    """A plane, by the voxels (z, y, x) of one step along the rows' axis and one along the columns'
    axis of its picture.
    """

    rows: Offset
    columns: Offset

    @property
    def diagonal(self) -> tuple[bool, bool]:
        """Return whether the steps along rows and columns are diagonals."""
        return sum(map(abs, self.rows)) > 1, sum(map(abs, self.columns)) > 1

    @property
    def mirror_image(self) -> ViewPlane:
        """Return the same plane with its picture seen from behind."""
        z, y, x = self.columns
        return ViewPlane(self.rows, (-z, -y, -x))

    def offsets(self, width: int) -> np.ndarray:
        """Return the offsets of the neighbours, (w^2 - 1, 3) int64, in the order of a picture's
        pixels.
        """
        steps = np.arange(width) - width // 2
        grid = steps[:, None, None] * np.array(self.rows) + steps[None, :, None] * np.array(
            self.columns
        )
        return np.delete(grid.reshape(-1, 3), width**2 // 2, axis=0)


def plane_across(axis: int) -> ViewPlane:
    """Return the plane across an axis, along the two others."""
    rows, columns = (other for other in range(3) if other != axis)
    return ViewPlane(_unit_step(rows), _unit_step(columns))


def oblique_planes(axis: int) -> tuple[ViewPlane, ViewPlane, ViewPlane]:
    """Return three orthogonal planes, rotated by 45 degrees about an axis."""
    first, second = (other for other in range(3) if other != axis)
    up, down = (
        np.add(_unit_step(first), _unit_step(second)),
        np.subtract(_unit_step(first), _unit_step(second)),
    )
    rising, falling, along = tuple(up.tolist()), tuple(down.tolist()), _unit_step(axis)
    return ViewPlane(rising, falling), ViewPlane(along, rising), ViewPlane(along, falling)


def union_offsets(planes: Sequence[ViewPlane], width: int) -> np.ndarray:
    """Return all neighbours in three dimensions, each once (equation 11)."""
    return np.unique(np.concatenate([plane.offsets(width) for plane in planes]), axis=0)


def _unit_step(axis: int) -> Offset:
    steps = [0, 0, 0]
    steps[axis] = 1
    return steps[0], steps[1], steps[2]


BATCH_OF_BITS, BATCH_OF_PRODUCTS = 1024, 128
"""Sites of a batch: their arrays stay in the cache."""

_MOST = 1 << 30


@dataclass(frozen=True)
class SliceView:
    """A view at one scale: its plane and its candidates; `learner` numbers its statistics."""

    plane: ViewPlane
    candidates: ParzenCandidates
    learner: int


class ViewSet:
    """The views that a sweep uses.

    Parameters
    ----------
    slice_views : sequence of SliceView
    lattice : SiteLattice
    content : PictureLevels
    width : int
        Of the neighbourhoods.
    correction : float
        Setting `correction`.
    """

    def __init__(
        self,
        slice_views: Sequence[SliceView],
        lattice: SiteLattice,
        content: PictureLevels,
        *,
        width: int,
        correction: float,
    ) -> None:
        self.slice_views = tuple(slice_views)
        oblique = any(any(slice_view.plane.diagonal) for slice_view in slice_views)
        planes = [slice_view.plane for slice_view in slice_views]
        self.classes = SiteClasses(lattice, width, oblique=oblique)
        # wider than the views where these are two: at most one site in every block of a plane
        self.conflicts = union_offsets([*map(plane_across, range(3)), *planes], width)
        self._lattice, self.content = lattice, content
        self._offsets = [
            (plane.offsets(width), plane.mirror_image.offsets(width)) for plane in planes
        ]
        self._blur = np.stack([slice_view.candidates.blur for slice_view in slice_views])
        self._prior = log_prior(
            [slice_view.candidates.marginal for slice_view in slice_views], correction
        )

    @property
    def batch(self) -> int:
        """Return the number of sites of a batch."""
        return (
            BATCH_OF_BITS if self.slice_views[0].candidates.bits is not None else BATCH_OF_PRODUCTS
        )

    def product_buffer(self, count: int) -> np.ndarray:
        """Allocate the products of a batch of at most `count` sites once; fresh pages for each
        batch would cost as much as its products.
        """
        bits = self.slice_views[0].candidates.bits is not None
        widest = (
            0
            if bits
            else max(len(slice_view.candidates.centres) for slice_view in self.slice_views)
        )
        return np.empty((min(self.batch, count), widest), np.float32)

    def log_densities(
        self,
        sites: np.ndarray,
        scratch: np.ndarray,
        temperature: np.ndarray,
        pulled: np.ndarray,
        bias: BiasTables,
        cells: np.ndarray,
        *,
        mirrored: bool = False,
    ) -> np.ndarray:
        """Compute the logarithms of the views' densities (S, V, L) int64, in units.

        Parameters
        ----------
        sites : (S,) int64
        scratch : (S or more, n) float32
        temperature : (Z, Y, X) float32
            Empty where there is none.
        pulled : (S, L) int64
            The feedback's `bias` (empty: none) is added to it.
        cells : (V, S, C) uint8
            Cells of the local sums are written to it, where there is a bias.
        mirrored : bool
            Whether the pictures are seen from behind.
        """
        levels = len(self.content.features)
        bins = np.empty((len(sites), len(self.slice_views), levels), np.int64)
        for v in range(len(self.slice_views)):
            self._weigh_view(
                v, sites, scratch, temperature, pulled, bias, cells, bins, mirrored=mirrored
            )
        share, log = np.empty(bins.shape, np.float64), np.empty(bins.shape, np.int64)
        parzen_densities(bins, self._blur, LOGS, share, log)
        return log

    def _weigh_view(
        self,
        v: int,
        sites: np.ndarray,
        scratch: np.ndarray,
        temperature: np.ndarray,
        pulled: np.ndarray,
        bias: BiasTables,
        cells: np.ndarray,
        bins: np.ndarray,
        *,
        mirrored: bool,
    ) -> None:
        """Sum the weights of a view's candidates into `bins` (S, V, L) int64, [:, v]; the rest is
        as in `log_densities`.
        """
        slice_view, features = self.slice_views[v], self.content.features
        offsets = self._offsets[v][int(mirrored)]
        places = np.empty((len(sites), len(offsets)), np.int64)
        found, weight = np.empty(places.shape, np.uint8), np.empty(places.shape, np.uint8)
        gather_places(
            sites, offsets, self._lattice.shape, marks_or_all(self._lattice.domain), places
        )
        gather_levels(places, self._lattice.levels, found, weight)
        if bias:
            sums = np.empty((len(sites), features.shape[1]), np.int32)
            local_sums(found, weight, features, sums)
            local_cells(sums, slice_view.candidates.joint.edges, cells[v])
            add_bias(cells[v], bias[slice_view.learner], self.content.groups, pulled)
        if temperature.size:
            gather_confidence(places, temperature, STEPS, weight)
        weigh_candidates(
            found,
            weight,
            STEPS if temperature.size else 1,
            slice_view.candidates,
            features,
            v,
            bins,
            scratch,
        )

    def combine(
        self, log: np.ndarray, pulled: np.ndarray, heuristic: str, score: np.ndarray
    ) -> None:
        """Combine the views' logarithms and the terms added to them into one score (S, L) int32, by
        h2a or h2b.
        """
        total = np.empty(pulled.shape, np.int64)
        if heuristic == "h2a":
            least_of_views(log, pulled, total)
        else:
            product_of_views(log, self._prior, pulled, total)
        score[:] = np.clip(total, -_MOST, _MOST)


def batch_bytes(slice_views: Sequence[SliceView], features: np.ndarray, width: int) -> int:
    """Return the bytes of a batch of sites while its densities are computed."""
    views, around, (levels, channels) = len(slice_views), width**2 - 1, features.shape
    each = levels * (24 * views + 24) + 11 * around
    most = max(len(slice_view.candidates.centres) for slice_view in slice_views)
    bits = slice_views[0].candidates.bits
    if bits is not None:
        return BATCH_OF_BITS * (each + 16 * len(bits)) + 2 * most
    return BATCH_OF_PRODUCTS * (each + 4 * most + 4 * around * (channels + 1)) + 5 * most


def log_prior(marginals: Sequence[np.ndarray], power: float) -> np.ndarray:
    """Return (views - 1) times the logarithm of the views' mean marginal, times `power`, in units
    (L,).

    If the views are independent given the centre, then by Bayes' rule the density given all of them
    is the product of theirs over the marginal to the power (views - 1).
    """
    share = np.mean([marginal / marginal.sum() for marginal in marginals], axis=0)
    floor = 0.5 / sum(int(marginal.sum()) for marginal in marginals)
    return np.rint((len(marginals) - 1) * power * log_units(np.maximum(share, floor))).astype(
        np.int64
    )


@kernel
def product_of_views(log, prior, bias, score):
    """Add the views' logarithms (H2b, equations 14, 15), less `prior` (L,), plus `bias` (S, L); all
    in units.
    """
    for s in range(len(log)):
        for level in range(log.shape[2]):
            total = bias[s, level] - prior[level]
            for v in range(log.shape[1]):
                total += log[s, v, level]
            score[s, level] = total


@kernel
def least_of_views(log, bias, score):
    """Take the least of the views' logarithms (H2a, equation 13), plus `bias`."""
    for s in range(len(log)):
        for level in range(log.shape[2]):
            least = log[s, 0, level]
            for v in range(1, log.shape[1]):
                least = min(least, log[s, v, level])
            score[s, level] = least + bias[s, level]


@inline
def best_level(row):
    """Return the level of the greatest score; of equals the first."""
    best = 0
    for level in range(1, len(row)):
        if row[level] > row[best]:
            best = level
    return best


@kernel
def level_of_views(log, features, mean, chosen):
    """Choose a level from the most probable level of each view: H1a, or H1b (equation 12) where
    `mean`. `chosen` (S,) uint8.
    """
    V, L, C = log.shape[1], log.shape[2], features.shape[1]
    total = np.empty(C, np.int64)
    for s in range(len(log)):
        lowest = 0
        total[:] = 0
        for v in range(V):
            best = best_level(log[s, v])
            if v == 0 or log[s, v, best] < log[s, lowest, best_level(log[s, lowest])]:
                lowest = v
            for c in range(C):
                total[c] += features[best, c]
        if not mean:
            chosen[s] = best_level(log[s, lowest])
            continue
        nearest, at = np.int64(2**62), 0
        for level in range(L):
            apart = np.int64(0)
            for c in range(C):
                apart += (V * np.int64(features[level, c]) - total[c]) ** 2
            if apart < nearest:
                nearest, at = apart, level
        chosen[s] = at


@kernel
def gather_places(sites, offsets, shape, domain, places):
    """Gather flat places of the neighbours (S, K) int64 on a torus, -1 for those outside the
    `domain`; without entries all are inside.
    """
    marks = domain.ravel()
    every = len(marks) == 0
    Z, Y, X = shape
    reach = offsets.max()
    for s in range(len(sites)):
        z, y, x = sites[s] // (Y * X), sites[s] // X % Y, sites[s] % X
        near = min(z, y, x) < reach or z >= Z - reach or y >= Y - reach or x >= X - reach
        for k in range(len(offsets)):
            dz, dy, dx = offsets[k]
            place = sites[s] + (dz * Y + dy) * X + dx
            if near:
                place = ((z + dz) % Z * Y + (y + dy) % Y) * X + (x + dx) % X
            places[s, k] = place if every or marks[place] else -1


@kernel
def gather_levels(places, levels, found, weight):
    """Gather the levels of the neighbours (S, K) uint8, and 1 or 0 in `weight` (S, K) uint8 as they
    exist or not.
    """
    flat = levels.ravel()
    for s in range(len(places)):
        for k in range(places.shape[1]):
            place = places[s, k]
            found[s, k] = flat[place] if place >= 0 else 0
            weight[s, k] = place >= 0


@kernel
def gather_confidence(places, temperature, full, weight):
    """Gather weights (1 - t)^2 of the neighbours (equation 9), in `full` steps, rounded; 0 for
    those that do not exist.
    """
    flat = temperature.ravel()
    for s in range(len(places)):
        for k in range(places.shape[1]):
            if places[s, k] >= 0:
                confidence = 1 - np.float64(flat[places[s, k]])
                weight[s, k] = np.uint8(np.floor(full * confidence * confidence + 0.5))


@kernel
def local_sums(found, weight, features, sums):
    """Sum the features over the neighbours, (S, C) int32, scaled up where some are missing (weight
    0).
    """
    K = found.shape[1]
    for s in range(len(found)):
        count = 0
        sums[s] = 0
        for k in range(K):
            if weight[s, k]:
                count += 1
                for c in range(features.shape[1]):
                    sums[s, c] += features[found[s, k], c]
        if 0 < count < K:
            for c in range(features.shape[1]):
                sums[s, c] = sums[s, c] * K // count
