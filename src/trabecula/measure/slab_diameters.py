"""Mean diameter of the largest inscribed spheres of a volume that is read some planes at a time.

Of each slab H further planes are read on either side. Distances in the planes within H / 2 of the
slab are those of the whole as long as none exceeds H / 2, since whatever lies beyond what was read
is farther. Then no sphere about a voxel beyond those planes reaches into the slab: distances
change by at most a plane from one to the next, so a sphere that did would have left a distance of
more than H / 2 within them. Where one exceeds it, more planes are read.
"""

from __future__ import annotations

import math

import numpy as np

from trabecula.core.progress import track
from trabecula.engine.lazy_volume import Slabs
from trabecula.measure.distance import distance_transform
from trabecula.measure.phases import indicator
from trabecula.measure.spheres import paint_largest

_VOXEL_BYTES = 32
"""Memory per voxel of what is read at once."""

_FIRST = 16
"""Planes beyond a slab that are read before any distance is known."""


def mean_diameter_of_slabs(
    volume: Slabs, *, phase: str | None, default: str, depth: int, memory: int
) -> float | None:
    """Return the mean `local_thickness` of a phase, in the volume's unit.

    Parameters
    ----------
    volume : Slabs
        Labels, (Z, Y, X).
    phase : str, optional
        Default: `default`, "solid" or "void".
    default : str
    depth : int
        Planes of a slab at most.
    memory : int
        Bytes of a slab with its planes beyond.

    Returns
    -------
    diameter : float, or None
        None where the largest sphere needs more planes at once than fit, where the phase is empty,
        and where it fills the volume.
    """
    length = volume.shape[0]
    most = memory // (_VOXEL_BYTES * math.prod(volume.shape[1:]))
    beyond, first, total, count = _FIRST, 0, 0.0, 0
    progress = iter(track(range(length), f"diameters ({phase or default})", total=length))
    while first < length:
        core = min(depth, length - first, max(most - 2 * beyond, most - length + 1, 1))
        if min(core + 2 * beyond, length) > most:
            return None
        found = _slab_sum(volume, phase, default, first, first + core, beyond)
        if found is None:
            if beyond >= length:
                return None  # nothing bounds the phase
            beyond *= 2
            continue
        total, count = total + found[0], count + found[1]
        first += core
        for _ in range(core):
            next(progress, None)
    return total / count if count else None


def _slab_sum(
    volume: Slabs, phase: str | None, default: str, first: int, last: int, beyond: int
) -> tuple[float, int] | None:
    """Return the sum of the diameters of the voxels of planes first..last, and their number; None
    where more planes beyond are needed.
    """
    length, near = volume.shape[0], beyond // 2
    low, high = max(0, first - beyond), min(length, last + beyond)
    inside = indicator(volume.planes(low, high), phase, default=default)[1]
    core = inside[first - low : last - low]
    if not core.any():
        return 0.0, 0
    edge = min(volume.spacing)
    steps = np.array(volume.spacing) / edge
    whole = (low, high) == (0, length)
    bottom, top = (0, length) if whole else (max(0, first - near), min(length, last + near))
    radius = distance_transform(inside, spacing=steps.tolist())[bottom - low : top - low]
    if whole:
        if not np.isfinite(radius.max()):
            return None
    elif radius.max() > near * steps[0]:
        return None
    diameter = paint_largest(np.ascontiguousarray(radius), steps, (False,) * 3)
    own = diameter[first - bottom : last - bottom][core]
    own -= np.float32(0.5)
    own *= np.float32(edge)
    return float(own.sum(dtype=np.float64)), len(own)
