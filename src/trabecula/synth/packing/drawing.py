"""Packed bodies as voxels: how deep every voxel lies in a body, edges rounded, and the phase's
share of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.smooth import gaussian, reach_of
from trabecula.synth.packing.arrangement import Arrangement
from trabecula.synth.packing.radial_shapes import radius_towards

_MARKS = 1025  # shares whose depth is known, from 0 to 1

REACH = 4.5
"""Edges beyond a body's surface as far as its distance is drawn."""


def draw_depth(
    arrangement: Arrangement, shape: Sequence[int], steps: np.ndarray, fillet: float
) -> np.ndarray:
    """Return how deep voxels lie in the nearest body, edges, negative outside.

    Parameters
    ----------
    arrangement : Arrangement
    shape : three ints
        Voxels from the first corner of its box on; the box repeats.
    steps : (3,) float64
        Edges of a voxel in units of the smallest.
    fillet : float
        Standard deviation of the Gaussian that rounds it, edges.

    Returns
    -------
    depth : float32 array, (Z, Y, X)
    """
    sigma = fillet / steps
    margin = np.array([reach_of(float(width)) for width in sigma])
    field = np.full(tuple(np.asarray(shape) + 2 * margin), -REACH, np.float32)
    reach = arrangement.radii.max(axis=1)[arrangement.shapes].astype(np.float64) + REACH
    given = (
        arrangement.places,
        reach,
        arrangement.shapes,
        arrangement.turns,
        arrangement.radii,
        arrangement.sides,
        steps,
        margin,
    )
    for_slabs(lambda a, b: _draw(*given, field, a, b), len(field))
    if fillet:
        np.clip(field, -REACH, REACH, out=field)
        field = gaussian(field, sigma)
    inner = tuple(slice(m, m + side) for m, side in zip(margin, shape, strict=True))
    return field[inner]


def deepest_share(depth: np.ndarray, share: float, inside: np.ndarray | None = None) -> np.ndarray:
    """Return the voxels that lie deepest, (Z, Y, X) bool: this share of all, or of those `inside`;
    of equally deep ones the first.
    """
    values = depth.ravel() if inside is None else depth[inside]
    count = round(share * values.size)
    if not 0 < count < values.size:
        chosen = np.full(values.size, count > 0)
    else:
        least = np.partition(values, values.size - count)[values.size - count]
        chosen = values > least
        level = np.flatnonzero(values == least)
        chosen[level[: count - int(np.count_nonzero(chosen))]] = True
    if inside is None:
        return chosen.reshape(depth.shape)
    found = np.zeros(depth.shape, bool)
    found[inside] = chosen
    return found


def deepest_by_share(
    depth: np.ndarray, shares: np.ndarray, inside: np.ndarray | None = None
) -> np.ndarray:
    """Return the voxels that lie deeper than all but a share of them (or of those `inside`), which
    is given for every voxel: (Z, Y, X) bool. Bodies grow where it is large.
    """
    values = depth.ravel() if inside is None else depth[inside]
    marks = np.linspace(0, 1, _MARKS)
    levels = np.quantile(values, 1 - marks)
    found = depth > np.interp(shares, marks, levels)
    return found if inside is None else found & inside


@kernel
def _draw(places, reach, shapes, turns, radii, sides, steps, margin, field, start, stop):
    """Raise planes start..stop of a field, whose voxel `margin` is the box's first, to the depth in
    bodies, which repeat with the box.
    """
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    for i in range(len(places)):
        turn, table = turns[i], radii[shapes[i]]
        for axis in range(3):
            # the periods in which the body meets the field
            low = -margin[axis] * steps[axis] - places[i, axis] - reach[i]
            high = (field.shape[axis] - margin[axis]) * steps[axis] - places[i, axis] + reach[i]
            first[axis] = np.int64(np.ceil(low / sides[axis]))
            last[axis] = np.int64(np.floor(high / sides[axis]))
        for a in range(first[0], last[0] + 1):
            pz = places[i, 0] + a * sides[0]
            z0 = max(np.int64(np.floor((pz - reach[i]) / steps[0])) + margin[0], start)
            z1 = min(np.int64(np.ceil((pz + reach[i]) / steps[0])) + margin[0] + 1, stop)
            if z0 >= z1:
                continue
            for b in range(first[1], last[1] + 1):
                py = places[i, 1] + b * sides[1]
                y0 = max(np.int64(np.floor((py - reach[i]) / steps[1])) + margin[1], 0)
                y1 = np.int64(np.ceil((py + reach[i]) / steps[1])) + margin[1] + 1
                y1 = min(y1, field.shape[1])
                for c in range(first[2], last[2] + 1):
                    px = places[i, 2] + c * sides[2]
                    x0 = max(np.int64(np.floor((px - reach[i]) / steps[2])) + margin[2], 0)
                    x1 = np.int64(np.ceil((px + reach[i]) / steps[2])) + margin[2] + 1
                    x1 = min(x1, field.shape[2])
                    for z in range(z0, z1):
                        dz = (z - margin[0] + 0.5) * steps[0] - pz
                        for y in range(y0, y1):
                            dy = (y - margin[1] + 0.5) * steps[1] - py
                            for x in range(x0, x1):
                                dx = (x - margin[2] + 0.5) * steps[2] - px
                                length = np.sqrt(dz * dz + dy * dy + dx * dx) + 1e-9
                                if length > reach[i]:
                                    continue
                                radius = radius_towards(
                                    table,
                                    turn[0, 0] * dz + turn[1, 0] * dy + turn[2, 0] * dx + 1e-12,
                                    turn[0, 1] * dz + turn[1, 1] * dy + turn[2, 1] * dx,
                                    turn[0, 2] * dz + turn[1, 2] * dy + turn[2, 2] * dx,
                                )
                                depth = np.float32(radius - length)
                                if depth > field[z, y, x]:
                                    field[z, y, x] = depth
