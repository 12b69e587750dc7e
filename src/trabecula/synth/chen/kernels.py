"""Counting how often pixels are used: a plain function on arrays."""

from __future__ import annotations

from trabecula.engine.compile import kernel


@kernel
def count_sources(sources, counts, start, stop):
    """Of how many voxels of planes start..stop of (Z, Y, X) each pixel is the source, added to
    counts (n,); -1 is none.
    """
    for z in range(start, stop):
        for y in range(sources.shape[1]):
            for x in range(sources.shape[2]):
                if sources[z, y, x] >= 0:
                    counts[sources[z, y, x]] += 1
