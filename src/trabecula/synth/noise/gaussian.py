"""Gaussian random fields: white noise convolved with a filter a phase, of an exemplar's covariance
or of a named one.

White noise and filters are whole numbers, so that their convolution is one as well. The Fourier
transform finds it with an error far below one half: any cut of the volume, and any machine, gives
the same voxels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise, product
from statistics import NormalDist

import numpy as np

from trabecula.core.seeds import key
from trabecula.engine.blocks import Box
from trabecula.engine.gaussian_random import quantiles
from trabecula.engine.memory import Array, Stage, Workspace
from trabecula.engine.parallel import thread_count
from trabecula.numerics.transforms import fast_side
from trabecula.synth.noise.convolve import ROWS, WHITE, Use, back, folded, transform_planes, white
from trabecula.synth.noise.covariance import Filter
from trabecula.synth.noise.periodic_domain import Domain

PIECE = 256
"""Voxels along an axis that are made at once, at most: 12 bytes a voxel of it and of the reach
around it.
"""

_GAIN = 1 << 18  # and of a filter whose squares sum up to one: products stay far below 2**53


class GaussianField:
    """Fields of filters, as whole numbers.

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
        """Offsets on either side of the middle."""
        return tuple(side // 2 for side in self.filters[0].values.shape)

    def each(
        self, number: int, domain: Domain, box: Box, use: Use, *, most: float = math.inf
    ) -> None:
        """A field in a box, in pieces: `use(piece, z, plane)` gets its planes as whole numbers,
        almost (see `Field`).
        """
        shape = [stop - start for start, stop in box]
        around, reach = self._around(shape), self.reach
        stage = key(domain.seed, f"noise/{number}")
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
            transform_planes(white(around, corner, domain, stage), spectrum)
            spectrum *= response
            back(spectrum, around, reach, piece, use)

    def level(self, number: int, share: float) -> float:
        """Between the two whole numbers above which the field has the share."""
        table = quantiles(WHITE).astype(np.float64)
        spread = math.sqrt(
            float((whole(self.filters[number]) ** 2).sum()) * float(np.mean(table**2))
        )
        return math.floor(NormalDist().inv_cdf(1 - share) * spread) + 0.5

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
        """Return the transform of a filter, a real one since filters are even; the latest is kept
        for the next box of its size.
        """
        # taken out while it is in use: another thread makes its own
        kept, self._kept = self._kept, None
        if kept is None or kept[0] != (number, around):
            kept = None  # freed before the next one is made
            work.enter("response")
            weights = work.adopt("weights", whole(self.filters[number]))
            spectrum = work.empty("spectrum")
            transform_planes(lambda z: folded(weights, around, z), spectrum)
            response = work.empty("response")
            response[...] = spectrum.real
            kept = ((number, around), response)
        self._kept = kept
        return kept[1]

    def _around(self, shape: Sequence[int]) -> tuple[int, ...]:
        """The box of the transforms: a piece and the reach of the filters on both sides, so that
        its faces do not meet.
        """
        return tuple(
            fast_side(max(cut.stop - cut.start for cut in _pieces(side)) + 2 * far)
            for side, far in zip(shape, self.reach, strict=True)
        )


def _pieces(side: int) -> list[slice]:
    """Cuts of an axis into pieces that are nearly equal, and not too long."""
    count = -(-side // PIECE)
    bounds = [side * i // count for i in range(count + 1)]
    return [slice(a, b) for a, b in pairwise(bounds)]


def whole(part: Filter) -> np.ndarray:
    """A filter in whole numbers, even to the last of them: a real transform says all of it."""
    found = np.rint(part.values * np.float64(_GAIN))
    flat = found.reshape(-1)
    flat[: len(flat) // 2] = flat[: len(flat) // 2 : -1]
    return found
