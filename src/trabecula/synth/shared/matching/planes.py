"""Several views of one volume at one resolution: the planes across an axis, matched with the picture seen there.

Neighbourhoods are squares in these planes. Every view searches for itself, in the volume turned so that its axis comes first;
the votes of all of them are added up, turned back, and make one field.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.engine.tiles import for_slabs
from trabecula.synth.shared.fields import FULL
from trabecula.synth.shared.histogram import Histogram
from trabecula.synth.shared.matching.grid import Grid, targets_of
from trabecula.synth.shared.matching.kernels import choose
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import add_sums, mean_of, trims_of
from trabecula.synth.shared.matching.sources import Candidates

_MOST_WEIGHT = 1023  # of a neighbourhood
_MOST_FACTOR = 256  # times an int8 is an int16


@dataclass(frozen=True)
class Plane:
    """One view: the axis it is seen across, and the neighbourhoods of the volume with that axis first."""

    axis: int
    grid: Grid

    def turned(self, field: np.ndarray) -> np.ndarray:
        """A field (C, Z, Y, X) with the view's axis first of the three."""
        return np.ascontiguousarray(np.moveaxis(field, 1 + self.axis, 1))

    def back(self, field: np.ndarray) -> np.ndarray:
        """`turned` backwards, not copied."""
        return np.moveaxis(field, 1, 1 + self.axis)


@dataclass(frozen=True)
class Frame:
    """All views of a region at one resolution."""

    region: Region  # covered in every view
    planes: tuple[Plane, ...]
    targets: tuple[Histogram, ...]  # that the free voxels are to have, one a channel

    @property
    def full(self) -> int:
        """The integer factor of a voxel of an exemplar that counts fully: as fine as sums of all votes in int32 allow."""
        candidates = self.planes[0].grid.candidates
        overlaps = len(self.planes) * (-(-candidates.basis.width // candidates.step)) ** 2
        room = (2**31 - 1) // (_MOST_WEIGHT * FULL * overlaps)
        return min(_MOST_FACTOR, 1 << (room.bit_length() - 1))

    @classmethod
    def over(cls, region: Region, views: Sequence[tuple[int, Candidates]], histograms: tuple[Histogram, ...]) -> Frame:
        """The views (axis, neighbourhoods) of a region; `histograms` are those of the pictures together."""
        widths = {candidates.basis.width for _, candidates in views}
        steps = {candidates.step for _, candidates in views}
        (width,), (step,) = widths, steps  # one for all views: a voxel of the cover belongs to all of them
        covered = region.covered(box=(width,) * 3, steps=(step,) * 3)
        targets = targets_of(covered, histograms, width=width)
        planes = tuple(Plane(axis, Grid.over(covered.seen(axis), candidates, targets)) for axis, candidates in views)
        return cls(covered, planes, targets)


def voted_planes(
    frame: Frame,
    matches: Sequence[np.ndarray],
    weights: Sequence[np.ndarray],
    *,
    factors: Sequence[np.ndarray] | None = None,
    trim: int = 0,
) -> np.ndarray:
    """The weighted mean (C, Z, Y, X) int16 of all matched neighbourhoods of all views, times 256; 0 where none reaches.

    Parameters
    ----------
    matches, weights : sequences of (sz, sy, sx) int32
        One a view, on its grid.
    factors : sequence of (z, y, x) int, optional
        How much every voxel of a view's exemplar counts, 1 .. `frame.full`. Default: all alike.
    trim : int
        Voxels at the rim of a neighbourhood that do not vote.
    """
    channels = len(frame.planes[0].grid.candidates.stack.field)
    total = np.zeros((channels + 1, *frame.region.shape), np.int32)
    for place, (plane, match, weight) in enumerate(zip(frame.planes, matches, weights, strict=True)):
        field = plane.grid.candidates.stack.field
        factor = np.int16(1) if factors is None else factors[place].astype(np.int16)
        values = np.concatenate([field * factor, np.broadcast_to(factor, (1, *field.shape[1:]))])
        part = np.zeros((channels + 1, *plane.grid.region.shape), np.int32)
        add_sums(part, values, plane.grid, match, weight, trim=trim)
        np.moveaxis(total, 1 + plane.axis, 1)[:] += part
    return mean_of(total)


def chosen_planes(
    frame: Frame,
    matches: Sequence[np.ndarray],
    weights: Sequence[np.ndarray],
    mean: np.ndarray,
    *,
    dear: Sequence[np.ndarray],
    trim: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Of all pixels that the matched neighbourhoods of all views lay on a voxel, the one nearest to the mean.

    Parameters
    ----------
    matches, weights, trim
        As in `voted_planes`.
    mean : (C, Z, Y, X) int16
        256 times the field to come near to.
    dear : sequence of (z, y, x) int32
        What the squared distance of every voxel of a view's exemplar is multiplied by, 1 or more.

    Returns
    -------
    field : (C, Z, Y, X) int8
        The pixels' values; the mean where no neighbourhood reaches.
    sources : (Z, Y, X) int32
        Their numbers: view after view, in the order of each view's stack; -1 where there is none.
    """
    field = np.clip((mean.astype(np.int32) + 128) >> 8, -FULL, FULL).astype(np.int8)
    sources = np.full(mean.shape[1:], -1, np.int32)
    cost = np.full(mean.shape[1:], 2**62, np.int64)
    first = 0
    for plane, match, weight, factor in zip(frame.planes, matches, weights, dear, strict=True):
        grid = plane.grid
        exemplar = grid.candidates.stack.field
        seen = plane.turned(mean)
        least, found = (np.ascontiguousarray(np.moveaxis(part, plane.axis, 0)) for part in (cost, sources))
        _choose(grid, exemplar, factor, match, weight, trim, first, seen, least, found)
        cost, sources = (np.moveaxis(part, 0, plane.axis) for part in (least, found))
        here = (sources >= first) & (sources < first + exemplar[0].size)
        taken = sources[here] - first
        for channel, values in enumerate(exemplar):
            field[channel][here] = values.ravel()[taken]
        first += exemplar[0].size
    return field, np.ascontiguousarray(sources)


def _choose(
    grid: Grid,
    exemplar: np.ndarray,
    factor: np.ndarray,
    match: np.ndarray,
    weight: np.ndarray,
    trim: int,
    first: int,
    mean: np.ndarray,
    least: np.ndarray,
    found: np.ndarray,
) -> None:
    candidates = grid.candidates

    def work(start: int, stop: int) -> None:
        choose(
            exemplar,
            factor,
            match,
            weight,
            candidates.shape,
            candidates.strides,
            candidates.steps,
            candidates.basis.box,
            trims_of(grid, trim),
            grid.region.wraps,
            first,
            mean,
            least,
            found,
            start,
            stop,
        )

    for_slabs(work, len(least))
