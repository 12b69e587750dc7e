"""`noise`: fit finds one filter per phase but the last, generate convolves white noise and cuts it at a level.

The phases come one after another, each within what the ones before left: the field of a phase is independent of the
others', so that the conditional S2 (pairs in the phase over pairs in what was left) is that of a cut Gaussian field.

White noise and filters are whole numbers, so that their convolution is one as well. The Fourier transform finds it with an
error far below one half: any cut of the volume, and any machine, gives the same voxels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise, product
from statistics import NormalDist
from typing import Any

import numpy as np

from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine.blocks import Box
from trabecula.engine.normals import quantiles
from trabecula.engine.plan import Plan
from trabecula.engine.tiles import thread_count
from trabecula.measure.fft import fast_side
from trabecula.synth.base import Method
from trabecula.synth.noise import SPEC
from trabecula.synth.noise.config import NoiseConfig
from trabecula.synth.noise.convolve import ROWS, WHITE, Use, back, folded, transformed, white
from trabecula.synth.noise.covariance import Filter, averaged, counts_by_offset, fitted_filter
from trabecula.synth.windows import WindowModel

_PROCESS = 180 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded
_TABLES = 300_000  # bytes of the joint probability's table and what makes it
_LEAST = 8  # voxels along an axis of the exemplar, unless it is 1 thick
_PIECE = 256  # voxels along an axis that are made at once, at most: 16 bytes a voxel of it and of the reach around it
_GAIN = 1 << 18  # and of a filter whose squares sum up to one: products stay far below 2**53


class Noise(Method):
    """A thresholded Gaussian random field."""

    spec = SPEC
    config_type = NoiseConfig

    def _fit(self, exemplars: Sequence[Image]) -> NoiseModel:
        exemplar = exemplars[0]
        if any(1 < side < _LEAST for side in exemplar.shape):
            raise InputError(
                f"the exemplar is {exemplar.shape}, the two-point function needs {_LEAST} voxels along an axis (or 1, for a "
                "flat image): give a larger exemplar"
            )
        return NoiseModel(self.config, exemplars)

    def _plan_fit(self, exemplars: Sequence[Image]) -> Plan:
        """The transforms of an indicator, and of the covariance."""
        exemplar = exemplars[0]
        reach = _reach(exemplar.shape, self.config)
        padded = np.prod(
            [fast_side(side + far) for side, far in zip(exemplar.shape, reach, strict=True)], dtype=np.int64
        )
        offsets = int(np.prod([2 * far + 1 for far in reach], dtype=np.int64))
        left = 3 * exemplar.values.size
        return Plan(
            {
                "interpreter and kernels": _PROCESS,
                "transforms": max(21 * int(padded) + 8 * offsets, 72 * offsets) + left + _TABLES,
                "filters": 4 * offsets * (len(np.unique(exemplar.values)) - 1),
            }
        )


class NoiseModel(WindowModel):
    """A filter per phase but the last, and the fractions.

    Attributes
    ----------
    filters : list of Filter
        With the share of each spectrum that had to be clipped.
    """

    spec = SPEC
    config: NoiseConfig
    block = _PIECE

    def __init__(self, config: NoiseConfig, exemplars: Sequence[Image]) -> None:
        super().__init__(config, exemplars)
        values = exemplars[0].values
        self.present = [int(label) for label in np.unique(values)]
        self.fractions = np.bincount(values.ravel())[self.present] / values.size
        self.reach = _reach(values.shape, config)
        self.filters: list[Filter] = []
        left = np.ones(values.shape, bool)
        for label in self.present[:-1]:
            inside = values == label
            self.filters.append(_filter(inside, left, self.reach, config))
            left &= ~inside

    def _box(self, request: Request, box: Box) -> np.ndarray:
        result = np.full([stop - start for start, stop in box], self.present[-1], np.uint8)
        for i, part in enumerate(self.filters):
            level = _level(_whole(part), self._share(i))

            def cut(piece: tuple[slice, ...], z: int, plane: np.ndarray, i: int = i, level: float = level) -> None:
                target = result[piece][z]
                target[(plane > level) & (target == self.present[-1])] = self.present[i]

            self._convolve(i, request, box, cut)
        return result

    def _generate(self, request: Request) -> tuple[np.ndarray, Mapping[str, Any]]:
        if not self.config.exact:
            return super()._generate(request)
        result = np.full(request.shape, self.present[-1], np.uint8)
        ends = np.rint(np.cumsum(self.fractions) * result.size).astype(np.int64)
        field = np.empty(request.shape, np.int32)

        def keep(piece: tuple[slice, ...], z: int, plane: np.ndarray) -> None:
            field[piece][z] = np.rint(plane)

        for i in range(len(self.filters)):
            self._convolve(i, request, tuple((0, side) for side in request.shape), keep)
            left = result == self.present[-1]
            found = result[left]
            found[_highest(field[left], int(ends[i] - (ends[i - 1] if i else 0)))] = self.present[i]
            result[left] = found
        return result, {}

    def _share(self, i: int) -> float:
        """Of a phase, of what the phases before it leave."""
        return float(self.fractions[i] / self.fractions[i:].sum())

    def _convolve(self, i: int, request: Request, box: Box, use: Use) -> None:
        """The field of phase i in a box, in pieces: `use(piece, z, plane)` gets its planes as whole numbers, almost."""
        shape = [stop - start for start, stop in box]
        around, weights = self._around(shape), _whole(self.filters[i])
        stage = key(request.seed, f"noise/{i}")
        response = transformed(lambda z: folded(weights, around, z), around)
        for piece in product(*(_pieces(side) for side in shape)):
            corner = [start + cut.start - far for (start, _), cut, far in zip(box, piece, self.reach, strict=True)]
            spectrum = transformed(white(around, corner, request, stage), around)
            spectrum *= response
            back(spectrum, around, self.reach, piece, use)
            del spectrum  # before the next one is made

    def _around(self, shape: Sequence[int]) -> tuple[int, ...]:
        """The box of the transforms: a piece and the reach of the filters on both sides, so that its faces do not meet."""
        return tuple(
            fast_side(max(cut.stop - cut.start for cut in _pieces(side)) + 2 * far)
            for side, far in zip(shape, self.reach, strict=True)
        )

    def _plan(self, request: Request) -> Plan:
        plan, voxels = super()._plan(request), self._size(request)
        # The field beside its transforms, or the choice of its highest.
        ranked = max(4 * voxels, 20 * voxels - plan.memory["transforms"]) if self.config.exact else 0
        return replace(plan, memory={**plan.memory, "output": voxels + ranked})

    def plan_block(self, request: Request, side: int) -> Plan:
        """Forecast of making the request in blocks (see `WindowModel`)."""
        self._check_windows()
        return super().plan_block(request, side)

    def values_of(self, request: Request, box: Box) -> np.ndarray:
        """The values of a box (see `WindowModel`)."""
        self._check_windows()
        return super().values_of(request, box)

    def _check_windows(self) -> None:
        if self.config.exact:
            raise RequestError(
                "exact shares are found by rank over all voxels at once, no box of which is made alone: leave exact out"
            )

    def _plan_box(self, request: Request, shape: tuple[int, ...]) -> Mapping[str, int]:
        z, y, x = self._around(shape)
        spectrum = 16 * z * y * (x // 2 + 1)
        planes = thread_count() * (96 * y * x + 96 * z * (x // 2 + 1) * ROWS)
        return {
            "interpreter and kernels": _PROCESS,
            "exemplar": sum(part.values.nbytes for part in self.filters) + self.exemplars[0].values.size,
            "transforms": 2 * spectrum + planes + 2 * 8 * self.filters[0].values.size,
        }


def _reach(shape: tuple[int, ...], config: NoiseConfig) -> tuple[int, ...]:
    reach = tuple(min(config.reach, (side - 1) // 2) for side in shape)
    # In a flat exemplar, what it does not show along its normal is what it shows across.
    return (min(far for far in reach if far),) * 3 if config.isotropic and any(reach) else reach


def _filter(inside: np.ndarray, left: np.ndarray, reach: tuple[int, ...], config: NoiseConfig) -> Filter:
    fraction = float(np.count_nonzero(inside) / np.count_nonzero(left))
    if fraction > 0.5:
        # Either side of the threshold tells the covariance. The rarer does so far better: the chance surplus of a phase
        # at some offset is in proportion to its fraction.
        inside, fraction = left & ~inside, 1 - fraction
    seen = tuple(min(far, side - 1) for far, side in zip(reach, left.shape, strict=True))
    pairs = counts_by_offset(left, seen)
    hits = counts_by_offset(inside, seen)
    if config.isotropic:
        hits = averaged(hits, pairs, reach)
    else:
        hits /= np.maximum(pairs, 1)
        hits[pairs < 1] = fraction**2
    return fitted_filter(hits, fraction, corrections=config.corrections, isotropic=config.isotropic)


def _highest(values: np.ndarray, count: int) -> np.ndarray:
    """True at the `count` highest of a flat array, the first of equal ones."""
    if count == 0:
        return np.zeros(len(values), bool)
    level = np.partition(values, len(values) - count)[len(values) - count]
    chosen = values > level
    missing = count - int(np.count_nonzero(chosen))
    chosen[np.flatnonzero(values == level)[:missing]] = True
    return chosen


def _pieces(side: int) -> list[slice]:
    """Cuts of an axis into pieces that are nearly equal, and not too long."""
    count = -(-side // _PIECE)
    bounds = [side * i // count for i in range(count + 1)]
    return [slice(a, b) for a, b in pairwise(bounds)]


def _whole(part: Filter) -> np.ndarray:
    """A filter in whole numbers."""
    return np.rint(part.values * np.float64(_GAIN))


def _level(weights: np.ndarray, share: float) -> float:
    """Between the two whole numbers above which the field has the share."""
    table = quantiles(WHITE).astype(np.float64)
    spread = math.sqrt(float((weights**2).sum()) * float(np.mean(table**2)))
    return math.floor(NormalDist().inv_cdf(1 - share) * spread) + 0.5
