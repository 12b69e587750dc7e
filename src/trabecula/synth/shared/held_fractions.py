"""Volume fractions that vary from place to place, in new material: the request on every
level, what the search and the two-point function make of it, and how the field is held to it.

Interfaces that are moved in the end alone thin the struts of dense places and thicken those of
sparse ones: bone became a third as stiff as it was before. So on coarse levels the field is held to
the fractions after every vote and every step on the two-point function, and the search finds
bodies that have them. The exemplar's two-point function holds that its own windows are uneven, and
steps would bring that back. So they aim at what is left of it about the means of such windows, and
at the two-point function of the fractions themselves beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs
from trabecula.synth.shared.box_sums import window_sums
from trabecula.synth.shared.content.fields import UNIT
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.local_offset import HALF_A_VOXEL, PARTS, LocalOffset
from trabecula.synth.shared.matching.grid import Grid, append_guide
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Candidates, Stack
from trabecula.synth.shared.pyramid import halve
from trabecula.synth.shared.statistics.density_slopes import density_weights
from trabecula.synth.shared.statistics.pairs import Pairs
from trabecula.synth.shared.statistics.torus_steps import TorusPairs
from trabecula.synth.shared.statistics.two_point import (
    Correlations,
    Soft,
    soft_means,
    whole_blocks,
)

LEAST = 6
"""Voxels a side of a window at least, on any level."""

PULL = 16_000
"""Features between a fraction of 0 and one of 1."""

_STEPS = 8  # towards the fractions, each time that a field is held
_FARTHEST = 45.0 * UNIT  # votes by which it is shifted at most: one and a half voxels


def window_at(width: int, level: int) -> int:
    """Return the width on a level of windows that are so wide on the finest one."""
    return max(LEAST, round(width / 2**level))


def fractions_by_level(fractions: np.ndarray, stacks: Sequence[Stack]) -> list[np.ndarray]:
    """Return fractions (Z, Y, X) float32 at every voxel at the resolution of each stack, finest
    first.
    """
    own = phase_fraction(stacks[0])
    found: list[np.ndarray] = []
    for stack in stacks:
        fractions = halve(fractions[None])[0] if found else fractions
        found.append(carry_over(fractions, own, phase_fraction(stack)))
    return found


def carry_over(fractions: np.ndarray, own: float, there: float) -> np.ndarray:
    """Convert fractions to a level where the exemplar's own fraction is `there`."""
    carried = memmap.empty(fractions.shape, np.float32)

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            carried[z] = np.interp(fractions[z], (0.0, own, 1.0), (0.0, there, 1.0))

    for_slabs(work, len(fractions))
    return carried


def phase_fraction(stack: Stack) -> float:
    """Return the fraction of the phase in the exemplars' volumes."""
    inside = sum(
        np.count_nonzero(stack.field[0, start : start + z, :y, :x] > 0)
        for start, (z, y, x) in zip(stack.starts, stack.sides, strict=True)
    )
    return float(inside / np.prod(stack.sides.astype(np.int64), axis=1).sum())


def add_fraction_feature(candidates: Candidates, width: int) -> Candidates:
    """Return candidates with one more feature: the fraction of the phase in the window
    around them.
    """
    stack = candidates.stack
    inside = np.zeros(stack.field.shape[1:], np.int32)
    counts = np.zeros_like(inside)
    for start, (z, y, x) in zip(stack.starts, stack.sides, strict=True):
        at = (slice(start, start + z), slice(0, y), slice(0, x))
        inside[at] = window_sums(stack.field[0][at] > 0, width, (False,) * 3)
        counts[at] = window_sums(np.ones((z, y, x), bool), width, (False,) * 3)
    middle = [
        np.arange(count) * stride + w // 2
        for count, stride, w in zip(
            candidates.shape, candidates.strides, candidates.basis.box, strict=True
        )
    ]
    mesh = np.ix_(*middle)
    fraction = fraction_feature(inside[mesh].astype(np.int64) * PARTS, counts[mesh])
    return replace(
        candidates, features=append_guide(candidates.features >> 1, fraction.reshape(-1, 1))
    )


