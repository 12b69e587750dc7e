"""One round: neighbourhoods on their principal components, turned, transported along every axis,
turned back and put back.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.engine.parallel import one_blas_thread, thread_count
from trabecula.synth.shared.neighbourhoods import SCALE, project, steps_of
from trabecula.synth.shared.statistics.sites import BATCH, Sites
from trabecula.synth.shared.statistics.sliced_kernels import draw_signs
from trabecula.synth.shared.statistics.slices import FINE, SliceTarget
from trabecula.synth.shared.statistics.transport import AT_ONCE, BINS, Transport
from trabecula.synth.shared.votes import UNIT


@dataclass(frozen=True)
class SlicedRound:
    """What is drawn for one round, how far apart its neighbourhoods lie, and how far they move."""

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
) -> None:
    """Add the moved neighbourhoods that hold a voxel to total (C, Z, Y, X) int32, and their number
    to votes (Z, Y, X) int32.
    """
    basis, size = slices.basis, slices.features.shape[1]
    steps = steps_of(round_.step, flat=basis.flat)
    sites = Sites.drawn(
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

    def along(start: int, stop: int) -> Iterator[np.ndarray]:
        for rows in sites.rows(features, start, stop, few=AT_ONCE):
            yield rows.astype(np.float32) @ turn[:count]

    with one_blas_thread():
        transport = Transport.between(along, len(features), slices.features @ turn)

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
    """A random turn of `size` axes (a power of two) times `size`, in whole numbers: Hadamard's
    matrix twice, with random signs before, between and behind."""
    matrix: np.ndarray = np.ones((1, 1))
    while len(matrix) < size:
        matrix = np.block([[matrix, matrix], [matrix, -matrix]])
    signs = np.empty(3 * size)
    draw_signs(key, number, signs)
    first, second, third = signs.reshape(3, size)
    with one_blas_thread():
        return np.asarray((first[:, None] * matrix * second) @ matrix * third)


def round_bytes(slices: SliceTarget) -> int:
    """Memory that a round takes whatever the volume: features of the exemplars, and neighbourhoods
    that are put back.
    """
    size, (components, length), threads = (
        slices.features.shape[1],
        slices.back.shape,
        thread_count(),
    )
    batch = 4 * BATCH + BATCH // length * (2 * components + 40)
    of_a_thread = AT_ONCE * (20 * size + 8 * length) + 24 * size * BINS
    return slices.features.nbytes + batch + 40 * size * BINS + threads * of_a_thread
