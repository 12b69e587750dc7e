"""Gaussian random fields: white noise convolved with a filter a phase, by Fourier transform.

The filter is that of an exemplar's covariance or of a named one. White noise and filters are whole
numbers, so that their convolution is one as well. The Fourier transform finds it with an error far
below one half: any cut of the volume, and any machine, gives the same voxels. It goes plane by
plane, in threads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise, product
from statistics import NormalDist

import numpy as np

from trabecula.core.seeds import key
from trabecula.engine.blocks import Box
from trabecula.engine.compile import kernel
from trabecula.engine.gaussian_random import normal_line, quantiles
from trabecula.engine.memory import Array, Stage, Workspace
from trabecula.engine.parallel import for_slabs, thread_count
from trabecula.numerics.transforms import fast_side
from trabecula.synth.shared.gaussian.domain import Domain, Use
from trabecula.synth.shared.gaussian.filters import Filter


@kernel
def white_plane(plane, key, z, corner, periods, table):
    """Fill a plane (Y, X) float64 with independent normal numbers in the table's units.

    They are those of the voxels from (z, *corner) on; periods are 0 along an endless axis.
    """
    for y in range(plane.shape[0]):
        row = corner[0] + y
        if periods[0] > 0:
            row = row % periods[0]
        normal_line(plane[y], key, z, row, corner[1], periods[1], table)


WHITE = 256
"""What stands for one standard deviation of the white noise, as a whole number."""

ROWS = 4
"""Rows of columns along z that are transformed at once."""


def white_noise_planes(
    around: tuple[int, ...], corner: Sequence[int], domain: Domain, stage: np.uint64
) -> Callable[[int], np.ndarray]:
    """Return a function that makes a plane of white noise of the box from `corner` on."""
    periods = [
        side if wraps else 0 for side, wraps in zip(domain.shape, domain.periodic, strict=True)
    ]
    inside, across = np.array(corner[1:], np.int64), np.array(periods[1:], np.int64)

    def plane_at(z: int) -> np.ndarray:
        plane = np.empty(around[1:])
        place = corner[0] + z
        white_plane(
            plane,
            stage,
            place % periods[0] if periods[0] else place,
            inside,
            across,
            quantiles(WHITE),
        )
        return plane

    return plane_at


def fold_filter(values: np.ndarray, box: tuple[int, ...], z: int) -> np.ndarray | None:
    """Return plane z of the filter in the box, with offset 0 at its origin.

    It wraps around where the box is the smaller; None where the plane is 0.
    """
    middle = [side // 2 for side in values.shape]
    offsets = np.flatnonzero((np.arange(len(values)) - middle[0]) % box[0] == z)
    if not len(offsets):
        return None
    rows, columns = (
        (np.arange(side) - mid) % width
        for side, mid, width in zip(values.shape[1:], middle[1:], box[1:], strict=True)
    )
    plane = np.zeros(box[1:])
    np.add.at(plane, (rows[:, None], columns), values[offsets].sum(0))
    return plane


def transform_planes(
    plane_at: Callable[[int], np.ndarray | None], spectrum: np.ndarray
) -> np.ndarray:
    """Write the Fourier transform of planes into `spectrum`, and return it.

    The planes are made one at a time (None: a plane of zeros); the spectrum is (Z, Y, X // 2 + 1)
    complex128.
    """

    def planes(start: int, stop: int) -> None:
        for z in range(start, stop):
            plane = plane_at(z)
            spectrum[z] = 0 if plane is None else np.fft.fft(np.fft.rfft(plane, axis=1), axis=0)

    for_slabs(planes, len(spectrum))
    _along_z(spectrum, np.fft.fft)
    return spectrum


def _along_z(spectrum: np.ndarray, transform: Callable[..., np.ndarray]) -> None:
    """Transform columns along z in place."""

    def columns(start: int, stop: int) -> None:
        for y in range(start, stop, ROWS):
            rows = spectrum[:, y : min(y + ROWS, stop)]
            rows[:] = transform(rows, axis=0)

    for_slabs(columns, spectrum.shape[1])


def inverse_transform(
    spectrum: np.ndarray,
    box: tuple[int, ...],
    first: tuple[int, ...],
    piece: tuple[slice, ...],
    use: Use,
) -> None:
    """Transform a spectrum back, and pass its planes to `use`.

    The planes are those of a piece of the result that starts at `first` in the box.
    """
    _along_z(spectrum, np.fft.ifft)
    depth, height, width = (cut.stop - cut.start for cut in piece)

    def planes(start: int, stop: int) -> None:
        for z in range(start, stop):
            lines = np.fft.ifft(spectrum[first[0] + z], axis=0)[first[1] : first[1] + height]
            use(piece, z, np.fft.irfft(lines, box[2], axis=1)[:, first[2] : first[2] + width])

    for_slabs(planes, depth)


PIECE = 256
"""Voxels along an axis that are made at once, at most: 12 bytes a voxel of it and of the reach
around it.
"""

_GAIN = 1 << 18  # and of a filter whose squares sum up to one: products stay far below 2**53


class GaussianField:
    """Gaussian fields of filters, as whole numbers.

    Attributes
    ----------
    filters : list of Filter
        One a field; all have the same sides.
    reach : three ints
        Offsets along z, y, x that they have on either side of their middle.
    """

    def __init__(self, filters: list[Filter]) -> None:
        self.filters = filters
        self._kept: tuple[tuple[int, tuple[int, ...]], np.ndarray] | None = None

    @property
    def reach(self) -> tuple[int, ...]:
        """Return the offsets on either side of the filters' middle."""
        return tuple(side // 2 for side in self.filters[0].values.shape)

    def each(
        self,
        number: int,
        domain: Domain,
        box: Box,
        use: Use,
        *,
        most: float = math.inf,
        noise: int | None = None,
    ) -> None:
        """Make a field in a box, in pieces.

        `use(piece, z, plane)` gets its planes as whole numbers, almost (see `Field`). The white
        noise is that of the field `noise`; default its own.
        """
        shape = [stop - start for start, stop in box]
        around, reach = self._around(shape), self.reach
        stage = key(domain.seed, f"noise/{number if noise is None else noise}")
        work = Workspace(self.stages(shape))
        response = self._response_of(number, around, work)
        work.enter("field")
        if "spectrum" not in work:
            work.adopt("response", response)
            work.empty("spectrum")
        spectrum = work["spectrum"]
        for piece in product(*(_pieces(side) for side in shape)):
            corner = [
                start + cut.start - far
                for (start, _), cut, far in zip(box, piece, reach, strict=True)
            ]
            transform_planes(white_noise_planes(around, corner, domain, stage), spectrum)
            spectrum *= response
            inverse_transform(spectrum, around, reach, piece, use)

    def level(self, number: int, share: float) -> float:
        """Return the half number above which the field has the share."""
        return math.floor(NormalDist().inv_cdf(1 - share) * self.spread(number)) + 0.5

    def spread(self, number: int) -> float:
        """Return the standard deviation of a field, in whole numbers."""
        table = quantiles(WHITE).astype(np.float64)
        return math.sqrt(
            float((integer_filter(self.filters[number]) ** 2).sum()) * float(np.mean(table**2))
        )

    def stages(self, shape: Sequence[int]) -> tuple[Stage, ...]:
        """Return the stages of making a box (Z, Y, X): the response of the filter, the field."""
        z, y, x = self._around(shape)
        half = (z, y, x // 2 + 1)
        arrays = {"spectrum": Array(half, np.complex128), "response": Array(half, np.float64)}
        weights = Array(self.filters[0].values.shape, np.float64)
        # of a thread: planes on their way through the transforms, rows of columns along z
        planes = thread_count() * (96 * y * x + 96 * z * half[2] * ROWS)
        return (
            Stage("response", {**arrays, "weights": weights}, planes + weights.nbytes),
            Stage("field", arrays, planes),
        )

    def _response_of(self, number: int, around: tuple[int, ...], work: Workspace) -> np.ndarray:
        """Return the transform of a filter, which is real since filters are even.

        The latest is kept for the next box of its size.
        """
        # taken out while it is in use: another thread makes its own
        kept, self._kept = self._kept, None
        if kept is None or kept[0] != (number, around):
            kept = None  # freed before the next one is made
            work.enter("response")
            weights = work.adopt("weights", integer_filter(self.filters[number]))
            spectrum = work.empty("spectrum")
            transform_planes(lambda z: fold_filter(weights, around, z), spectrum)
            response = work.empty("response")
            response[...] = spectrum.real
            kept = ((number, around), response)
        self._kept = kept
        return kept[1]

    def _around(self, shape: Sequence[int]) -> tuple[int, ...]:
        """Return the box of the transforms: a piece and the reach of the filters on both sides.

        So its faces do not meet.
        """
        return tuple(
            fast_side(max(cut.stop - cut.start for cut in _pieces(side)) + 2 * far)
            for side, far in zip(shape, self.reach, strict=True)
        )


def _pieces(side: int) -> list[slice]:
    """Cut an axis into pieces that are nearly equal, and not too long."""
    count = -(-side // PIECE)
    bounds = [side * i // count for i in range(count + 1)]
    return [slice(a, b) for a, b in pairwise(bounds)]


def integer_filter(part: Filter) -> np.ndarray:
    """Return a filter in whole numbers, symmetric to the last bit.

    A real transform then holds all of it.
    """
    found = np.rint(part.values * np.float64(_GAIN))
    flat = found.reshape(-1)
    flat[: len(flat) // 2] = flat[: len(flat) // 2 : -1]
    return found
