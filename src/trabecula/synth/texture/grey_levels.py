"""Grey values and colours of a structure, by what a scan adds to its phases.

A scan is taken as the sum of two parts, both of them learnt from the exemplar:

1. The expected level: a sum of Gaussians of the structure and of their products, fitted by least
   squares. It holds the contrast, the blur, partial volume and dark or bright rims; the products
   tell thin bodies from thick ones, and one phase's rims from another's.
2. The residual: a Gaussian random field for every phase, with the covariance that the exemplar's
   residual has there. Channels of a colour are made of independent fields along the principal axes
   of the residual. A trial on the exemplar's own structure lowers the frequencies of which the
   result has more than the exemplar: parts 1 and 2 are not independent where interfaces are lost
   between voxels.

Then the levels beside an interface are shifted, smoothly, where they lie on the wrong side of a
threshold, so that the iso-surface is that of the structure. No voxel is copied. Unlike votes of
neighbourhoods, which blur where they overlap and tear grains where they do not, this keeps the
grain, and loses what is not Gaussian in the residual. In the end every phase gets the histogram
that it has in the exemplar, thus the structure is the iso-surface of the result.

All of it is local: it goes by tiles, whose cut does not change a voxel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np

from trabecula.core.request import Request
from trabecula.engine.memory import Array, Stage, Workspace, forecast, within
from trabecula.measure.smooth import gaussian, reach_of
from trabecula.numerics.transforms import sums_by_offset
from trabecula.synth.shared.content.fields import FULL, UNIT
from trabecula.synth.shared.gaussian.domain import domain_of
from trabecula.synth.shared.gaussian.field import GaussianField
from trabecula.synth.shared.gaussian.filters import Filter, fading_window, filter_of
from trabecula.synth.shared.tiles import tile_voxels, tile_with_halo, tiles_of
from trabecula.synth.texture.grey_beside import SCALES, KnownLevels
from trabecula.synth.texture.scan_phases import NEAR, ScanPhases, luminance, weighted_sum

_SCALES = (0.0, 0.7, 1.4, 2.8)  # voxels, of the Gaussians of the structure
_EDGE = 1  # the one of `_SCALES` by which the residuals of the phases pass into each other
_RIDGE = 1e-4
_REACH = 10  # voxels, of the residual's covariance
_PAIRS = 200  # of a covariance: an offset with fewer pairs hardly counts
_BANDS = 24  # of frequencies
_TRIALS, _LEAST_GAIN = 2, 0.02
_SHIFTS, _SPREAD, _HASTE = 2, 0.8, 2.0  # rounds, voxels, times the gap to the threshold
_BESIDE = 12  # arrays of a tile beside known levels
_ROWS = 1 << 16  # voxels that the weights of products are fitted to, about

Match = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Makes the fields (C, Z, Y, X) float32 of votes and their structure, with the exemplars'
histograms.
"""


