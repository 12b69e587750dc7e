"""Pairs of voxels by their distance, in fields of float32: the two-point function of values that
are not 0 or 1.

Unlike `measure.correlation`, which counts, this also correlates two fields and convolves one with a
radial kernel, and keeps the transforms. Every line is transformed alone, so that threads change
nothing: first planes by slabs of z, then the lines along z by slabs of y, of which every plane
holds a contiguous piece.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.memory import Array
from trabecula.engine.parallel import for_slabs, thread_count
from trabecula.numerics.transforms import fast_side

# Arrays that another process may write (`anywhere`) are memory-mapped however small: `least` is 0.
Planes = Callable[[int, int], np.ndarray]
"""Makes planes a..b (n, Y, X) float32 of a field that never exists as a whole; several threads
call it.
"""

# values that are worth a thread
_WORTH = 1 << 16
_AT_ONCE = 1 << 14  # complex values that are transformed in one call, unless a plane has more

_CONE = np.cos(np.pi / 8) ** 2

LINES = [
    line
    for line in product((0, 1), (-1, 0, 1), (-1, 0, 1))
    if next((step for step in line if step), 0) > 0
]
"""Directions (z, y, x) from a voxel to the 13 of its 26 neighbours that the others mirror."""

AXES, DIAGONAL = 3, len(LINES)
"""Directions by which pairs are binned: the axes alone, or their diagonals as well."""


def _enough(values: int) -> int:
    """Count the planes of so many values that are worth a thread."""
    return max(8, _WORTH // values)


def spans(start: int, stop: int, values: int) -> Iterator[tuple[int, int]]:
    """Yield parts of start..stop, so many at a time that calls cost little and stay in the cache:
    of planes or rows of `values`.
    """
    step = max(1, _AT_ONCE // max(1, values))
    for first in range(start, stop, step):
        yield first, min(first + step, stop)


@dataclass(frozen=True)
class Pairs:
    """All pairs of voxels of a grid that are up to `r_max` apart, by their rounded distance and the
    axis they lie nearest to.

    `edges` are the sides of a voxel in the unit of distances; axes that wrap have no ends; `free`
    (Z, Y, X) bool says which voxels count (None: all). With two `cones` those within 22.5 degrees
    of their axis have bins of their own. With `DIAGONAL` directions the diagonals of faces and of
    the cube have bins as the axes have them.
    """

    shape: tuple[int, ...]
    r_max: int
    wraps: tuple[bool, ...] = (False, False, False)
    edges: tuple[float, ...] = (1.0, 1.0, 1.0)
    free: np.ndarray | None = None
    cones: int = 1
    directions: int = AXES

    @cached_property
    def reach(self) -> tuple[int, ...]:
        """Return the largest offset along every axis; axes that wrap are not counted twice."""
        return tuple(
            min(int((self.r_max + 0.5) / edge), (side - 1) // 2 if wrap else side - 1)
            for side, edge, wrap in zip(self.shape, self.edges, self.wraps, strict=True)
        )

    @cached_property
    def sides(self) -> tuple[int, ...]:
        """Return the sides of the transform: open axes are continued by zeros."""
        return tuple(
            side if wrap else fast_side(side + far)
            for side, far, wrap in zip(self.shape, self.reach, self.wraps, strict=True)
        )

    @cached_property
    def offsets(self) -> tuple[np.ndarray, ...]:
        """Return the offsets along every axis; along z only those that are not negative, since the
        other half mirrors them.
        """
        z, y, x = self.reach
        return np.arange(z + 1), np.arange(-y, y + 1), np.arange(-x, x + 1)

    @property
    def bins(self) -> int:
        """Count the bins: distances 0 .. r_max of pairs that are nearest to z, then to y, then to
        x, and to the diagonals; for each cone.
        """
        return self.directions * self.cones * (self.r_max + 1)

    @cached_property
    def places(self) -> np.ndarray:
        """Return the bin of every offset; `bins` where it is longer than r_max."""
        steps = [offset * edge for offset, edge in zip(self.offsets, self.edges, strict=True)]
        z, y, x = np.meshgrid(*steps, indexing="ij", sparse=True)
        rounded = (np.sqrt(z**2 + y**2 + x**2) + 0.5).astype(np.int64)
        if self.directions == DIAGONAL:
            sort = _nearest_line(z, y, x)
        else:
            sort = np.where((z**2 >= y**2) & (z**2 >= x**2), 0, np.where(y**2 >= x**2, 1, 2))
        if self.cones == 2:
            longest = np.maximum(np.maximum(z**2, y**2), x**2)
            sort = sort + 3 * (longest < _CONE * (z**2 + y**2 + x**2))
        return np.where(rounded > self.r_max, self.bins, sort * (self.r_max + 1) + rounded)

    @cached_property
    def fits(self) -> np.ndarray:
        """Count the pairs in every bin, (bins,)."""
        if self.free is not None:
            free = self.free
            spectrum = self.forward(lambda a, b: free[a:b].astype(np.float32))
            return np.maximum(self._by_length(np.rint(self._correlate(spectrum, spectrum))), 0)
        z, y, x = (
            np.full(len(offset), float(side)) if wrap else side - np.abs(offset).astype(float)
            for offset, side, wrap in zip(self.offsets, self.shape, self.wraps, strict=True)
        )
        return self._by_length(z[:, None, None] * y[:, None] * x)

    @property
    def spectrum(self) -> Array:
        """Declare a transform."""
        depth, height, width = self.sides
        return Array((depth, height, width // 2 + 1), np.complex64)

    @property
    def kernel(self) -> Array:
        """Declare the kernel in `convolve`, or the lines at the offsets in `curve`."""
        return Array((self.reach[0] + 1, *self.spectrum.shape[1:]), np.complex64)

    @property
    def table_bytes(self) -> int:
        """Return the bytes of the bins of all offsets, which are cached."""
        return 8 * int(np.prod([len(offset) for offset in self.offsets]))

    @property
    def slab_bytes(self) -> int:
        """Return the bytes of planes and rows that are never memory-mapped."""
        depth, height, width = self.sides
        together = max(_AT_ONCE, max(depth, height) * (width // 2 + 1))
        return (1 << 16) + thread_count() * 64 * together

    def forward(self, values: np.ndarray | Planes) -> np.ndarray:
        """Transform (Z, Y, X) float32, given whole or as a function that makes planes a..b;
        complex64.
        """
        depth, height, width = self.sides
        count = self.shape[0]
        spectrum = memmap.empty((depth, height, width // 2 + 1), np.complex64, least=0)
        _flat_transforms(values, (height, width), spectrum[:count])

        def lines(start: int, stop: int) -> None:
            for low, high in spans(start, stop, depth * (width // 2 + 1)):
                rows = spectrum[:count, low:high]
                spectrum[:, low:high] = np.fft.fft(rows, depth, axis=0)

        for_slabs(lines, height, least=_enough(depth * width))
        return spectrum

    def curve(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Return the mean product of two fields over all pairs of each bin, from their transforms:
        (bins,) float64.
        """
        return self._by_length(self._correlate(first, second)) / np.maximum(self.fits, 1)

    def convolve(
        self, spectrum: np.ndarray, weights: np.ndarray, *, shorter_than: int = 0
    ) -> np.ndarray:
        """Sum a field around every voxel, weighted by bin (weights (bins,)): (Z, Y, X) float32.

        Every axis has to wrap. With `shorter_than` its waves longer than about twice so many voxels
        are left out: less its mean, twice over, of boxes of that width.
        """
        kernel = self._kernel(weights)
        values = memmap.empty(self.shape, np.float32, least=0)
        depth = self.shape[0]
        along_z, along_y, along_x = (box_response(side, shorter_than) ** 2 for side in self.shape)
        along_x = along_x[: kernel.shape[2]]

        def product(low: int, high: int) -> np.ndarray:
            # a pair and its mirror image share a bin: planes -dz are the conjugates of planes dz
            response = np.fft.hfft(kernel[:, low:high], depth, axis=0)
            if shorter_than:
                response *= 1 - along_z[:, None, None] * (along_y[low:high, None] * along_x)
            return spectrum[:, low:high] * response

        self._inverse(product, tuple(np.arange(side) for side in self.shape), values, anywhere=True)
        return values

    def _kernel(self, weights: np.ndarray) -> np.ndarray:
        """Transform the weights by offset along y and x: planes dz = 0 .. reach, complex64."""
        _, height, width = self.shape
        half = np.append(weights, 0.0).astype(np.float32)[self.places]
        across = np.ix_(self.offsets[1] % height, self.offsets[2] % width)

        def planes(start: int, stop: int) -> np.ndarray:
            around = np.zeros((stop - start, height, width), np.float32)
            around[:, across[0], across[1]] = half[start:stop]
            return around

        kernel = memmap.empty((len(half), height, width // 2 + 1), np.complex64, least=0)
        _flat_transforms(planes, (height, width), kernel)
        return kernel

    def _correlate(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Sum over all pairs of every offset, mean of both orders."""

        def product(low: int, high: int) -> np.ndarray:
            a, b = first[:, low:high], second[:, low:high]
            return a.real * b.real + a.imag * b.imag

        sums = np.empty(tuple(len(offset) for offset in self.offsets), np.float32)
        self._inverse(product, self.offsets, sums)
        return sums

    def _inverse(
        self,
        product: Planes,
        places: Sequence[np.ndarray],
        values: np.ndarray,
        *,
        anywhere: bool = False,
    ) -> None:
        """Transform back from rows product(low, high) (Z, n, X), into `values`: at some places
        along every axis only.

        `anywhere` says that values may be written by another process.
        """
        depth, height, width = self.sides
        kept = memmap.empty((len(places[0]), height, width // 2 + 1), np.complex64, least=0)

        def lines(start: int, stop: int) -> None:
            for low, high in spans(start, stop, depth * (width // 2 + 1)):
                rows = np.fft.ifft(product(low, high), axis=0)
                kept[:, low:high] = _take(rows, places[0], 0)

        for_slabs(lines, height, least=_enough(depth * width), anywhere=True)
        self._inverse_planes(kept, places, values, anywhere=anywhere)

    def _inverse_planes(
        self,
        kept: np.ndarray,
        places: Sequence[np.ndarray],
        values: np.ndarray,
        *,
        anywhere: bool = False,
    ) -> None:
        """Transform planes back along y and x, into `values` at some places along these axes."""
        _, height, width = self.sides

        def planes(start: int, stop: int) -> None:
            for low, high in spans(start, stop, height * (width // 2 + 1)):
                rows = _take(np.fft.ifft(kept[low:high], axis=1), places[1], 1)
                values[low:high] = _take(np.fft.irfft(rows, width, axis=2), places[2], 2)

        for_slabs(planes, len(kept), least=_enough(height * width), anywhere=anywhere)

    def _by_length(self, sums: np.ndarray) -> np.ndarray:
        twice = np.where(np.arange(len(sums)) > 0, 2.0, 1.0)[:, None, None]
        counted = np.bincount(
            self.places.ravel(), weights=(sums * twice).ravel(), minlength=self.bins + 1
        )
        return np.asarray(counted[: self.bins])


def _nearest_line(z: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the number of the direction to which an offset (sparse grids) lies nearest."""
    longest = np.full(np.broadcast_shapes(z.shape, y.shape, x.shape), -1.0)
    nearest = np.zeros(longest.shape, np.int64)
    for number, (a, b, c) in enumerate(LINES):
        along = np.abs(a * z + b * y + c * x) / math.sqrt(a * a + b * b + c * c)
        nearest[along > longest] = number
        np.maximum(longest, along, out=longest)
    return nearest


def _flat_transforms(
    values: np.ndarray | Planes, sides: tuple[int, int], spectra: np.ndarray
) -> None:
    """Transform planes along x and y, continued by zeros to `sides`, into `spectra` (n, y, x // 2 +
    1).
    """
    height, width = sides

    def work(start: int, stop: int) -> None:
        for low, high in spans(start, stop, height * (width // 2 + 1)):
            planes = values(low, high) if callable(values) else values[low:high]
            spectra[low:high] = np.fft.fft(np.fft.rfft(planes, width, axis=2), height, axis=1)

    for_slabs(work, len(spectra), least=_enough(height * width), anywhere=True)


def box_response(side: int, width: int) -> np.ndarray:
    """Return the transform of the mean over `width` voxels of a line that wraps,
    (side,) float32.
    """
    angle = np.pi * np.fft.fftfreq(side)
    angle[0] = 1.0
    response = np.sin(width * angle) / (max(1, width) * np.sin(angle))
    response[0] = 1.0
    return response.astype(np.float32)


def _take(values: np.ndarray, places: np.ndarray, axis: int) -> np.ndarray:
    """Take the values at places along an axis, which may be negative; return all themselves where
    places are all in their order.
    """
    side = values.shape[axis]
    return values if len(places) == side and places[0] == 0 else values.take(places % side, axis)
