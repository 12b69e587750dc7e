"""Volume fractions that vary from place to place: the target at every voxel on every level, the
guide of the search, and the shift of the field.

The search prefers neighbourhoods from places of the exemplar that are as dense as the target (one
more feature: the fraction of the phase around them), and after every vote the field is shifted,
smoothly, until the fraction around every voxel is that of the target: struts grow or thin where
the exemplar holds nothing dense or sparse enough. On a coarser level a phase has another fraction
(thin struts vanish first): the target is carried over along straight lines through (0, 0), (the
exemplar's fraction, its fraction on that level) and (1, 1).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.request import Request
from trabecula.core.target import porosity_of
from trabecula.engine import memmap
from trabecula.engine.compile import kernel
from trabecula.engine.memory import Array, Stage, Workspace, within
from trabecula.engine.parallel import for_slabs, sum_slabs, thread_count
from trabecula.synth.shared.box_sums import (
    replace_by_window_sums,
    window_sums_of_planes,
)
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.held_fractions import (
    PULL,
    add_fraction_feature,
    fraction_feature,
    phase_fraction,
    window_at,
)
from trabecula.synth.shared.local_offset import PARTS, LocalOffset
from trabecula.synth.shared.matching.grid import Grid
from trabecula.synth.shared.matching.region import Region

BEYOND = 0.5
"""Reach of the shift outside the exemplar's own porosities, with struts that still look like it:
of the way to 0 and to 1."""

_WINDOW = 24  # voxels a side of a window on the finest level
_LEAD = 0.5  # of what is missing around a place, by which its guide moves after a vote
_FARTHEST = 0.25  # fraction by which a guide moves at most
_WIDE = 64  # where the target is one number: fractions vary within as they do in the exemplar
_NEAR = 32  # values of the field that count as near the interface: about a voxel
_MOST = 40  # by which a field is shifted in one step
_HASTE = 1.5  # of a step; from 3 on they would swing
_LAST = 16  # steps at the end

_AROUND = 1 << 16  # bytes of a file that the system maps at once where one is read


def check_phases(present: tuple[int, ...], empty: int) -> None:
    """Raise where a target porosity does not say how much of each phase there is to be."""
    if len(present) != 2 or empty not in present:
        raise RequestError(
            "a target porosity is honoured for a void and one other phase, the exemplar holds "
            f"{len(present)} phases: "
            "merge them (tb.segment with one threshold), or leave the target out"
        )


def target_fractions(request: Request, present: tuple[int, ...], empty: int) -> np.ndarray:
    """Return the volume fraction that the upper of two phases is to have at every voxel, (Z, Y, X)
    float32.
    """
    fractions = memmap.empty(request.shape, np.float32)

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            porosity = np.asarray(_porosity_on(request, slice(z, z + 1)), np.float32)
            fractions[z] = porosity if present[1] == empty else 1 - porosity

    for_slabs(work, len(fractions))
    return fractions


def _porosity_on(request: Request, planes: slice) -> float | np.ndarray:
    """Return the requested porosity on planes, or everywhere."""
    target = {
        name: value[planes] if isinstance(value, np.ndarray) else value
        for name, value in request.target.items()
    }
    requested = porosity_of(target)
    return 0.0 if requested is None else requested


def average_target(request: Request, *, free: bool = False) -> Request:
    """Return the request with one number as its target: the mean of its field, or of that in `free`
    voxels.
    """
    if not any(map(np.ndim, request.target.values())):
        return replace(request, target={"porosity": float(_porosity_on(request, slice(None)))})
    planes = np.zeros((request.shape[0], 2))

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            requested = np.asarray(_porosity_on(request, slice(z, z + 1)))[0]
            inside = np.ones_like(requested, bool) if request.mask is None else request.mask[z]
            if free and request.known is not None:
                inside = inside & ~request.known[z]
            planes[z] = requested.sum(dtype=np.float64, where=inside), np.count_nonzero(inside)

    for_slabs(work, len(planes))
    return replace(request, target={"porosity": math.fsum(planes[:, 0]) / math.fsum(planes[:, 1])})


@dataclass(frozen=True)
class FractionTarget:
    """Target of one level's grid: the fraction of the phase around every voxel of its region."""

    region: Region
    wanted: np.ndarray
    """(Z, Y, X) int32: sums of the target over the windows, in `PARTS`."""
    counted: np.ndarray
    """(Z, Y, X) int32: voxels of the windows that count."""
    width: int
    mean: float
    """The fraction of all that counts."""

    @classmethod
    def of(cls, region: Region, fractions: np.ndarray, width: int) -> FractionTarget:
        """Sum the target of a region that is covered over windows, with fractions (z, y, x) float32
        of its beginning.
        """
        places = [
            np.arange(side).clip(max=have - 1)
            for side, have in zip(region.shape, fractions.shape, strict=True)
        ]
        free, wraps = region.free, region.wraps

        def counts(start: int, stop: int) -> np.ndarray:
            some = (stop - start, *region.shape[1:])
            return np.ones(some, bool) if free is None else free[start:stop]

        def whole(start: int, stop: int) -> np.ndarray:
            near = fractions[np.ix_(places[0][start:stop], *places[1:])]
            return np.rint(near * np.float32(PARTS)).astype(np.int32) * counts(start, stop)

        wanted, requested = window_sums_of_planes(whole, region.shape, width, wraps)
        counted, voxels = window_sums_of_planes(counts, region.shape, width, wraps)
        return cls(region, wanted, counted, width, float(requested / max(1, voxels) / PARTS))

    def guide(self, grid: Grid) -> np.ndarray:
        """Return the target around the middle of every site, as a feature (sz, sy, sx, 1) int16."""
        at = grid.middles
        guide = memmap.empty((*grid.shape, 1), np.int16)

        def work(start: int, stop: int) -> None:
            for sz in range(start, stop):
                mesh = (at[0][sz], *np.ix_(*at[1:]))
                guide[sz, ..., 0] = fraction_feature(self.wanted[mesh], self.counted[mesh])

        for_slabs(work, len(guide))
        return guide

    def shift_field(self, field: np.ndarray) -> np.ndarray:
        """Shift a field (1, Z, Y, X) int8 towards the target."""
        shifted = memmap.empty(field.shape, np.int8)

        def add(z: int, shift: np.ndarray) -> None:
            shifted[0, z] = np.clip(field[0, z] + shift, -127, 127)

        self.step(lambda start, stop: field[0, start:stop], add)
        return shifted

    def step(
        self, field: Callable[[int, int], np.ndarray], use: Callable[[int, np.ndarray], None]
    ) -> None:
        """Take a step of Newton's method on the fractions around every voxel.

        Parameters
        ----------
        field : callable
            Makes planes a..b (n, Y, X) of the field, in units of an int8 one.
        use : callable
            Takes z and what has to be added there, (Y, X) int16; called once a plane, after the
            last call of `field`.
        """
        region, width = self.region, self.width

        def free(marked: np.ndarray, start: int) -> np.ndarray:
            held = region.free
            return marked if held is None else marked & held[start : start + len(marked)]

        def inside(start: int, stop: int) -> np.ndarray:
            return free(field(start, stop) > 0, start)

        def beside(start: int, stop: int) -> np.ndarray:
            return free(np.abs(field(start, stop).astype(np.int16)) <= _NEAR, start)

        work = Workspace(shift_stages(region.shape))
        work.enter("shift")
        near, missing = (
            work.adopt(name, window_sums_of_planes(part, region.shape, width, region.wraps)[0])
            for name, part in (("near", beside), ("missing", inside))
        )
        # Taken back through the same windows: a step at every voxel for its own window alone would
        # overshoot and swing.
        replace_by_window_sums(
            missing,
            width,
            region.wraps,
            lambda a, b: _miss(self.wanted, self.counted, missing, a, b),
        )

        def shift(start: int, stop: int) -> None:
            plane = np.empty(missing.shape[1:], np.int16)
            for z in range(start, stop):
                _shift(missing[z], near[z], self.counted[z], plane)
                use(z, plane)

        for_slabs(shift, len(missing))