@dataclass(frozen=True)
class GreyLevels:
    """Levels of a structure, in the units of a field.

    Attributes
    ----------
    scan : ScanPhases
        The phases that the levels are those of.
    edges : three floats
        Sides of a voxel over their geometric mean.
    weights : (C, 1 + terms) float64
        Of a constant, of the Gaussians of the structure, and of their products where it has them,
        in the expected level.
    mixes : (phases, C, C) float64
        Level of every channel for one standard deviation of each residual field, by phase.
    filters : tuple of Filter
        Of the residual fields: all those of the darkest phase, then of the next.
    """

    scan: ScanPhases
    edges: tuple[float, ...]
    weights: np.ndarray
    mixes: np.ndarray
    filters: tuple[Filter, ...]

    @property
    def channels(self) -> int:
        """Count the channels."""
        return len(self.weights)

    @property
    def nbytes(self) -> int:
        """Return the bytes of the filters."""
        return sum(one.values.nbytes for one in self.filters)

    def paint(
        self, structure: np.ndarray, request: Request, known: KnownLevels | None = None
    ) -> np.ndarray:
        """Return votes (C, Z, Y, X) int16 for a structure (Z, Y, X) uint8 of the request's shape
        and periodic axes, beside known levels where there are some.
        """
        work = Workspace(self.stages(request))
        work.enter("expected levels")
        work.adopt("structure", structure)
        self._expect(work, request.periodic)
        self._add_residual(work, request)
        if known is not None:
            known.continue_in(work["levels"], [self._sigma(scale) for scale in SCALES])
        work.enter("shift")
        self._shift(work, request.periodic)
        return work.take("votes")

    def stages(self, request: Request) -> tuple[Stage, ...]:
        """Declare the arrays of `paint`."""
        shape, channels = request.shape, self.channels
        held = {
            "structure": Array(shape, np.uint8),
            "levels": Array((channels, *shape), np.float32),
            "shares": Array((self.scan.count - 1, *shape), np.uint8),
        }
        votes = {name: held[name] for name in ("structure", "levels")}
        votes["votes"] = Array((channels, *shape), np.int16)
        tile = 4 * (2 + len(_SCALES) * (self.scan.count - 1) + 2 * channels)
        wide, far = self._reach(max(_SCALES)), self._shift_reach()
        beside = 0
        if request.known is not None:
            reach = np.sum([self._reach(scale) for scale in SCALES], axis=0)
            beside = 4 * (_BESIDE + 2 * channels) * tile_voxels(shape, reach)
        return (
            Stage("expected levels", held, tile * tile_voxels(shape, wide)),
            *within(held, GaussianField(list(self.filters)).stages(shape)),
            Stage("residual", held, beside),
            Stage("shift", votes, tile * tile_voxels(shape, far)),
        )

    def _sigma(self, scale: float) -> tuple[float, ...]:
        return tuple(scale / edge for edge in self.edges)

    def _reach(self, scale: float) -> tuple[int, ...]:
        return tuple(reach_of(sigma) for sigma in self._sigma(scale))

    def _shift_reach(self) -> tuple[int, ...]:
        pairs = zip(self._reach(self.scan.smooth), self._reach(_SPREAD), strict=True)
        around = NEAR if self.scan.count > 2 else 0
        return tuple(_SHIFTS * (first + second) + around for first, second in pairs)

    def _expect(self, work: Workspace, periodic: tuple[bool, ...]) -> None:
        """Write the expected levels, and the share of every phase but the first in 1 / 255."""
        structure, levels, shares = work["structure"], work.empty("levels"), work.empty("shares")
        for tile in tiles_of(structure.shape):
            around, inner = tile_with_halo(structure, tile, self._reach(max(_SCALES)), periodic)
            parts = [part[inner] for part in _gaussians(around, self.scan.count, self.edges)]
            for channel, weights in zip(levels, self.weights, strict=True):
                channel[tile] = _expected(weights, parts)
            for share, part in zip(shares, parts[_EDGE :: len(_SCALES)], strict=True):
                share[tile] = np.rint(np.clip(part, 0, 1) * 255)

    def _add_residual(self, work: Workspace, request: Request) -> None:
        """Add the residual fields, each by the share of its phase."""
        work.enter("residual")
        levels, shares = work["levels"], work["shares"]
        field, domain = GaussianField(list(self.filters)), domain_of(request)
        box = tuple((0, side) for side in request.shape)
        amounts = np.sqrt(np.arange(256, dtype=np.float32) / 255)
        for number in range(len(self.filters)):
            phase, axis = divmod(number, self.channels)
            scale = (self.mixes[phase][:, axis] / field.spread(number)).astype(np.float32)

            def add(
                piece: tuple[slice, ...],
                z: int,
                plane: np.ndarray,
                scale: np.ndarray = scale,
                phase: int = phase,
            ) -> None:
                part = amounts[_share_of(phase, shares[:, *piece][:, z])] * plane.astype(np.float32)
                for channel, factor in zip(levels, scale, strict=True):
                    channel[piece][z] += factor * part

            field.each(number, domain, box, add)

    def _shift(self, work: Workspace, periodic: tuple[bool, ...]) -> None:
        """Write the votes: levels that lie on their phase's side of the thresholds."""
        structure, levels, votes = work["structure"], work["levels"], work.empty("votes")
        limit = FULL * UNIT
        for tile in tiles_of(structure.shape):
            inside = tile_with_halo(structure, tile, self._shift_reach(), periodic)[0]
            low, high = self.scan.bounds(inside)
            parts = [tile_with_halo(one, tile, self._shift_reach(), periodic) for one in levels]
            around, inner = np.stack([part for part, _ in parts]), parts[0][1]
            for _ in range(_SHIFTS):
                smooth = gaussian(luminance(around), self._sigma(self.scan.smooth))
                gap = smooth.clip(low, high) - smooth
                around += np.float32(_HASTE) * gaussian(gap, self._sigma(_SPREAD))
            if not self.scan.smooth:  # every voxel for itself: to the other side, as far beyond
                single = luminance(around)
                around += 2 * (single.clip(low, high) - single)
            kept = around[(slice(None), *inner)]
            votes[(slice(None), *tile)] = np.clip(np.rint(kept * UNIT), -limit, limit)


