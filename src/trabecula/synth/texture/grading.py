"""A porosity that varies from place to place: what neighbourhoods are guided by, and what the field leans to.

Two means together. The search prefers neighbourhoods from places of the exemplar that are as dense as is asked for
(one more feature: the share of the phase around them), and after every vote the field is shifted, smoothly, until the share
around every voxel is the one asked for: struts grow or thin where the exemplar holds nothing dense or sparse enough.

On a coarser level a phase has another share (thin struts vanish first): what is asked for is carried over along straight
lines through (0, 0), (the exemplar's share, its share on that level) and (1, 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.request import Request
from trabecula.core.target import porosity_of
from trabecula.engine.compile import kernel
from trabecula.engine.tiles import for_slabs
from trabecula.synth.shared.histogram import Histogram
from trabecula.synth.shared.matching.grid import Grid, with_guide
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Candidates, Stack
from trabecula.synth.shared.pyramid import fit_to, halve

_WINDOW, _LEAST = 24, 6  # voxels a side in which a share is taken: of the finest level, and of any at least
_WIDE = 64  # where one share is asked for everywhere: it varies within as it does in the exemplar
_UNIT = 4096  # of a share, in whole numbers
_PULL = 16_000  # features between a share of 0 and one of 1
_NEAR = 32  # values of the field that count as near the interface: about a voxel
_MOST = 40  # by which a field is shifted in one step
_HASTE = 1.5  # of a step; from 3 on they would swing
_LAST = 16  # steps at the end
BEYOND = 0.5
"""How far outside the exemplar's own porosities the shift reaches with struts that still look like it: of the way to 0
and to 1."""
BYTES = 40
"""Of a voxel: the windows' sums, and what a step takes."""