def fraction_arrays(
    shape: tuple[int, ...], sites: tuple[int, ...], grading: str, more: int = 0
) -> dict[str, Array]:
    """Declare the guide of a search, with so many `more` features than the fraction, and the arrays
    of a `FractionTarget` of so many voxels.
    """
    guide = {"guide": Array((*sites, 1 + more), np.int16, axis=-4)}
    if grading != "shift":
        return guide
    sums = Array(shape, np.int32)
    return {"wanted": sums, "counted": sums, **guide}


def shift_stages(shape: tuple[int, ...]) -> tuple[Stage, ...]:
    """Declare the arrays of a step of `FractionTarget`."""
    sums = Array(shape, np.int32)
    # some planes, and a row of whole columns along z
    beside = 60 * shape[1] * shape[2] + shape[0] * (4 * shape[2] + _AROUND)
    return (Stage("shift", {"near": sums, "missing": sums}, thread_count() * beside),)


def settle_stages(shape: tuple[int, ...]) -> tuple[Stage, ...]:
    """Declare the arrays of `settle_fractions` beside the votes."""
    held, votes = {"settling": Array(shape, np.int32)}, Array((1, *shape), np.int16)
    steps = within({**held, "moved": Array(shape, np.int16)}, shift_stages(shape))
    return (
        Stage("settle", {**held, "settled": votes}),
        *(Stage("steps to settle", one.arrays, one.working) for one in steps),
    )