def learn_levels(
    fields: Sequence[np.ndarray],
    structures: Sequence[np.ndarray],
    scan: ScanPhases,
    edges: tuple[float, ...],
    match: Match,
    *,
    products: bool = True,
) -> GreyLevels:
    """Learn the levels of fields (C, Z, Y, X) float32 with their structures (Z, Y, X) uint8.

    Without `products` the expected level is a sum of Gaussians alone.
    """
    phases = scan.count
    weights = _fit_weights(fields, structures, phases, edges, products=products)
    residuals = []
    for field, structure in zip(fields, structures, strict=True):
        parts = _gaussians(structure, phases, edges)
        levels = [_expected(one, parts) for one in weights]
        residuals.append(field - np.stack(levels))
    found = [_residual_axes(residuals, structures, phase) for phase in range(phases)]
    mixes, covariances = np.stack([mix for mix, _ in found]), [c for _, part in found for c in part]

    def levels_at(gains: np.ndarray) -> GreyLevels:
        shaped = [_shape_spectrum(covariance, gains) for covariance in covariances]
        spreads = np.sqrt([covariance[_middle(covariance)] for covariance in shaped])
        scaled = mixes * spreads.reshape(phases, 1, -1)
        filters = tuple(filter_of(covariance, corrections=0) for covariance in shaped)
        return GreyLevels(scan, edges, weights, scaled, filters)

    gains: np.ndarray = np.ones(_BANDS)
    wanted: Any = sum(_power(luminance(field)) for field in fields)
    pairs = list(zip(fields, residuals, strict=True))
    expected: Any = sum(_power(luminance(field - residual)) for field, residual in pairs)
    residuals.clear()
    del pairs
    for trial in range(_TRIALS):
        trial_levels = levels_at(gains)
        made: Any = sum(
            _power(luminance(match(trial_levels.paint(one, Request(one.shape, seed=trial)), one)))
            for one in structures
        )
        # small exemplars leave bands without a frequency
        residual = np.maximum(np.maximum(made - expected, 0.1 * made), 1e-12)
        gains = np.clip(gains * (1 + (wanted - made) / residual), _LEAST_GAIN, 1)
    return levels_at(gains)


