"""A smooth offset of a field, by which the fraction of a phase around every place is met.

The offset is stored at the middles of blocks of a few voxels and linear between them, so that a
step costs one look at the field, and next to no memory:

1. Count in every block the voxels inside the phase, and those near its interface.
2. Sum both over windows of some blocks. What is missing there, divided by how many voxels a step of
   the offset brings in, is a step of Newton's method; taken back through the same windows it does
   not overshoot.

Sums are whole numbers, and all else is done block by block, so the result does not depend on how
the work is divided.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs
from trabecula.synth.shared.box_sums import window_sums
from trabecula.synth.shared.content.fields import UNIT
from trabecula.synth.shared.known_part import WHOLE
from trabecula.synth.shared.matching.region import Region

PARTS = 4096
"""Of a fraction, in whole numbers."""

HALF_A_VOXEL = 16.0 * UNIT
"""Votes. Where bodies are one or two voxels wide, most voxels beside an interface are this near to
it. Those within a whole voxel tell too little of how many a step brings in: steps are twice too
long and swing."""

NARROWEST = 20
"""Voxels a side of the windows whose fraction is held, at least."""

_LENGTHS, _WIDEST = 8.25, 100  # of the structure, of a window; voxels at most
_FINE, _LESS = 12, 18  # the same of a fine structure, less voxels
_BLOCKS = 5, 3  # of a window along every axis, whichever meets its width
_NEAR = 32.0 * UNIT  # votes that count as near the interface: about a voxel
_MOST = 40.0 * UNIT  # by which an offset moves in one step
_HASTE = 1.5  # of a step; from 3 on they would swing
_SLOWLY = 0.5  # the same, where the next votes answer to it
_FEWEST = 1 / 50  # of the voxels count as near an interface at least, so that some can come
_SHARES = np.float32(WHOLE)
_AGAIN = 0.5  # of the last step: what varies within a window is slow to come


def window_of(length: float) -> int:
    """Return the width of the windows whose fraction is held for a structure's length, voxels.

    In windows of 20 voxels, which held a part of a particle, particles were cut up (NMC had 1.7
    times its interface, now .98).
    """
    width = min(_LENGTHS * length, _FINE * length - _LESS, _WIDEST)
    return round(max(width, NARROWEST))


@dataclass
class LocalOffset:
    """The offset of one region's field, and the fractions that it is to meet.

    Attributes
    ----------
    region : Region
        (Z, Y, X) voxels.
    edge : int
        Voxels a side of a block.
    width : int
        Blocks a side of a window.
    wanted, counted : (z, y, x) int64
        Over the window around every block: the target in `PARTS`, and the voxels that count.
    offset : (z, y, x) float32
        At the middles of the blocks, in votes.
    missing : (z, y, x) float32
        Fraction that was missing around every block at the last step.
    shares : (Z, Y, X) uint8, optional
        The part of the offset that every voxel takes, in 64ths. Default: all of it.
    near : float
        Votes that count as near the interface.
    """

    region: Region
    edge: int
    width: int
    wanted: np.ndarray
    counted: np.ndarray
    offset: np.ndarray
    missing: np.ndarray
    shares: np.ndarray | None = None
    near: float = _NEAR
    _step: np.ndarray = field(init=False)
    _blocks: np.ndarray = field(init=False)  # of the window around every block

    def __post_init__(self) -> None:
        ones = np.ones(self.offset.shape, np.int32)
        self._blocks = window_sums(ones, self.width, self.region.wraps)
        self._step = np.zeros_like(self.offset)

    @classmethod
    def of(
        cls,
        region: Region,
        fractions: np.ndarray,
        width: int,
        shares: np.ndarray | None = None,
        near: float = _NEAR,
    ) -> LocalOffset:
        """Prepare windows of about `width` voxels for fractions (z, y, x) float32 of the region's
        beginning; beyond their end the last ones count.
        """
        fits = [(blocks, max(1, round(width / blocks))) for blocks in _BLOCKS]
        blocks, edge = min(fits, key=lambda fit: abs(math.prod(fit) - width))
        shape = tuple(-(-side // edge) for side in region.shape)
        wanted, counted = np.zeros(shape, np.int32), np.zeros(shape, np.int32)
        free = _whole(region)

        def work(start: int, stop: int) -> None:
            _add_targets(
                fractions, free, np.array(region.shape), edge, wanted, counted, start, stop
            )

        for_slabs(work, shape[0])
        zeros = np.zeros(shape, np.float32)
        sums = [
            window_sums(part, blocks, region.wraps).astype(np.int64) for part in (wanted, counted)
        ]
        return cls(region, edge, blocks, sums[0], sums[1], zeros, zeros.copy(), shares, near)

    @property
    def mean(self) -> float:
        """Return the fraction of all that counts, as the windows have it."""
        return float(self.wanted.sum() / max(1, self.counted.sum()) / PARTS)

    def at(self, places: list[np.ndarray]) -> tuple[np.ndarray, ...]:
        """Return the blocks that hold voxels, as an open mesh of one index array an axis."""
        return np.ix_(*(place // self.edge for place in places))

    def step(self, votes: np.ndarray, *, low: float, high: float) -> None:
        """Move the offset of votes (Z, Y, X), int16 or an int8 field, by one step, within bounds;
        what was missing is counted with the offset as it was.
        """
        inside, near = self._count(votes, self.offset)
        self._move(inside, near, low, high, haste=_HASTE, again=_AGAIN)

    def integrate(self, votes: np.ndarray, *, low: float, high: float) -> None:
        """Do `step`, but count without the offset: what votes miss by themselves adds up."""
        inside, near = self._count(votes, np.zeros_like(self.offset))
        self._move(inside, near, low, high, haste=_SLOWLY, again=0.0)

    def shift(self, votes: np.ndarray, *, steps: int, most: float) -> None:
        """Shift votes (Z, Y, X), int16 or an int8 field, in place by `most` at most: by so many
        steps from no offset.
        """
        self.find(votes, steps=steps, most=most)
        self.add_to(votes)

    def find(self, votes: np.ndarray, *, steps: int, most: float) -> None:
        """Find the offset that `shift` adds to votes."""
        self.offset, self._step = np.zeros_like(self.offset), np.zeros_like(self.offset)
        for _ in range(steps):
            self.step(votes, low=-most, high=most)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what the next step starts from."""
        return {"offset": self.offset, "offset step": self._step}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Go on from the arrays of a checkpoint."""
        self.offset, self._step = arrays["offset"], arrays["offset step"]

    def _count(self, votes: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Count voxels inside and near the interface, over the windows around every block."""
        tallies = [np.zeros(offset.shape, np.int32) for _ in range(2)]
        free, wraps = _whole(self.region), np.array(self.region.wraps)
        scale = np.int32(UNIT if votes.dtype == np.int8 else 1)

        def work(start: int, stop: int) -> None:
            _tally(
                votes,
                free,
                self._taken,
                offset,
                self.edge,
                wraps,
                scale,
                np.float32(self.near),
                tallies[0],
                tallies[1],
                start,
                stop,
            )

        for_slabs(work, len(offset))
        inside, near = (window_sums(one, self.width, self.region.wraps) for one in tallies)
        return inside.astype(np.int64), near.astype(np.int64)

    def _move(
        self,
        inside: np.ndarray,
        near: np.ndarray,
        low: float,
        high: float,
        *,
        haste: float,
        again: float,
    ) -> None:
        """Take a step, and so much of the last one `again`."""
        counts = np.maximum(self.counted, 1)
        missing = (self.wanted - inside * PARTS) // counts
        around = window_sums(missing.astype(np.int32), self.width, self.region.wraps)
        self.missing = (around / (self._blocks * float(PARTS))).astype(np.float32)
        slope = np.maximum(near / counts, _FEWEST) / (2 * self.near)
        step = np.clip(haste * self.missing / slope, -_MOST, _MOST)
        self._step = (np.float32(again) * self._step + step).astype(np.float32)
        moved = np.clip(self.offset + self._step, low, high)
        self._step = moved - self.offset
        self.offset = moved

    def blend(self, votes: np.ndarray, others: np.ndarray, *, whole: float) -> None:
        """Go from votes (Z, Y, X) int16 to others, in place: all of the way where the offset is
        `whole` votes or more, and where it is less, the square of its part of them.
        """
        wraps = np.array(self.region.wraps)

        def work(start: int, stop: int) -> None:
            _blend(
                votes,
                others,
                self._taken,
                self.offset,
                self.edge,
                wraps,
                np.float32(whole),
                start,
                stop,
            )

        for_slabs(work, len(self.offset))

    @property
    def _taken(self) -> np.ndarray:
        """Return the shares, for the kernels: an empty array means all of the offset."""
        return np.empty((0, 0, 0), np.uint8) if self.shares is None else self.shares

    def add_to(self, votes: np.ndarray) -> None:
        """Add the offset to votes (Z, Y, X) int16, or to an int8 field, in place."""
        wraps = np.array(self.region.wraps)
        scale = np.int32(UNIT if votes.dtype == np.int8 else 1)
        most = np.iinfo(votes.dtype).max

        def work(start: int, stop: int) -> None:
            _add(votes, self._taken, self.offset, self.edge, wraps, scale, most, start, stop)

        for_slabs(work, len(self.offset))


