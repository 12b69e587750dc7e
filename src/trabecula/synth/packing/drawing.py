"""Packed bodies as voxels: how deep each lies in a body."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.synth.packing.arrangement import Arrangement
from trabecula.synth.packing.radial_shapes import radius_towards
from trabecula.synth.shared.packed.depth import REACH, depth_field


def draw_depth(
    arrangement: Arrangement, shape: Sequence[int], steps: np.ndarray, fillet: float
) -> np.ndarray:
    """Return how deep voxels lie in the nearest body: as `depth_field`."""
    given = (arrangement.places, arrangement.shapes, arrangement.turns, arrangement.radii, steps)
    return depth_field(
        partial(_draw, *given),
        arrangement.places,
        arrangement.radii.max(axis=1)[arrangement.shapes].astype(np.float64) + REACH,
        arrangement.sides,
        shape,
        steps,
        fillet,
    )


@kernel
def _draw(places, shapes, turns, radii, steps, copies, field, margin, start, stop):
    """Raise planes start..stop of a field, whose voxel `margin` is the box's first, to the depth in
    copies of bodies.
    """
    for k in range(len(copies.owners)):
        i, low, high = copies.owners[k], copies.starts[k], copies.stops[k]
        turn, table = turns[i], radii[shapes[i]]
        far = table.max() + REACH
        pz, py, px = places[i] + copies.shifts[k]
        for z in range(max(low[0], start), min(high[0], stop)):
            dz = (z - margin[0] + 0.5) * steps[0] - pz
            for y in range(low[1], high[1]):
                dy = (y - margin[1] + 0.5) * steps[1] - py
                for x in range(low[2], high[2]):
                    dx = (x - margin[2] + 0.5) * steps[2] - px
                    length = np.sqrt(dz * dz + dy * dy + dx * dx) + 1e-9
                    if length > far:
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