def fraction_feature(sums: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Convert sums of fractions, in `PARTS`, over windows of some voxels to a feature, int16."""
    return np.asarray(
        sums.astype(np.int64) * PULL // (np.maximum(counts, 1).astype(np.int64) * PARTS), np.int16
    )


@dataclass(frozen=True)
class HeldFractions:
    """The fractions that one level of a torus is to have.

    Attributes
    ----------
    fractions : (Z, Y, X) float32
        Of the phase where the field is positive, of the torus' beginning; beyond it the last ones
        count.
    width : int
        Voxels a side of the windows that have them.
    uneven : (C, bins) float64
        The part of the exemplars' two-point functions that is that of such windows
        (`uneven_part`).
    mean : float
        The exemplars' own mean of the soft indicator.
    periodic : three bools
        Axes along which windows wrap.
    mask : (Z, Y, X) bool, optional
        The voxels that count. Default: all.
    """

    fractions: np.ndarray
    width: int
    uneven: np.ndarray
    mean: float
    periodic: tuple[bool, ...]
    mask: np.ndarray | None = None

    def offset(self, region: Region, shares: np.ndarray | None = None) -> LocalOffset:
        """Return the offset that meets the fractions on a torus, by whose `shares` it shifts less
        beside known voxels (`shares_beside`).
        """
        shape, counted = region.shape, region.free
        if self.mask is not None:
            inside = np.zeros(shape, bool)
            inside[tuple(map(slice, self.mask.shape))] = self.mask[tuple(map(slice, shape))]
            counted = inside if counted is None else inside & counted
        counting = Region(shape, self.periodic, counted)
        return LocalOffset.of(counting, self.fractions, self.width, shares, HALF_A_VOXEL)

    def guide(self, grid: Grid, offset: LocalOffset) -> Grid:
        """Return a grid whose search prefers places as dense as the request has it."""
        at, guide = offset.at(grid.middles), memmap.empty((*grid.shape, 1), np.int16)
        own = fraction_feature(offset.wanted, offset.counted)
        own[offset.counted == 0] = round(offset.mean * PULL)

        def work(start: int, stop: int) -> None:
            guide[start:stop, ..., 0] = own[(at[0][start:stop], *at[1:])]

        for_slabs(work, len(guide))
        candidates = add_fraction_feature(grid.candidates, self.width)
        return replace(grid, candidates=candidates, guide=guide)

    def aim(
        self,
        target: Correlations,
        histograms: Sequence[Histogram],
        means: np.ndarray,
        shape: tuple[int, ...],
    ) -> Correlations:
        """Return the two-point functions of a torus of a shape whose material has the `target` but
        for its evenness, and the `means` of its soft indicators, one a channel; those of the target
        are of histograms.
        """
        pairs = TorusPairs.of(shape, target)
        where = True if self.mask is None else self.mask
        mean = self.fractions.mean(dtype=np.float64, where=where)
        about = partial(self._about, np.float32(mean), shape)
        spectrum = pairs.forward(target.on_grid(about, shape))
        asked = pairs.curve(spectrum, spectrum)
        theirs = soft_means(histograms, target.softness)
        variance, theirs_had = means - means**2, (theirs - theirs**2).clip(1e-30)
        own = max(self.mean - self.mean**2, 1e-30)
        material = (variance / theirs_had)[:, None] * (target.curves - theirs[:, None] ** 2)
        even = material - (variance / own)[:, None] * self.uneven
        return replace(target, curves=even + asked + means[:, None] ** 2)

    def _about(self, mean: np.float32, shape: tuple[int, ...], start: int, stop: int) -> np.ndarray:
        """Return planes of the fractions less their mean; 0 where none counts."""
        places = [
            np.arange(side).clip(max=have - 1)
            for side, have in zip(shape, self.fractions.shape, strict=True)
        ]
        mesh = np.ix_(places[0][start:stop], *places[1:])
        found = self.fractions[mesh] - mean
        return found if self.mask is None else np.where(self.mask[mesh], found, np.float32(0))


def hold_field(field: np.ndarray, offset: LocalOffset) -> None:
    """Shift a field (1, Z, Y, X) int8 in place until windows have their fractions, nearly."""
    offset.shift(field[0], steps=_STEPS, most=_FARTHEST)


def uneven_part(fields: Sequence[np.ndarray], target: Correlations, width: int) -> np.ndarray:
    """Return what exemplars (C, Z, Y, X) int8 lose of their two-point functions, (C, bins), where
    the mean over the window around every voxel is that of all of them.

    Parameters
    ----------
    fields : sequence of arrays
    target : Correlations
        Of these fields.
    width : int
        Voxels a side of a window.
    """
    lost, fits = np.zeros_like(target.curves), np.zeros(target.curves.shape[1])
    for field, local in zip(fields, density_weights(fields, width), strict=True):
        shape = tuple(side // target.blocks for side in local.shape)
        pairs = Pairs(shape, target.r_max, edges=target.edges, directions=target.directions)
        fits += pairs.fits
        for c, channel in enumerate(field):
            soft = Soft.of(channel, target.softness)
            mean = soft.mean_and_moving()[0]  # without it g of places at the faces would count
            for sign, weight in ((1, 0), (-1, 1)):
                planes = partial(_less, soft, mean, local, np.float32(weight))
                spectrum = pairs.forward(whole_blocks(planes, shape, target.blocks))
                lost[c] += sign * pairs.curve(spectrum, spectrum) * pairs.fits
    return lost / np.maximum(fits, 1)


def _less(
    soft: Soft, mean: np.float32, local: np.ndarray, weight: np.float32, start: int, stop: int
) -> np.ndarray:
    return np.asarray(soft.planes(start, stop) - mean - weight * local[start:stop])