def _whole(region: Region) -> np.ndarray:
    """Return the free voxels, for the kernels: an empty array means all of them."""
    return np.empty((0, 0, 0), np.bool_) if region.free is None else region.free


@kernel
def _add_targets(fractions, free, shape, edge, wanted, counted, start, stop):
    """Add up the target, and the voxels that count, of every block of some layers of blocks."""
    depth, height, width = fractions.shape
    for z in range(start * edge, min(stop * edge, shape[0])):
        for y in range(shape[1]):
            for x in range(shape[2]):
                if free.size and not free[z, y, x]:
                    continue
                part = fractions[min(z, depth - 1), min(y, height - 1), min(x, width - 1)]
                at = (z // edge, y // edge, x // edge)
                wanted[at] += np.int32(np.rint(part * np.float32(PARTS)))
                counted[at] += 1


@inline
def _between(place, edge, count, wraps):
    """Return the blocks before and behind a voxel's middle, and the share of the one behind."""
    at = (2 * place + 1 - edge) / np.float32(2 * edge)
    first = np.int64(np.floor(at))
    share = np.float32(at - first)
    behind = first + 1
    if wraps:
        return first % count, behind % count, share
    return min(max(first, 0), count - 1), min(max(behind, 0), count - 1), share


@kernel
def _places_between(side, edge, count, wraps):
    """Return the blocks before and behind every voxel of an axis, and the share of the latter."""
    before, behind = np.empty(side, np.int64), np.empty(side, np.int64)
    share = np.empty(side, np.float32)
    for x in range(side):
        before[x], behind[x], share[x] = _between(x, edge, count, wraps)
    return before, behind, share


@inline
def _fill_row(offset, shares, edge, wraps, z, y, line, before, behind, share, row):
    """Write the offset of one row of voxels, as much of it as each takes; `line` has room for it at
    the blocks' middles.
    """
    z0, z1, c = _between(z, edge, offset.shape[0], wraps[0])
    y0, y1, b = _between(y, edge, offset.shape[1], wraps[1])
    one = np.float32(1)
    for k in range(len(line)):
        line[k] = (one - c) * ((one - b) * offset[z0, y0, k] + b * offset[z0, y1, k]) + c * (
            (one - b) * offset[z1, y0, k] + b * offset[z1, y1, k]
        )
    for x in range(len(row)):
        row[x] = (one - share[x]) * line[before[x]] + share[x] * line[behind[x]]
        if shares.size:
            row[x] *= np.float32(shares[z, y, x]) / _SHARES


@kernel
def _tally(votes, free, shares, offset, edge, wraps, scale, limit, inside, near, start, stop):
    """Count the voxels of every block that are inside with their shares of the offset, and within a
    limit of the interface.
    """
    depth, height, width = votes.shape
    line, row = np.empty(offset.shape[2], np.float32), np.empty(width, np.float32)
    before, behind, share = _places_between(width, edge, len(line), wraps[2])
    for z in range(start * edge, min(stop * edge, depth)):
        for y in range(height):
            _fill_row(offset, shares, edge, wraps, z, y, line, before, behind, share, row)
            for k in range(len(line)):
                held, close = np.int32(0), np.int32(0)
                for x in range(k * edge, min((k + 1) * edge, width)):
                    if free.size and not free[z, y, x]:
                        continue
                    value = np.float32(np.int32(votes[z, y, x]) * scale) + row[x]
                    held += np.int32(value > 0)
                    close += np.int32(-limit <= value <= limit)
                inside[z // edge, y // edge, k] += held
                near[z // edge, y // edge, k] += close


@kernel
def _add(votes, shares, offset, edge, wraps, scale, most, start, stop):
    """Add the shares of the offset to some layers of blocks."""
    depth, height, width = votes.shape
    line, row = np.empty(offset.shape[2], np.float32), np.empty(width, np.float32)
    before, behind, share = _places_between(width, edge, len(line), wraps[2])
    for z in range(start * edge, min(stop * edge, depth)):
        for y in range(height):
            _fill_row(offset, shares, edge, wraps, z, y, line, before, behind, share, row)
            for x in range(width):
                by = np.int32(np.rint(row[x]))
                value = np.int32(votes[z, y, x]) + (by + scale // 2) // scale
                votes[z, y, x] = min(max(value, -most), most)


@kernel
def _blend(votes, others, shares, offset, edge, wraps, whole, start, stop):
    """Go some of the way from votes to others, in some layers of blocks."""
    depth, height, width = votes.shape
    line, row = np.empty(offset.shape[2], np.float32), np.empty(width, np.float32)
    before, behind, share = _places_between(width, edge, len(line), wraps[2])
    one = np.float32(1)
    for z in range(start * edge, min(stop * edge, depth)):
        for y in range(height):
            _fill_row(offset, shares, edge, wraps, z, y, line, before, behind, share, row)
            for x in range(width):
                part = min(np.square(row[x] / whole), one)
                here = np.int32(votes[z, y, x])
                far = np.float32(np.int32(others[z, y, x]) - here)  # may leave the votes' range
                votes[z, y, x] = here + np.int32(np.rint(part * far))
