"""What a run takes: bytes of what it holds whatever its size, and of what grows with it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.core.request import Request
from trabecula.synth.quilt.bit_packing import planes_for
from trabecula.synth.quilt.candidate_pools import HELD
from trabecula.synth.quilt.canvas import deep_shape
from trabecula.synth.quilt.config import QuiltConfig
from trabecula.synth.quilt.patch_library import Learnt
from trabecula.synth.quilt.period import in_phase, phase_key
from trabecula.synth.quilt.windows import Frame

_A_PLACE = 29 + 72
"""Bytes of a place: its piece, what the trace says of it, and a body or two that begin there, of 24
in a book that doubles.
"""

_AT_ONCE = 32
"""Bytes a voxel of a slab while parts of what is given are found in it: runs, labels, masks."""


@dataclass(frozen=True)
class Needs:
    """Bytes, by what they are for.

    Attributes
    ----------
    fixed : dict of str to int
        That do not depend on the request's size, but for the phases of a lattice that its places
        have.
    growing : dict of str to int
        That grow with it.
    slab : int
        Of one plane of it, with what work on it takes, and of the windows of one row.
    voxels : int
        Of the result.
    """

    fixed: dict[str, int]
    growing: dict[str, int]
    slab: int
    voxels: int


def needs_of(learnt: Learnt, config: QuiltConfig, request: Request) -> Needs:
    """The needs of a request."""
    shape = deep_shape(request)
    wraps = (False,) * (3 - len(request.periodic)) + tuple(request.periodic)
    frame = Frame(shape, wraps, learnt.box, learnt.step, (0, 0, 0))
    plane, row = shape[1] * shape[2], shape[2]
    voxels, places = shape[0] * plane, int(np.prod(frame.counts, dtype=np.int64))
    planes = planes_for(len(learnt.images[0].phases))
    window = int(
        np.prod([side + 2 * margin for side, margin in zip(frame.patch, frame.margin, strict=True)])
    )
    each = 1 + (4 if config.connected != "none" else 0)
    given = _given(request)
    return Needs(
        {
            "exemplar": sum(image.values.size for image in learnt.images) * (2 + 16 * planes),
            "candidates": _candidates(learnt, frame, len(request.target)),
            "windows": 160 * window,
        },
        {"result": voxels * (each + given) + places * _A_PLACE},
        plane * (each + (_AT_ONCE if given else 0))
        + window // (learnt.box[2] + 2 * frame.margin[2]) * row * each,
        voxels,
    )


def _given(request: Request) -> int:
    """Bytes a voxel while what is given is entered, where all is in memory."""
    if request.fixed is not None:
        return 16
    return 1 if request.mask is not None else 0


def _candidates(learnt: Learnt, frame: Frame, named: int) -> int:
    """Of candidates: their descriptors, what ranking them takes, and the pools of all phases that
    places have.
    """
    count = sum(int(np.prod(counts)) for counts in learnt.counts)
    pooled = sum(_pooled(learnt, frame, source) for source in range(len(learnt.counts)))
    return count * (40 + 8 * named) + max(0, min(pooled, (HELD + 1) * count) - count) * (
        4 + 2 * max(named, 1)
    )


def _pooled(learnt: Learnt, frame: Frame, source: int) -> int:
    """Candidates of an exemplar in all pools together."""
    total = 1
    for axis, period in enumerate(learnt.periods):
        firsts = range(0, frame.counts[axis] * frame.step[axis], frame.step[axis])
        keys = {phase_key((first,), (period,))[0] for first in firsts}
        total *= sum(
            len(in_phase(learnt.counts[source][axis], k, learnt.shifts[source][axis], period))
            for k in keys
        )
    return total
