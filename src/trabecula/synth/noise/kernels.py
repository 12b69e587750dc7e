"""White noise: a function of seed and coordinate alone."""

from __future__ import annotations

from trabecula.engine.compile import kernel
from trabecula.engine.normals import normal_line


@kernel
def white_plane(plane, key, z, corner, periods, table):
    """Independent normal numbers in the table's units, of the voxels from (z, *corner) on, (Y, X) float64; periods 0: endless."""
    for y in range(plane.shape[0]):
        row = corner[0] + y
        if periods[0] > 0:
            row = row % periods[0]
        normal_line(plane[y], key, z, row, corner[1], periods[1], table)
