"""`noise`: fit finds one filter per phase but the last, generate convolves white noise and cuts it by rank.

The phases come one after another, each within what the ones before left: the field of a phase is independent of the
others', so that the conditional S2 (pairs in the phase over pairs in what was left) is that of a cut Gaussian field.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine.plan import Plan
from trabecula.engine.tiles import for_slabs, thread_count
from trabecula.measure.fft import fast_side
from trabecula.synth.base import Method, Model
from trabecula.synth.noise import SPEC
from trabecula.synth.noise.config import NoiseConfig
from trabecula.synth.noise.covariance import Filter, averaged, counts_by_offset, fitted_filter
from trabecula.synth.noise.kernels import white_plane

_PROCESS = 180 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded
_TABLES = 300_000  # bytes of the joint probability's table and what makes it
_ROWS = 4  # rows of columns along z that are transformed at once
_LEAST = 8  # voxels along an axis of the exemplar, unless it is 1 thick


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


class NoiseModel(Model):
    """A filter per phase but the last, and the fractions.

    Attributes
    ----------
    filters : list of Filter
        With the share of each spectrum that had to be clipped.
    """

    spec = SPEC
    config: NoiseConfig

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

    def _generate(self, request: Request) -> np.ndarray:
        result = np.full(request.shape, self.present[-1], np.uint8)
        ends = np.rint(np.cumsum(self.fractions) * result.size).astype(np.int64)
        left: np.ndarray | None = None  # what no phase has taken; None while that is everything
        for i, part in enumerate(self.filters):
            field = self._field(part, request, key(request.seed, f"noise/{i}"))
            count = int(ends[i] - (ends[i - 1] if i else 0))
            chosen = _highest(field.ravel() if left is None else field[left], count)
            if left is None:
                result[chosen.reshape(result.shape)] = self.present[i]
            else:
                result[left] = np.where(chosen, np.uint8(self.present[i]), np.uint8(self.present[-1]))
            del field, chosen  # before the next field is made
            left = result == self.present[-1] if i + 1 < len(self.filters) else None
        return result

    def _field(self, part: Filter, request: Request, stage: np.uint64) -> np.ndarray:
        """White noise convolved with the filter, (Z, Y, X) float32, in a box wide enough that its faces do not meet."""
        box = self._box(request)
        spectrum = _transformed(lambda z: _white(box, z, stage), box)
        spectrum *= _transformed(lambda z: _folded(part.values, box, z), box)
        field = np.empty(request.shape, np.float32)
        first = tuple(0 if wraps else far for far, wraps in zip(self.reach, request.periodic, strict=True))
        _back(spectrum, box, first, field)
        return field

    def _box(self, request: Request) -> tuple[int, ...]:
        return tuple(
            side if wraps else fast_side(side + 2 * far)
            for side, far, wraps in zip(request.shape, self.reach, request.periodic, strict=True)
        )

    def _plan(self, request: Request) -> Plan:
        z, y, x = self._box(request)
        voxels = int(np.prod(request.shape, dtype=np.int64))
        spectrum = 8 * z * y * (x // 2 + 1)
        scratch = thread_count() * (64 * y * x + 48 * z * (x // 2 + 1) * _ROWS)
        # Three moments compete for the peak: two spectra and their product, the way back, the choice of voxels by rank.
        more = 0 if len(self.present) == 2 else 6 * voxels  # what is left, and its part of the field
        moments = (2 * spectrum + voxels, spectrum + 5 * voxels, 11 * voxels)
        return Plan(
            memory={
                "interpreter and kernels": _PROCESS,
                "exemplar": sum(part.values.nbytes for part in self.filters) + self.exemplars[0].values.size,
                "output": max(moments) + more,
                "scratch": scratch,
            },
            disk=voxels,  # uncompressed; most formats take a tenth
        )


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


def _white(box: tuple[int, ...], z: int, stage: np.uint64) -> np.ndarray:
    plane = np.empty(box[1:], np.float32)
    white_plane(plane, z, stage)
    return plane


def _folded(values: np.ndarray, box: tuple[int, ...], z: int) -> np.ndarray | None:
    """Plane z of the filter in the box, offset 0 at its origin, wrapped around where the box is the smaller."""
    middle = [side // 2 for side in values.shape]
    offsets = np.flatnonzero((np.arange(len(values)) - middle[0]) % box[0] == z)
    if not len(offsets):
        return None
    rows, columns = (
        (np.arange(side) - mid) % width for side, mid, width in zip(values.shape[1:], middle[1:], box[1:], strict=True)
    )
    plane = np.zeros(box[1:], np.float32)
    np.add.at(plane, (rows[:, None], columns), values[offsets].sum(0))
    return plane


def _transformed(plane_at: Callable[[int], np.ndarray | None], box: tuple[int, ...]) -> np.ndarray:
    """The Fourier transform, (Z, Y, X // 2 + 1) complex64, of planes that are made one at a time; None is a plane of 0."""
    spectrum = np.zeros((box[0], box[1], box[2] // 2 + 1), np.complex64)

    def planes(start: int, stop: int) -> None:
        for z in range(start, stop):
            plane = plane_at(z)
            if plane is not None:
                spectrum[z] = np.fft.fft(np.fft.rfft(plane, axis=1), axis=0)

    for_slabs(planes, box[0])
    _along_z(spectrum, np.fft.fft)
    return spectrum


def _along_z(spectrum: np.ndarray, transform: Callable[..., np.ndarray]) -> None:
    def columns(start: int, stop: int) -> None:
        for y in range(start, stop, _ROWS):
            rows = spectrum[:, y : min(y + _ROWS, stop)]
            rows[:] = transform(rows, axis=0)

    for_slabs(columns, spectrum.shape[1])


def _back(spectrum: np.ndarray, box: tuple[int, ...], first: tuple[int, ...], field: np.ndarray) -> None:
    """The way back, into the part of the box that starts at `first`."""
    _along_z(spectrum, np.fft.ifft)
    _, y, x = (slice(start, start + side) for start, side in zip(first, field.shape, strict=True))

    def planes(start: int, stop: int) -> None:
        for z in range(start, stop):
            lines = np.fft.ifft(spectrum[first[0] + z], axis=0)[y]
            field[z] = np.fft.irfft(lines, box[2], axis=1)[:, x]

    for_slabs(planes, len(field))