@dataclass(frozen=True)
class Leaning:
    """What one level's grid is asked for: the share of the phase around every voxel of its region."""

    region: Region
    wanted: np.ndarray
    """(Z, Y, X) int32: sums over the windows of what is asked for, in `_UNIT`."""
    counted: np.ndarray
    """(Z, Y, X) int32: voxels of the windows that count."""
    width: int
    mean: float
    """The share of all that counts."""

    @classmethod
    def of(cls, region: Region, shares: np.ndarray, width: int) -> Leaning:
        """For a region that is covered, with shares (z, y, x) float32 of its beginning."""
        grown = fit_to(shares[None], region.shape)[0]
        counts = np.ones(region.shape, bool) if region.free is None else region.free
        whole = np.rint(grown * np.float32(_UNIT)).astype(np.int32) * counts
        mean = float(whole.sum(dtype=np.int64) / max(1, np.count_nonzero(counts)) / _UNIT)
        return cls(region, sums(whole, width, region.wraps), sums(counts, width, region.wraps), width, mean)

    def guide(self, grid: Grid) -> np.ndarray:
        """What is asked for around the middle of every site, as a feature (sz, sy, sx, 1) int16."""
        box, steps = grid.candidates.basis.box, grid.candidates.steps
        at = [
            (np.arange(count) * step + w // 2) % side
            for count, step, w, side in zip(grid.shape, steps, box, self.region.shape, strict=True)
        ]
        mesh = np.ix_(*at)
        return _feature(self.wanted[mesh], self.counted[mesh])[..., None]

    def leaned(self, field: np.ndarray) -> np.ndarray:
        """A field (1, Z, Y, X) int8, shifted towards what is asked for."""
        shift = self.shift(field[0])
        return np.clip(field + shift, -127, 127).astype(np.int8)

    def shift(self, field: np.ndarray) -> np.ndarray:
        """(Z, Y, X) int16: what has to be added, in a step of Newton's method on the shares around every voxel."""
        wraps, width = self.region.wraps, self.width
        counts = np.ones(self.region.shape, bool) if self.region.free is None else self.region.free
        missing = sums((field > 0) & counts, width, wraps)
        for_slabs(lambda a, b: _miss(self.wanted, self.counted, missing, a, b), len(missing))
        # Taken back through the same windows: a step at every voxel for its own window alone would overshoot and swing.
        missing = sums(missing, width, wraps)
        near = sums((np.abs(field.astype(np.int16)) <= _NEAR) & counts, width, wraps)
        shift = np.empty(field.shape, np.int16)
        for_slabs(lambda a, b: _shift(missing, near, self.counted, shift, a, b), len(shift))
        return shift


def leaning_grid(grid: Grid, shares: np.ndarray, index: int) -> tuple[Grid, Leaning]:
    """A grid of level `index` whose search is guided, and what its field leans to; shares are those of that level."""
    even = bool((shares == shares.flat[0]).all())
    width = max(_LEAST, (_WIDE if even else _WINDOW) // 2**index)
    leaning = Leaning.of(grid.region, shares, width)
    own, mean = share_in(grid.candidates.stack), float(leaning.mean)
    targets = tuple(Histogram.leaning(h, mean / own, (1 - mean) / (1 - own)) for h in grid.targets)
    grid = replace(grid, candidates=guided(grid.candidates, width))
    return replace(grid, targets=targets, guide=leaning.guide(grid)), leaning


def check_phases(present: tuple[int, ...], empty: int) -> None:
    """Raise where a target porosity does not say how much of each phase there is to be."""
    if len(present) != 2 or empty not in present:
        raise RequestError(
            f"a target porosity is honoured for a void and one other phase, the exemplar holds {len(present)} phases: "
            "merge them (tb.segment with one threshold), or leave the target out"
        )


def shares_of(request: Request, present: tuple[int, ...], empty: int) -> np.ndarray:
    """(Z, Y, X) float32: the share that the upper of two phases is to have at every voxel."""
    porosity = np.broadcast_to(np.asarray(porosity_of(request.target), np.float32), request.shape)
    return np.ascontiguousarray(porosity if present[1] == empty else 1 - porosity)


def shares_by_level(shares: np.ndarray, stacks: Sequence[Stack]) -> list[np.ndarray]:
    """What shares at every voxel are at the resolution of each stack, finest first."""
    own, found = share_in(stacks[0]), []
    for stack in stacks:
        found.append(carried_over(shares, own, share_in(stack)))
        shares = halve(shares[None])[0]
    return found


def carried_over(shares: np.ndarray, own: float, there: float) -> np.ndarray:
    """What shares become on a level where the exemplar's own share is `there`."""
    return np.interp(shares, (0.0, own, 1.0), (0.0, there, 1.0)).astype(np.float32)


def share_in(stack: Stack) -> float:
    """The share of the phase in the exemplars' volumes."""
    inside = sum(
        np.count_nonzero(stack.field[0, start : start + z, :y, :x] > 0)
        for start, (z, y, x) in zip(stack.starts, stack.sides, strict=True)
    )
    return float(inside / np.prod(stack.sides.astype(np.int64), axis=1).sum())


def guided(candidates: Candidates, width: int) -> Candidates:
    """Candidates with one more feature: the share of the phase in the window around them."""
    stack = candidates.stack
    inside = np.zeros(stack.field.shape[1:], np.int32)
    counts = np.zeros_like(inside)
    for start, (z, y, x) in zip(stack.starts, stack.sides, strict=True):
        at = (slice(start, start + z), slice(0, y), slice(0, x))
        inside[at] = sums(stack.field[0][at] > 0, width, (False,) * 3)
        counts[at] = sums(np.ones((z, y, x), bool), width, (False,) * 3)
    middle = [
        np.arange(count) * stride + w // 2
        for count, stride, w in zip(candidates.shape, candidates.strides, candidates.basis.box, strict=True)
    ]
    mesh = np.ix_(*middle)
    share = _feature(inside[mesh].astype(np.int64) * _UNIT, counts[mesh])
    return replace(candidates, features=with_guide(candidates.features >> 1, share.reshape(-1, 1)))


def _feature(sums_: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Sums of shares over windows of some voxels, as a feature."""
    return np.asarray(sums_.astype(np.int64) * _PULL // (np.maximum(counts, 1).astype(np.int64) * _UNIT), np.int16)


def settled(votes: np.ndarray, leaning: Leaning) -> np.ndarray:
    """The last votes (1, Z, Y, X) int16, shifted until the shares are those asked for."""
    field = votes[0].astype(np.int32)
    moved = np.zeros_like(field)
    for _ in range(_LAST):
        rounded = np.clip((field + 128) >> 8, -127, 127).astype(np.int8)
        moved >>= 1  # half of the last step again: what varies within a window is slow to come
        moved += leaning.shift(rounded).astype(np.int32) * 256
        field += moved
    return np.clip(field, -(1 << 15) + 1, (1 << 15) - 1).astype(np.int16)[None]


def evened(request: Request) -> Request:
    """The request with one number as its target: the mean of what is asked for."""
    porosity = np.asarray(porosity_of(request.target))
    inside = porosity[request.mask] if porosity.ndim and request.mask is not None else porosity
    return replace(request, target={"porosity": float(inside.mean(dtype=np.float64))})


def sums(values: np.ndarray, width: int, wraps: tuple[bool, ...]) -> np.ndarray:
    """(Z, Y, X) int32: sums over the windows of `width` voxels around every voxel; beyond an open face lies nothing."""
    total = values.astype(np.int32)
    for axis in range(3):
        lines = np.moveaxis(total, axis, 1) if axis == 0 else total
        for_slabs(lambda a, b, k=axis, v=lines: _slide(v, width, k == 2, wraps[k], a, b), len(lines))  # type: ignore[misc]
    return total


@kernel
def _slide(lines, width, along_last, wraps, start, stop):
    """Running sums in place: of (n, side, m) along the second axis, or along the last one."""
    before, after = width // 2, width - width // 2  # of the voxels beside a voxel: itself counts to those after
    side = lines.shape[2] if along_last else lines.shape[1]
    line = np.empty(side, np.int64)
    for n in range(start, stop):
        for m in range(lines.shape[1] if along_last else lines.shape[2]):
            for k in range(side):
                line[k] = lines[n, m, k] if along_last else lines[n, k, m]
            total = np.int64(0)
            for k in range(-before, after):
                total += line[k % side] if wraps else (line[k] if 0 <= k < side else 0)
            for k in range(side):
                if along_last:
                    lines[n, m, k] = total
                else:
                    lines[n, k, m] = total
                low, high = k - before, k + after
                if wraps:
                    total += line[high % side] - line[low % side]
                else:
                    total += line[high] if high < side else 0
                    total -= line[low] if low >= 0 else 0


@kernel
def _miss(wanted, counted, have, start, stop):
    """What is missing from the share around every voxel, in `_UNIT`, written over what is there."""
    for z in range(start, stop):
        for y in range(have.shape[1]):
            for x in range(have.shape[2]):
                missing = wanted[z, y, x] - np.int64(have[z, y, x]) * _UNIT
                have[z, y, x] = missing // max(counted[z, y, x], 1)


@kernel
def _shift(missing, near, counted, shift, start, stop):
    """What is missing, averaged over a window, over what a shift by 1 would add."""
    for z in range(start, stop):
        for y in range(shift.shape[1]):
            for x in range(shift.shape[2]):
                # Where no interface is near there is nothing to shift: 1 in 50 voxels at least, so that some can come.
                slope = max(near[z, y, x], counted[z, y, x] / 50.0) / (2 * _NEAR + 1)
                step = _HASTE * (missing[z, y, x] / _UNIT) / slope if slope > 0.0 else 0.0
                shift[z, y, x] = np.int16(np.rint(min(max(step, -_MOST), _MOST)))
