"""Volumes that are made whole by the paper's own rounds (`particles`), of the bubbles that any
other run of the seed has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from trabecula.core.request import Request
from trabecula.synth.bubbles.config import BubblesConfig
from trabecula.synth.bubbles.growth import Growth
from trabecula.synth.bubbles.particles import Grown, grown

_A_VOXEL = 110  # bytes: who stands near it, who asks for it, the contours
_A_DIRECTION = 10  # bytes more of a voxel: the flow there, and its turn into int8


def grown_whole(
    growth: Growth, config: BubblesConfig, request: Request, porosity: float | None
) -> Grown:
    """Particles that have grown in a request, in its mask and its room."""
    shape, ndim = request.shape, len(request.shape)
    box = tuple((0, side) for side in shape)
    flow = growth.flow if config.randomness < 1 else None
    room = growth.room(box if ndim == 3 else ((0, 1), *box))
    room = (
        request.mask
        if room is None
        else room.reshape(shape) & (True if request.mask is None else request.mask)
    )
    return grown(
        _starts(growth, shape),
        shape,
        seed=request.seed,
        separation=growth.law.wall,
        randomness=config.randomness,
        directions=None if flow is None else flow.directions(box),
        room=room,
        periodic=request.periodic,
        rounds=None if config.time is None else round(growth.law.latest),
        porosity=porosity,
    )


def _starts(growth: Growth, shape: Sequence[int]) -> np.ndarray:
    """Voxels (N, d) that bubbles of a request start from."""
    deep = (1,) * (3 - len(shape)) + tuple(shape)
    places = growth.world(tuple((0, side) for side in deep))[1][1]
    voxels = np.floor(places).astype(np.int64)
    inside = ((voxels >= 0) & (voxels < deep)).all(1)
    return voxels[inside][:, 3 - len(shape) :]


def bytes_of_particles(shape: Sequence[int], *, flows: bool) -> int:
    """What the rounds hold beside the air."""
    return (_A_VOXEL + (_A_DIRECTION if flows else 0)) * math.prod(shape)
