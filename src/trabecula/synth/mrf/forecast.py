"""How much memory `mrf` will take, from shapes and settings alone; the factors were measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.synth.mrf.config import MrfConfig
from trabecula.synth.mrf.content import Content
from trabecula.synth.mrf.frame import BATCH_OF_BITS, BATCH_OF_PRODUCTS
from trabecula.synth.mrf.source import Source, codes_of
from trabecula.synth.shared.statistics.pairs import Pairs

_ROWS, _MANY = 4096, 65536  # neighbourhoods that are summed at once, and in all
_TABLES = 80_000  # bytes of the two tables of a source
_SMALL = 100_000  # bytes of what does not depend on the picture
_OF_A_PIXEL = {"labels": 10, "grey": 20, "colour": 132}  # bytes that numbering the levels takes
_STARTING, _IN_A_FORM = 4, 5  # bytes a voxel, when a scale starts
_CONVOLVED, _BEFORE = 12, 8  # bytes a voxel beside two spectra: of a channel of the couplings, and of the one before


def learning_bytes(images: Sequence[Image], scales: int, config: MrfConfig, *, turned: bool) -> tuple[int, int]:
    """What is kept of the pictures once they are learnt at all scales, and the most that it takes meanwhile."""
    area, held = config.neighbourhood**2, sum(int(np.prod(image.shape)) for image in images)
    peak = held * _OF_A_PIXEL[images[0].kind]
    for scale in range(scales):
        before = 0
        for image in [*images, *([images[0]] * 2 if turned else [])]:
            count = _neighbourhoods(image.shape, scale, config)
            kept = _source_bytes(image, count, config)
            sums = 5.3 * area * min(count, _ROWS) + 12 * min(count, _MANY) + area * _MANY * (count > _MANY)
            preparing = kept + _SMALL + max(6.3 * area * min(count, config.candidates), sums)
            peak = max(peak, held + area * count + round(max(before + 2 * area * count, preparing)))
            held += kept
            before = area * count  # the neighbourhoods of the last picture go when the next ones are there
    return held, peak


def _neighbourhoods(shape: Sequence[int], scale: int, config: MrfConfig) -> int:
    """How many a picture has at a scale."""
    stride, edge = 2**scale, config.neighbourhood - 1
    corners = np.ndindex(stride, stride) if config.every else [(0, 0)]
    return sum(
        int(np.prod([max(0, -(-(side - first) // stride) - edge) for side, first in zip(shape, corner, strict=True)]))
        for corner in corners
    )


def _source_bytes(image: Image, count: int, config: MrfConfig) -> int:
    """What is kept of so many neighbourhoods, were they all different."""
    chosen, around = min(count, config.candidates), config.neighbourhood**2 - 1
    phases = len(np.unique(image.values)) if image.kind == "labels" else 0
    if phases and config.relaxation != "icm":
        words = -(-around // (64 // codes_of(phases)[1]))
        return chosen * (8 * words + 10)
    channels = 3 if image.kind == "colour" else phases if phases > 2 else 1
    levels = {"labels": phases, "grey": config.levels, "colour": config.colours}[image.kind]
    return chosen * (4 * around * (2 * channels + 1) + 13) + 8 * levels**2 + _TABLES


@dataclass(frozen=True)
class Run:
    """What a run's memory depends on.

    `shape` is that of the finest lattice, `pairs` the ones that are coupled (None: none), `frames` how many sets of planes the
    sweeps go by, `threads` how many work at once.
    """

    request: Request
    shape: tuple[int, ...]
    content: Content
    sources: Sequence[Source]
    views: int
    frames: int
    pairs: Pairs | None
    config: MrfConfig
    threads: int

    @property
    def scratch(self) -> int:
        """What batches of sites take in all threads."""
        content = self.content
        around, (levels, channels) = self.config.neighbourhood**2 - 1, content.features.shape
        shares = levels * (24 * self.views + 24) + around * 11
        words = [len(source.bits) for source in self.sources if source.bits is not None]
        if words:
            return self.threads * BATCH_OF_BITS * (shares + 16 * max(words))
        widest = max(len(source.centres) for source in self.sources)
        return self.threads * (BATCH_OF_PRODUCTS * (shares + 4 * widest + 4 * around * (channels + 1)) + 5 * widest)

    @property
    def output(self) -> int:
        """The lattices of all scales, and the most that anything takes beside them; the scratch of sites comes on top."""
        most = max(*self._sites(), *self._couplings(), self._rest() - self.scratch)
        return self._held() + most

    def _held(self) -> int:
        """From the first sweep to the last, coarser scales included."""
        voxels, (levels, channels) = int(np.prod(self.shape, dtype=np.int64)), self.content.features.shape
        each = 4 * 8 / 7 + 9 / 8 * (self.frames + 5 * (self.config.relaxation == "icm"))
        if self.pairs is not None:
            each += 9 / 8 * 2 * channels
        return round(voxels * each) + 9 * self._offsets + 8 * self.frames * self.views * levels**2

    @property
    def _offsets(self) -> int:
        """How many a coupling has."""
        if self.pairs is None:
            return 0
        z, y, x = self.pairs.reach
        return (z + 1) * (2 * y + 1) * (2 * x + 1)

    def _sites(self) -> tuple[int, int]:
        """A class of sites with their scores, and then with the groups' scores less what scratch there was before."""
        levels, channels = self.content.features.shape
        groups = int(self.content.groups.max()) + 1
        sites = int(np.prod(self.shape, dtype=np.int64)) // (self.config.neighbourhood // 2 + 1) ** 2
        each = 32 + 4 * levels + self.views * channels
        return each * sites, (each + self.config.shares * (4 * levels + 8 * groups + 8)) * sites - self.scratch

    def _couplings(self) -> tuple[int, int]:
        """The offsets when they are numbered, and the transforms of a field."""
        if self.pairs is None:
            return 0, 0
        depth, height, width = self.shape
        spectrum = 8 * depth * height * (width // 2 + 1)
        each = _CONVOLVED + _BEFORE * (self.content.features.shape[1] > 1)
        fields = 2 * spectrum + each * depth * height * width
        return 32 * self._offsets - self.scratch, 16 * self._offsets + fields - self.scratch

    def _rest(self) -> int:
        """A scale's start, what is known as levels, and the values that come out."""
        request, levels = self.request, len(self.content.values)
        each = self.content.values[0].nbytes
        start = (_STARTING + _IN_A_FORM * (request.mask is not None)) * int(np.prod(self.shape, dtype=np.int64))
        known = 0 if request.known is None else int(np.count_nonzero(request.known))
        taken = (each + 24) * known
        if self.content.kind == "colour":
            taken = 80 * known + 40 * levels * min(known, 4096)
        return max(start, taken, (each + 1) * int(np.prod(request.shape, dtype=np.int64)))
