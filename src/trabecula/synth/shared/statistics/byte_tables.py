"""Tables by the byte of a field: looked up and counted, many planes in one call, so that threads
hardly wait for each other.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel


@kernel
def look_up_bytes(planes, table, found):
    """Write the entry of a table (256,) for every byte."""
    for z in range(planes.shape[0]):
        for y in range(planes.shape[1]):
            for x in range(planes.shape[2]):
                found[z, y, x] = table[planes[z, y, x]]


@kernel
def count_bytes(planes, free):
    """Count each byte, of free voxels where `free` is not empty, (256,) int64."""
    counts = np.zeros(256, np.int64)
    for z in range(planes.shape[0]):
        for y in range(planes.shape[1]):
            for x in range(planes.shape[2]):
                if not free.size or free[z, y, x]:
                    counts[planes[z, y, x]] += 1
    return counts