def guide_grid(grid: Grid, fractions: np.ndarray, index: int) -> tuple[Grid, FractionTarget]:
    """Return a grid of level `index` whose search is guided, and the target of its field; fractions
    are those of that level.
    """
    even = not sum_slabs(
        lambda a, b: np.count_nonzero(fractions[a:b] != fractions[0, 0, 0]), len(fractions)
    )
    width = window_at(_WIDE if even else _WINDOW, index)
    target = FractionTarget.of(grid.region, fractions, width)
    own, mean = phase_fraction(grid.candidates.stack), float(target.mean)
    targets = tuple(Histogram.reweight(h, mean / own, (1 - mean) / (1 - own)) for h in grid.targets)
    grid = replace(grid, candidates=add_fraction_feature(grid.candidates, width))
    return replace(grid, targets=targets, guide=target.guide(grid)), target


def lead_grid(
    grid: Grid, fractions: np.ndarray, index: int, window: int
) -> tuple[Grid, LocalOffset]:
    """Return a grid of level `index` whose search is guided, and the offset that meets the target
    of its field; fractions are those of that level, the `window` is so wide on the finest one.
    """
    width = window_at(window, index)
    local = LocalOffset.of(grid.region, fractions, width)
    own, mean = phase_fraction(grid.candidates.stack), local.mean
    targets = tuple(Histogram.reweight(h, mean / own, (1 - mean) / (1 - own)) for h in grid.targets)
    grid = replace(grid, candidates=add_fraction_feature(grid.candidates, width))
    guide = memmap.zeros((*grid.shape, 1), np.int16)
    grid = replace(grid, targets=targets, guide=guide)
    lead_guide(grid, local, first=True)
    return grid, local


def lead_guide(grid: Grid, local: LocalOffset, *, first: bool = False) -> None:
    """Move the guide of a grid by what is missing, in place: the next search is for denser
    neighbourhoods where there is too little. The `first` guide is the target.
    """
    at, guide, far = local.at(grid.middles), grid.guide, round(_FARTHEST * PULL)
    assert guide is not None
    own = fraction_feature(local.wanted, local.counted)
    more = np.rint(local.missing * np.float32(_LEAD * PULL)).astype(np.int64)

    def work(start: int, stop: int) -> None:
        mesh = (at[0][start:stop], *at[1:])
        around = own[mesh]
        asked = around if first else guide[start:stop, ..., 0] + more[mesh]
        guide[start:stop, ..., 0] = np.clip(np.clip(asked, around - far, around + far), 0, PULL)

    for_slabs(work, len(guide))


def settle_fractions(votes: np.ndarray, target: FractionTarget) -> np.ndarray:
    """Shift the last votes (1, Z, Y, X) int16 until the fractions meet the target."""
    field = memmap.empty(votes.shape[1:], np.int32)
    for_slabs(lambda start, stop: np.copyto(field[start:stop], votes[0, start:stop]), len(field))
    _settle(field, target)
    result = memmap.empty(votes.shape, np.int16)

    def end(start: int, stop: int) -> None:
        np.clip(
            field[start:stop],
            -(1 << 15) + 1,
            (1 << 15) - 1,
            out=result[0, start:stop],
            casting="unsafe",
        )

    for_slabs(end, len(field))
    return result


def _settle(field: np.ndarray, target: FractionTarget) -> None:
    """Take steps on a field (Z, Y, X) int32 of 256 parts to a unit, in place."""
    moved = memmap.zeros(field.shape, np.int16)

    def round_planes(start: int, stop: int) -> np.ndarray:
        return np.clip((field[start:stop] + 128) >> 8, -127, 127)

    def move(z: int, shift: np.ndarray) -> None:
        moved[z] >>= 1  # half of the last step again: what varies within a window is slow to come
        # 16 bits hold it: a step is at most 40, so that all of them are at most 80
        moved[z] += shift * np.int16(256)
        field[z] += moved[z]

    for _ in range(_LAST):
        target.step(round_planes, move)


@kernel
def _miss(wanted, counted, have, start, stop):
    """Replace the sums by the fraction that is missing around every voxel, in `PARTS`."""
    for z in range(start, stop):
        for y in range(have.shape[1]):
            for x in range(have.shape[2]):
                missing = wanted[z, y, x] - np.int64(have[z, y, x]) * PARTS
                have[z, y, x] = missing // max(counted[z, y, x], 1)


@kernel
def _shift(missing, near, counted, shift):
    """Divide the fraction missing in a plane, averaged over a window, by the gain of a
    shift by 1.
    """
    for y in range(shift.shape[0]):
        for x in range(shift.shape[1]):
            # Where no interface is near there is nothing to shift: 1 in 50 voxels at least, so that
            # some can come.
            slope = max(near[y, x], counted[y, x] / 50.0) / (2 * _NEAR + 1)
            step = _HASTE * (missing[y, x] / PARTS) / slope if slope > 0.0 else 0.0
            shift[y, x] = np.int16(np.rint(min(max(step, -_MOST), _MOST)))
