"""What a flow holds: slices that are kept, the room, and the work on one slice or slab."""

from __future__ import annotations

import math
from collections.abc import Sequence

from trabecula.core.checks import as_spacing
from trabecula.synth.bubbles.flow.config import FlowConfig
from trabecula.synth.bubbles.flow.outline import cell_of
from trabecula.synth.bubbles.flow.room import MARGIN, SLAB
from trabecula.synth.bubbles.flow.slices import KEPT, ORDER

_OWN = 1000  # of a slice that is kept, beside its arrays
_STEP = 340  # a node of a slice, while the step of Runge-Kutta is taken
_PIECES = 60  # a voxel of a slice, while its parts are told apart
_DISTANCE = 7  # a voxel of a slab, while distances are found
_LEAST = 100_000


def bytes_of_flow(
    config: FlowConfig,
    shape: Sequence[int],
    spacing: float | Sequence[float],
    *,
    masked: bool,
    distance: float = 1.0,
    step: int = 1,
) -> int:
    """Memory of the flow of a request beside the directions themselves, which are 3 bytes a node.

    Parameters
    ----------
    config, shape, spacing, distance : as of `flow_of`
    masked : bool
        Whether there is a mask.
    step : int
        Voxels from node to node.
    """
    edges = as_spacing(spacing, ndim=len(shape))
    silhouette, crust = (
        config.flow_length(name, distance) if masked else 0.0 for name in ("silhouette", "crust")
    )
    flat = len(shape) == 2
    along, tall, wide = (
        (1, *shape)[axis] if flat else shape[axis]
        for axis in ORDER["z" if flat else config.flow_axis]
    )
    voxels = tall * wide
    work = _STEP * voxels / step**2
    kept = 0.0
    if masked:
        each: float = _OWN
        if silhouette:
            every, cells = cell_of(silhouette / min(edges))
            around = (tall / every + 2 * cells) * (wide / every + 2 * cells)
            each += 2 * voxels / every**2
            work += 64 * around
        if config.flow_centre == "piece":
            each += 8 * voxels
            work += _PIECES * voxels
        kept = min(KEPT + each, math.ceil(along / step) * each)
        work += 3 * voxels
    return int(work + kept + (_of_room(shape, crust, edges) if crust else 0)) + _LEAST


def _of_room(shape: Sequence[int], crust: float, edges: Sequence[float]) -> float:
    """One bit a voxel, and a slab whose distances are found."""
    margin = [2 * (math.ceil(crust / edge) + MARGIN) for edge in edges]
    first = min(SLAB, shape[0]) if len(shape) == 3 else shape[0]
    slab = [side + far for side, far in zip((first, *shape[1:]), margin, strict=True)]
    return math.prod(shape) / 8 + _DISTANCE * math.prod(slab) + 2 * first * math.prod(shape[1:])
