"""The last votes made a result whose volume fractions follow a target, in one component.

New material has been held to its fractions on coarse levels (`held_fractions`): its field is joined
and shifted by little (`settle_field`). Where that is a voxel or more, as beyond what the exemplar
holds, the votes are smoothed first: shifted as they are they end in grain (Berea from .09 to .29 of
pores had 2.4 times its loops). Not where bodies are hardly wider than a voxel.

From patches more is left to do (`settle_shape`): votes blur where neighbourhoods do not agree, and
a shift of such a field brings up grain and combs. So the interface that was voted for is kept, and
moved along its own distance:

1. Join the components of the solid (`joined`), at a strut's thickness.
2. Replace the field by the signed distance to the interface, smoothed by a voxel: distances to
   voxels have steps. Not where bodies are hardly wider than that: a coarse scan of a cathode lost a
   fifth of its interface.
3. Shift it smoothly until the fraction around every voxel is that of the target (`local_offset`),
   by three voxels at most: where struts get thinner some break. Beside known voxels it shifts the
   less the nearer they are, or interfaces would end in the joint. A few steps leave what single
   windows miss by chance. Sixty of them halve it (.006 of a bone's fraction for .009), and make
   struts so uneven that the bone is two to four times softer.
4. The same again, of what came out, without smoothing: a second time that rounds thin struts away
   (of a bone of 13 % they grew from 1.06 to 1.19 of the scan's thickness), and without a second
   pass the fraction is off by half as much again. Then split at the target's mean fraction, to the
   voxel, and join what the last shift has broken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import inline, kernel
from trabecula.engine.memory import Array, Stage, within
from trabecula.engine.parallel import for_slabs
from trabecula.measure.distance import distance_transform
from trabecula.synth.shared.content.fields import FULL, UNIT, votes_of
from trabecula.synth.shared.content.phase_fractions import brightest_voxels
from trabecula.synth.shared.known_part import share_stages, shares_beside
from trabecula.synth.shared.local_offset import HALF_A_VOXEL, NARROWEST, LocalOffset
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.texture.joined import StrutField, join_components, join_stages

_STEPS = 12  # of the shift in every pass: more meet single windows, by struts that vary
_TRIED = 6  # that find how far interfaces will move
_SOFT = 1.25  # voxels of a shift from which on it is that of softened votes
_MOST = 3.0  # voxels by which an interface moves in one pass
_THIN = 0.9  # voxels, radius of the last joins


def shape_stages(shape: Sequence[int], *, known: bool, masked: bool) -> tuple[Stage, ...]:
    """Declare the arrays of `settle_shape`."""
    volume = (1, *shape)
    given = {
        "final free": Array(shape, bool) if known or masked else None,
        "final low": Array(volume, np.int8) if known else None,
        "final high": Array(volume, np.int8) if known else None,
        "final fractions": Array(shape, np.float32),
        "shares": Array(shape, np.uint8) if known else None,
        "votes": Array(volume, np.int16),
        "last votes": Array(volume, np.int16),  # of the rounds: the caller has them
    }
    distance = {
        "final field": Array(volume, np.int8),
        "distance": Array(shape, np.float32),
        "outside": Array(shape, bool),
    }
    which = {"which are known": Array(shape, bool)}
    return (
        *(within({**given, **which}, share_stages(shape)) if known else ()),
        Stage("distance", {**given, **distance}),
        *within({**given, "final field": Array(volume, np.int8)}, join_stages(shape)),
    )


def settle_shape(
    votes: np.ndarray,
    region: Region,
    fractions: np.ndarray,
    struts: StrutField | None,
    *,
    unit: float,
    window: int = NARROWEST,
    smooth: bool = True,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Return the voxels of the upper phase, (Z, Y, X) bool, and a report.

    Parameters
    ----------
    votes : (1, Z, Y, X) int16
        The last ones, of the result's shape; they are overwritten.
    region : Region
        The result.
    fractions : (Z, Y, X) float32
        Of the upper phase, at every voxel.
    struts : StrutField or None
        How to join the solid; None where it need not be one component.
    unit : float
        Steps of the field in a voxel.
    window : int
        Voxels a side of the windows in which the fraction is to be that of the target.
    smooth : bool
        Smooth the distance first.
    """
    most, joins, shares = _MOST * unit * UNIT, 0, shares_beside(region)
    for number in range(2):
        field = _rounded(votes)
        if struts is not None:
            joins += join_components(field, region, struts)
        votes = _distances(field, region, unit)
        if number == 0 and smooth:
            soften(votes[0], region.wraps)
        del field
        local = LocalOffset.of(region, fractions, window, shares)
        local.shift(votes[0], steps=_STEPS, most=most)
    upper = brightest_voxels(votes[0], _count_of(fractions, region), region.free)
    return upper, {"joins": joins + _join(upper, votes, region, struts)}


