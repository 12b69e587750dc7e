"""Convolution with white noise by Fourier transform: in a box, plane by plane, in threads."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from trabecula.engine.gaussian_random import quantiles
from trabecula.engine.parallel import for_slabs
from trabecula.synth.noise.kernels import white_plane
from trabecula.synth.noise.periodic_domain import Domain

WHITE = 256
"""What stands for one standard deviation of the white noise, as a whole number."""

ROWS = 4
"""Rows of columns along z that are transformed at once."""

Use = Callable[[tuple[slice, ...], int, np.ndarray], None]
"""Gets a piece of the result, a plane of it by its number, and what was found there."""


def white(
    around: tuple[int, ...], corner: Sequence[int], domain: Domain, stage: np.uint64
) -> Callable[[int], np.ndarray]:
    """What makes a plane of white noise of the box that starts at `corner`."""
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


def folded(values: np.ndarray, box: tuple[int, ...], z: int) -> np.ndarray | None:
    """Plane z of the filter in the box, offset 0 at its origin, wrapped around where the box is the
    smaller.
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
    """Write the Fourier transform of planes that are made one at a time (None: a plane of zeros)
    into `spectrum`, (Z, Y, X // 2 + 1) complex128; return it.
    """

    def planes(start: int, stop: int) -> None:
        for z in range(start, stop):
            plane = plane_at(z)
            spectrum[z] = 0 if plane is None else np.fft.fft(np.fft.rfft(plane, axis=1), axis=0)

    for_slabs(planes, len(spectrum))
    _along_z(spectrum, np.fft.fft)
    return spectrum


def _along_z(spectrum: np.ndarray, transform: Callable[..., np.ndarray]) -> None:
    def columns(start: int, stop: int) -> None:
        for y in range(start, stop, ROWS):
            rows = spectrum[:, y : min(y + ROWS, stop)]
            rows[:] = transform(rows, axis=0)

    for_slabs(columns, spectrum.shape[1])


def back(
    spectrum: np.ndarray,
    box: tuple[int, ...],
    first: tuple[int, ...],
    piece: tuple[slice, ...],
    use: Use,
) -> None:
    """The way back, of what starts at `first` in the box and is a piece of the result."""
    _along_z(spectrum, np.fft.ifft)
    depth, height, width = (cut.stop - cut.start for cut in piece)

    def planes(start: int, stop: int) -> None:
        for z in range(start, stop):
            lines = np.fft.ifft(spectrum[first[0] + z], axis=0)[first[1] : first[1] + height]
            use(piece, z, np.fft.irfft(lines, box[2], axis=1)[:, first[2] : first[2] + width])

    for_slabs(planes, depth)
