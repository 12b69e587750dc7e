"""Packed bodies as voxels: how deep each lies in a body."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.synth.packing.arrangement import Arrangement
from trabecula.synth.packing.radial_shapes import radius_towards
from trabecula.synth.shared.packed.depth import REACH, depth_field


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
    reach = arrangement.radii.max(axis=1)[arrangement.shapes].astype(np.float64) + REACH
    given = (
        arrangement.places,
        reach,
        arrangement.shapes,
        arrangement.turns,
        arrangement.radii,
        arrangement.sides,
        steps,
    )
    return depth_field(
        lambda field, margin, a, b: _draw(*given, margin, field, a, b), shape, steps, fillet
    )


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
