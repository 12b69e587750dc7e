"""How much memory `mrf` will take, from shapes and settings alone; the factors were measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.synth.mrf.config import MrfConfig
from trabecula.synth.mrf.content import Content
from trabecula.synth.mrf.patches import Source, codes_of
from trabecula.synth.mrf.slice_planes import BATCH_OF_BITS, BATCH_OF_PRODUCTS
from trabecula.synth.shared.statistics.pairs import Pairs

_ROWS, _MANY = 4096, 65536  # neighbourhoods that are summed at once, and in all
_TABLES = 80_000  # bytes of the two tables of a source
_SMALL = 100_000  # bytes of what does not depend on the picture
_OF_A_PIXEL = {"labels": 10, "grey": 20, "colour": 132}  # bytes that numbering the levels takes
_OF_A_SITE = 42  # bytes while it is told whether sites lie in the result
_OF_A_PLANE = 40  # bytes a pixel of what starts a scale plane by plane


def learning_bytes(
    images: Sequence[Image], scales: int, config: MrfConfig, *, turned: bool
) -> tuple[int, int]:
    """What is kept of the pictures once they are learnt at all scales, and the most that it takes
    meanwhile.
    """
    area, held = config.neighbourhood**2, sum(int(np.prod(image.shape)) for image in images)
    peak = held * _OF_A_PIXEL[images[0].kind]
    for scale in range(scales):
        before = 0
        for image in [*images, *([images[0]] * 2 if turned else [])]:
            count = _neighbourhoods(image.shape, scale, config)
            kept = _source_bytes(image, count, config)
            sums = (
                5.3 * area * min(count, _ROWS)
                + 12 * min(count, _MANY)
                + area * _MANY * (count > _MANY)
            )
            preparing = kept + _SMALL + max(6.3 * area * min(count, config.candidates), sums)
            peak = max(peak, held + area * count + round(max(before + 2 * area * count, preparing)))
            held += kept
            # the neighbourhoods of the last picture go when the next ones are there
            before = area * count
    return held, peak


def _neighbourhoods(shape: Sequence[int], scale: int, config: MrfConfig) -> int:
    """How many a picture has at a scale."""
    stride, edge = 2**scale, config.neighbourhood - 1
    corners = np.ndindex(stride, stride) if config.every else [(0, 0)]
    return sum(
        int(
            np.prod(
                [
                    max(0, -(-(side - first) // stride) - edge)
                    for side, first in zip(shape, corner, strict=True)
                ]
            )
        )
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

    `shape` is that of the finest lattice, `pairs` the ones that are coupled (None: none), `threads`
    how many work at once.
    """

    request: Request
    shape: tuple[int, ...]
    content: Content
    sources: Sequence[Source]
    views: int
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
        return self.threads * (
            BATCH_OF_PRODUCTS * (shares + 4 * widest + 4 * around * (channels + 1)) + 5 * widest
        )

    @property
    def output(self) -> int:
        """The lattices of all scales, and the most that anything takes beside them; the scratch of
        sites comes on top.
        """
        beside = *self._sites(), self._couplings() - self.scratch, self._values() - self.scratch
        return self._held() + max(0, *beside)

    @property
    def slab(self) -> int:
        """What the thinnest slabs take where all that is as large as the result lies in files."""
        _, height, width = self.shape
        levels, each = len(self.content.values), self.content.values[0].nbytes
        sites = _OF_A_SITE * height * width // (self.config.neighbourhood // 2 + 1) ** 2
        plane = (_OF_A_PLANE + 2 * each) * height * width
        if self.request.known is not None and self.content.kind == "colour":
            plane += 80 * height * width + 40 * levels * _ROWS
        most = self.threads * max(plane, sites + _ROWS * 4 * levels)
        if self.pairs is not None:
            most = max(most, self.pairs.slab_bytes + self.pairs.lines_bytes)
        return self.scratch + self._tables + 2 * _SMALL + most

    @property
    def _voxels(self) -> int:
        return int(np.prod(self.shape, dtype=np.int64))

    @property
    def _tables(self) -> int:
        """Of the offsets of pairs: their bins, and their weights for a while."""
        return 0 if self.pairs is None else self.pairs.table_bytes * 3 // 2

    def _held(self) -> int:
        """From the first sweep to the last, coarser scales included."""
        levels, channels = self.content.features.shape
        marks = (self.request.mask is not None) + (self.request.known is not None)
        each = (1 + marks) * 8 / 7 + 5 * (self.config.relaxation == "icm")
        if self.pairs is not None:
            each += 9 / 8 * 2 * channels
        return (
            round(self._voxels * each) + 8 * 4 * self.views * levels**2 + self._tables + 2 * _SMALL
        )

    def _sites(self) -> tuple[int, int]:
        """A class of sites with their scores, and then with the groups' scores less what scratch
        there was before.
        """
        levels, channels = self.content.features.shape
        groups = int(self.content.groups.max()) + 1
        sites = self._voxels // (self.config.neighbourhood // 2 + 1) ** 2
        rows = 4 * levels + self.views * channels * (self.config.feedback_of(self.content.sort) > 0)
        return (8 + rows) * sites, self.config.shares * (
            rows + 8 * groups + _OF_A_SITE
        ) * sites - self.scratch

    def _couplings(self) -> int:
        """The transforms of a field."""
        if self.pairs is None:
            return 0
        return (
            2 * self.pairs.spectrum_bytes
            + self.pairs.kernel_bytes
            + 4 * self._voxels
            + self.pairs.slab_bytes
        )

    def _values(self) -> int:
        """The values that come out."""
        each = self.content.values[0].nbytes
        return each * int(np.prod(self.request.shape, dtype=np.int64))