def trial_bytes(shape: tuple[int, ...], channels: int, phases: int) -> int:
    """Forecast the bytes of painting an exemplar while its levels are learnt."""
    sides = tuple(2 * min(_REACH, (side - 1) // 2) + 1 for side in shape)
    filters = (Filter(np.zeros(sides, np.float32), 0.0),) * (phases * channels)
    weights, mixes = np.zeros((channels, 1)), np.zeros((phases, channels, channels))
    scan = ScanPhases((0.0,) * (phases - 1), 1.0)
    empty = GreyLevels(scan, (1.0,) * 3, weights, mixes, filters)
    return forecast(empty.stages(Request(shape)), {}).peak


def _fit_weights(
    fields: Sequence[np.ndarray],
    structures: Sequence[np.ndarray],
    phases: int,
    edges: tuple[float, ...],
    *,
    products: bool,
) -> np.ndarray:
    """Fit the expected levels by least squares, with a little ridge: the Gaussians are alike."""
    single = len(_SCALES) * (phases - 1)
    size = 1 + single + (single * (single + 1) // 2 if products else 0)
    normal, right, count = np.zeros((size, size)), np.zeros((size, len(fields[0]))), 0
    voxels = sum(structure.size for structure in structures)
    stride = max(1, round((voxels / _ROWS) ** (1 / 3))) if products else 1
    chosen = (slice(None, None, stride),) * 3
    for field, structure in zip(fields, structures, strict=True):
        parts = [part[chosen] for part in _gaussians(structure, phases, edges)]
        seen = field[:, *chosen]
        terms = [np.ones(parts[0].shape, np.float32), *parts]
        terms += _products(parts) if products else ()
        for i, term in enumerate(terms):
            for j in range(i + 1):
                normal[i, j] += (term * terms[j]).sum(dtype=np.float64)
            right[i] += (term * seen).sum(axis=(1, 2, 3), dtype=np.float64)
        count += parts[0].size
    normal += np.tril(normal, -1).T
    normal[np.diag_indices(size)] += _RIDGE * normal[1, 1] * (np.arange(size) > 0)
    return np.asarray(np.linalg.solve(normal / count, right / count).T)


def _gaussians(structure: np.ndarray, phases: int, edges: tuple[float, ...]) -> list[np.ndarray]:
    """Return every phase but the first of a structure (Z, Y, X), smoothed on every scale."""
    sigmas = [tuple(scale / edge for edge in edges) for scale in _SCALES]
    return [gaussian(structure == phase, one) for phase in range(1, phases) for one in sigmas]


def _products(parts: Sequence[np.ndarray]) -> Iterator[np.ndarray]:
    """Yield the product of every pair of parts, each with itself as well."""
    for place, part in enumerate(parts):
        for other in parts[: place + 1]:
            yield part * other


def _expected(weights: np.ndarray, parts: Sequence[np.ndarray]) -> np.ndarray:
    """Return the expected levels of a channel, (Z, Y, X) float32."""
    levels = np.full(parts[0].shape, np.float32(weights[0]))
    for weight, term in zip(weights[1:], chain(parts, _products(parts)), strict=False):
        levels += np.float32(weight) * term
    return levels


def _share_of(phase: int, shares: np.ndarray) -> np.ndarray:
    """Return the share of a phase in 1 / 255, from those (phases - 1, ...) uint8 of all but the
    first.
    """
    if phase:
        return np.asarray(shares[phase - 1])
    return np.maximum(255 - shares.sum(axis=0, dtype=np.int16), 0)


def _residual_axes(
    residuals: Sequence[np.ndarray], structures: Sequence[np.ndarray], phase: int
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the principal axes (C, C) of residuals in a phase, as columns, and the covariance of
    the residual along each.
    """
    inside = [structure == phase for structure in structures]
    values = np.concatenate(
        [residual[:, at] for residual, at in zip(residuals, inside, strict=True)], axis=1
    )
    moments = np.einsum("ik,jk->ij", values, values, dtype=np.float64) / values.shape[1]
    axes = np.linalg.eigh(moments)[1]
    shortest = np.min([structure.shape for structure in structures], axis=0)
    reach = tuple(min(_REACH, (int(side) - 1) // 2) for side in shortest)
    counts: Any = sum(sums_by_offset(at, reach).astype(np.float64) for at in inside)
    covariances = []
    for axis in axes.T:
        sums: Any = sum(
            sums_by_offset(weighted_sum(part, axis.astype(np.float32)) * at, reach)
            for part, at in zip(residuals, inside, strict=True)
        )
        covariance = sums / (counts + _PAIRS)
        covariances.append(covariance * fading_window(covariance.shape))
    return axes, covariances


def _shape_spectrum(covariance: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """Return a covariance without the negative part of its spectrum, times gains by frequency."""
    power = np.maximum(np.fft.rfftn(np.fft.ifftshift(covariance)).real, 1e-12)
    power *= np.interp(_frequencies(covariance.shape), (np.arange(_BANDS) + 0.5) / _BANDS, gains)
    return np.fft.fftshift(np.fft.irfftn(power, covariance.shape, axes=(0, 1, 2)))


def _frequencies(shape: Sequence[int]) -> np.ndarray:
    """Return the frequencies of a real transform over the highest along an axis."""
    z, y, x = shape
    squares = np.ix_(np.fft.fftfreq(z) ** 2, np.fft.fftfreq(y) ** 2, np.fft.rfftfreq(x) ** 2)
    return np.asarray(2 * np.sqrt(sum(squares)))


def _power(values: np.ndarray) -> np.ndarray:
    """Sum the power of (Z, Y, X) float32 over bands of frequencies, (bands,); higher ones count
    with the last.
    """
    windows = np.ix_(*[np.hanning(side + 2)[1:-1].astype(np.float32) for side in values.shape])
    seen = (values - values.mean(dtype=np.float64).astype(np.float32)) * windows[0]
    spectrum = np.fft.rfftn(seen * windows[1] * windows[2], axes=(0, 1, 2))
    bands = np.minimum((_frequencies(values.shape) * _BANDS).astype(np.int64), _BANDS - 1)
    squares = spectrum.real**2 + spectrum.imag**2
    return np.bincount(bands.ravel(), weights=squares.ravel(), minlength=_BANDS)


def _middle(array: np.ndarray) -> tuple[int, ...]:
    return tuple(side // 2 for side in array.shape)
