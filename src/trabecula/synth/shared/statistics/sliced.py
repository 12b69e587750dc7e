"""Sliced rounds: neighbourhoods of the output take on the distribution of the exemplar's, without
copying any of them.

Pitie, Kokaram, Dahyot 2007, "Automated colour grading using colour distribution transfer",
doi:10.1016/j.cviu.2006.11.011, section 3, on the principal components of neighbourhoods: turn the
axes at random, move the values along every axis monotonically so that their histogram is the
exemplar's, turn back; a voxel becomes the mean of the neighbourhoods that hold it. Nothing is
looked up in the exemplar, so nothing is copied.

Only the part on the components is put back: the rest of the output (its noise, at first) has to
go, or it stays for ever. Along periodic axes every voxel is in equally many neighbourhoods; along
open ones those near a face are in fewer, their mean is noisier, and the rarer
phase gathers there.

Everything is a whole number within the range in which products of matrices are exact, so the bits
do not depend on the BLAS, on threads or on the machine.

From pictures the neighbourhoods are squares in the planes of a view; where a material is seen in
several views, a voxel becomes the mean over all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import kernel
from trabecula.engine.memory import Array, Stage, Workspace
from trabecula.engine.parallel import for_slabs, one_blas_thread, thread_count
from trabecula.engine.random import philox
from trabecula.synth.shared.content.fields import FULL, UNIT
from trabecula.synth.shared.matching.neighbourhoods import SCALE, project, steps_of
from trabecula.synth.shared.slabs import (
    axis_order,
    put_axis_first,
    restore_axis_order,
    shape_with_axis_first,
)
from trabecula.synth.shared.statistics.sites import BATCH, Sites
from trabecula.synth.shared.statistics.slices import AT_ONCE, BINS, FINE, SliceTarget, Transport


def transport_neighbourhoods(
    field: np.ndarray,
    views: Sequence[tuple[int, SliceTarget]],
    *,
    key: np.uint64,
    number: int,
    step: int = 2,
    strength: float = 1.5,
    periodic: Sequence[bool] = (True, True, True),
    free: np.ndarray | None = None,
    counted: np.ndarray | None = None,
) -> np.ndarray:
    """Move every neighbourhood of a grid towards the distribution of its view, and average all
    overlaps: one round.

    Parameters
    ----------
    field : (C, Z, Y, X) int16
        1 / UNIT of an int8 step; no side below the width of the neighbourhoods.
    views : sequence of (axis, SliceTarget)
        What neighbourhoods aim at: cubes of a volume, with axis 0; or flat ones of a picture, whose
        rows lie along the slower of the two other axes, and the axis across which it is seen (0 z,
        1 y, 2 x).
    key : uint64
        Of the random axes and of where the grid begins.
    number : int
        Of the round: each has its own random numbers.
    step : int
        Voxels between neighbourhoods; the grid begins elsewhere in every round, so all voxels get
        their turn.
    strength : float
        How far they move: 1 is to the exemplar's distribution. More makes up for what averaging
        takes away.
    periodic : three bools
        Axes that wrap around.
    free : (Z, Y, X) bool, optional
        Only neighbourhoods that hold such a voxel take part, and only such voxels change. Default:
        all.
    counted : (Z, Y, X) bool, optional
        Only neighbourhoods around such a voxel are to have the distribution: others move as they
        do. Default: all that take part.

    Returns
    -------
    (C, Z, Y, X) int16
    """
    work = Workspace(transport_stages(field.shape, views, step=step, known=free is not None))
    work.enter("mean")
    total, votes = work.zeros("sums"), work.zeros("counts")
    for place, (axis, slices) in enumerate(views):
        work.enter("mean")
        work.enter(f"view {place}")
        round_ = SlicedRound(key, number * len(views) + place, step, strength)
        around = [periodic[a] for a in axis_order(axis)]
        if axis == 0:
            add_transported(field, slices, round_, around, free, total, votes, counted)
            continue
        work.adopt("seen", put_axis_first(field, axis))
        if free is not None:
            work.adopt("free seen", put_axis_first(free, axis))
        seen_free = None if free is None else work["free seen"]
        sums, counts = work.zeros("seen sums"), work.zeros("seen counts")
        add_transported(work["seen"], slices, round_, around, seen_free, sums, counts)
        restore_axis_order(sums, axis, total, add=True)
        restore_axis_order(counts, axis, votes, add=True)
        del sums, counts, seen_free
    work.enter("mean")
    return _write_means(field, total, votes, free)


def transport_stages(
    shape: Sequence[int],
    views: Sequence[tuple[int, SliceTarget]],
    *,
    step: int,
    known: bool = False,
) -> tuple[Stage, ...]:
    """Declare the arrays of a round on a field (C, Z, Y, X) beside it and its result; `known` says
    whether not all voxels are free.
    """
    channels, *volume = shape
    held = {"sums": Array(shape, np.int32), "counts": Array(volume, np.int32)}
    stages = [Stage("mean", {**held, "replaced": Array(shape, np.int16)})]
    for place, (axis, slices) in enumerate(views):
        turned = shape_with_axis_first(volume, axis)
        steps = steps_of(step, flat=slices.basis.flat)
        sites = [-(-side // apart) for side, apart in zip(turned, steps, strict=True)]
        arrays = {
            "levels": Array((channels, *turned), np.int8),
            "features": Array((*sites, slices.basis.vectors.shape[1]), np.int16, axis=-4),
            "active": Array(sites, bool) if known else None,
        }
        if axis:
            arrays |= {
                "seen": Array((channels, *turned), np.int16),
                "free seen": Array(turned, bool) if known else None,
                "seen sums": Array((channels, *turned), np.int32),
                "seen counts": Array(turned, np.int32),
            }
        stages.append(Stage(f"view {place}", {**held, **arrays}, _round_bytes(slices)))
    return tuple(stages)


def _write_means(
    field: np.ndarray, total: np.ndarray, votes: np.ndarray, free: np.ndarray | None
) -> np.ndarray:
    """Replace free voxels by the mean of the neighbourhoods that were put back there."""
    replaced = memmap.empty(field.shape, np.int16, least=0)
    where = np.empty((0, 0, 0), bool) if free is None else free
    work = partial(_write_mean, field, total, votes, where, replaced)
    for_slabs(work, len(votes), anywhere=True)
    return replaced


@kernel
def _write_mean(field, total, votes, free, replaced, start, stop):
    """Write planes start..stop; an empty `free` means everywhere."""
    for c in range(len(field)):
        for z in range(start, stop):
            for y in range(votes.shape[1]):
                for x in range(votes.shape[2]):
                    count = votes[z, y, x]
                    if count > 0 and (free.size == 0 or free[z, y, x]):
                        mean = total[c, z, y, x] // count
                        replaced[c, z, y, x] = min(max(mean, -FULL * UNIT), FULL * UNIT)
                    else:
                        replaced[c, z, y, x] = field[c, z, y, x]


@dataclass(frozen=True)
class SlicedRound:
    """The random key and number of one round, the distance between its neighbourhoods, and the
    length of their moves.
    """

    key: np.uint64
    number: int
    step: int
    strength: float


def add_transported(
    field: np.ndarray,
    slices: SliceTarget,
    round_: SlicedRound,
    periodic: Sequence[bool],
    free: np.ndarray | None,
    total: np.ndarray,
    votes: np.ndarray,
    counted: np.ndarray | None = None,
) -> None:
    """Add the moved neighbourhoods that hold a voxel to total (C, Z, Y, X) int32, and their number
    to votes (Z, Y, X) int32.
    """
    basis, size = slices.basis, slices.features.shape[1]
    steps = steps_of(round_.step, flat=basis.flat)
    sites = Sites.draw(
        field.shape[1:],
        box=basis.box,
        steps=steps,
        periodic=periodic,
        free=free,
        key=round_.key,
        number=round_.number,
    )
    if not sites.holds_any():
        return
    features = project(sites.levels(field), basis, step=round_.step, active=sites.active)
    count = features.shape[-1]
    turn = rotation(round_.key, round_.number, size).astype(np.float32)
    back = turn.T.astype(np.float64)

    def along(sites: Sites, start: int, stop: int) -> Iterator[np.ndarray]:
        for rows in sites.rows(features, start, stop, few=AT_ONCE):
            yield rows.astype(np.float32) @ turn[:count]

    with one_blas_thread():
        transport = Transport.between(
            partial(along, sites),
            len(features),
            slices.features @ turn,
            None if counted is None else partial(along, sites.around(counted)),
        )

    def rebuilt(rows: np.ndarray) -> np.ndarray:
        # Turned back it is size**2 too large.
        moved = transport.moves(rows.astype(np.float32) @ turn[:count]) @ back
        moved *= round_.strength / size**2
        np.rint(moved, out=moved)
        moved[:, :count] += rows
        blocks = moved @ slices.back
        blocks *= UNIT / (SCALE * FINE)
        return np.rint(blocks, out=blocks)

    sites.put_back(features, rebuilt, slices.rest.astype(np.int32), total, votes)


def rotation(key: np.uint64, number: int, size: int) -> np.ndarray:
    """Draw a random rotation of `size` axes (a power of two) times `size`, in whole numbers:
    Hadamard's matrix twice, with random signs before, between and behind.
    """
    matrix: np.ndarray = np.ones((1, 1))
    while len(matrix) < size:
        matrix = np.block([[matrix, matrix], [matrix, -matrix]])
    signs = np.empty(3 * size)
    draw_signs(key, number, signs)
    first, second, third = signs.reshape(3, size)
    with one_blas_thread():
        return np.asarray((first[:, None] * matrix * second) @ matrix * third)


def _round_bytes(slices: SliceTarget) -> int:
    """Forecast the memory of a round whatever the volume: features of the exemplars, and
    neighbourhoods that are put back.
    """
    size, (components, length) = slices.features.shape[1], slices.back.shape
    threads = thread_count()
    batch = 4 * BATCH + BATCH // length * (2 * components + 40)
    of_a_thread = AT_ONCE * (20 * size + 8 * length) + 24 * size * BINS
    return slices.features.nbytes + batch + 40 * size * BINS + threads * of_a_thread


@kernel
def draw_signs(key, number, signs):
    for i in range(len(signs)):
        signs[i] = 1.0 - 2.0 * np.float64(philox(key, number, i, 0, 2)[0] & np.uint64(1))