def settle_field(
    votes: np.ndarray,
    region: Region,
    fractions: np.ndarray,
    struts: StrutField | None,
    *,
    unit: float,
    window: int,
    smooth: bool = True,
    place: Callable[[np.ndarray], dict[str, Any]] | None = None,
    match: Callable[..., tuple[np.ndarray, dict[str, Any]]] | None = None,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Do `settle_shape` on the field itself, where it has been held to its fractions: without
    distances, in one pass. The free voxels have the fractions' mean, from which `match` strays
    a little: in a block of which no cell has an interface nothing is gained that others lose.

    `place` brings small bodies into the votes, and returns what it did; so does `match`, which
    changes single voxels of the upper phase.
    """
    joins, report = 0, {}
    if struts is not None:
        field = _rounded(votes)
        joins = join_components(field, region, struts)
        votes = votes_of(field)
        del field
    local = LocalOffset.of(region, fractions, window, shares_beside(region), HALF_A_VOXEL)
    most = _MOST * unit * UNIT
    if smooth:
        local.find(votes[0], steps=_TRIED, most=most)
        local.blend(votes[0], _softened(votes[0], region), whole=_SOFT * unit * UNIT)
    local.shift(votes[0], steps=_STEPS, most=most)
    if place is not None:
        report["small_bodies"] = place(votes)
    upper = brightest_voxels(votes[0], _count_of(fractions, region, alone=True), region.free)
    if match is not None:
        upper, report["patterns"] = match(upper, votes)
    last = _join(upper, votes, region, struts)
    return upper, {"joins": joins + last, **report}


def _softened(votes: np.ndarray, region: Region) -> np.ndarray:
    """Return smoothed votes (Z, Y, X) int16."""
    found = memmap.empty(votes.shape, np.int16)
    for_slabs(lambda a, b: np.copyto(found[a:b], votes[a:b]), len(found))
    soften(found, region.wraps)
    return found


def _join(upper: np.ndarray, votes: np.ndarray, region: Region, struts: StrutField | None) -> int:
    """Join the solid in place, where it is to be one component; return the number of joins. `upper`
    is the second phase, made of votes.
    """
    if struts is None:
        return 0
    field = _signed(upper, votes)
    joins = join_components(field, region, replace(struts, radius=_THIN))
    for_slabs(lambda a, b: np.greater(field[0, a:b], 0, out=upper[a:b]), len(upper))
    return joins


def _rounded(votes: np.ndarray) -> np.ndarray:
    """Round votes (1, Z, Y, X) int16 to a field in int8."""
    field = memmap.empty(votes.shape, np.int8)

    def work(start: int, stop: int) -> None:
        part = (votes[:, start:stop].astype(np.int32) + UNIT // 2) >> 8
        field[:, start:stop] = np.clip(part, -FULL, FULL)

    for_slabs(work, votes.shape[1])
    return field


def _distances(field: np.ndarray, region: Region, unit: float) -> np.ndarray:
    """Return the signed distance to where a field (1, Z, Y, X) changes its sign, as votes int16."""
    votes, scale = memmap.empty(field.shape, np.int16), np.float32(unit * UNIT)
    for sign in (1, -1):
        side = memmap.empty(field.shape[1:], bool)

        def mark(start: int, stop: int, side: np.ndarray = side, upper: bool = sign > 0) -> None:
            np.equal(field[0, start:stop] > 0, upper, out=side[start:stop])

        for_slabs(mark, len(side))
        distance = distance_transform(side, periodic=region.wraps)

        def write(start: int, stop: int, distance: np.ndarray = distance, sign: int = sign) -> None:
            part = distance[start:stop]
            far = np.clip((part - np.float32(0.5)) * scale, 0, FULL * UNIT).astype(np.int16)
            np.copyto(votes[0, start:stop], sign * far, where=part > 0)

        for_slabs(write, len(side))
        del distance, side, mark, write  # whose defaults hold the arrays
    return votes


def _count_of(fractions: np.ndarray, region: Region, *, alone: bool = False) -> int:
    """Return how many free voxels are to be of the upper phase, so that they `alone`, or free and
    known ones together, have the mean of fractions (Z, Y, X).
    """
    sums = np.zeros(len(fractions))
    free, low, high = region.free, region.low, region.high

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            made = None if free is None else free[z]
            sums[z] = fractions[z].sum(dtype=np.float64, where=True if made is None else made)
            if not alone and low is not None and high is not None:
                known = (low[0, z] > 0) | (high[0, z] <= 0)  # others are outside of a form
                known &= True if made is None else ~made
                sums[z] += fractions[z].sum(dtype=np.float64, where=known)
                sums[z] -= np.count_nonzero(known & (low[0, z] > 0))

    for_slabs(work, len(sums))
    return max(0, round(float(sums.sum())))


def _signed(upper: np.ndarray, votes: np.ndarray) -> np.ndarray:
    """Return a field (1, Z, Y, X) int8 that is positive in the upper phase alone."""
    field = _rounded(votes)

    def work(start: int, stop: int) -> None:
        part = field[0, start:stop]
        inside = upper[start:stop]
        part[...] = np.where(inside, np.maximum(part, 1), np.minimum(part, 0))

    for_slabs(work, len(upper))
    return field


def soften(votes: np.ndarray, wraps: Sequence[bool] = (False, False, False)) -> None:
    """Smooth votes (Z, Y, X) int16 in place by 1, 2, 1 along every axis; beyond an open face the
    last voxel is repeated.
    """
    around = np.array(wraps)
    for_slabs(lambda a, b: _soften(votes, around, a, b), len(votes))
    for_slabs(lambda a, b: _soften_lines(votes, around[0], a, b), votes.shape[1])


@kernel
def _soften(votes, wraps, start, stop):
    """Smooth some planes along x and y."""
    height, width = votes.shape[1:]
    for z in range(start, stop):
        for y in range(height):
            row = votes[z, y]
            first = np.int32(row[0])
            before = np.int32(row[width - 1]) if wraps[2] else first
            for x in range(width):
                here = np.int32(row[x])
                behind = np.int32(row[x + 1]) if x + 1 < width else first if wraps[2] else here
                row[x] = (before + 2 * here + behind + 2) >> 2
                before = here
        _soften_rows(votes[z], wraps[1])


@kernel
def _soften_lines(votes, wraps, start, stop):
    """Smooth some rows of columns along z."""
    for y in range(start, stop):
        _soften_rows(votes[:, y], wraps)


@inline
def _soften_rows(plane, wraps):
    """Smooth a plane (N, X) along its first axis, in place."""
    side, width = plane.shape
    first = plane[0].astype(np.int32)
    before = plane[side - 1].astype(np.int32) if wraps else first.copy()
    for n in range(side):
        for x in range(width):
            here = np.int32(plane[n, x])
            behind = np.int32(plane[n + 1, x]) if n + 1 < side else first[x] if wraps else here
            plane[n, x] = (before[x] + 2 * here + behind + 2) >> 2
            before[x] = here
