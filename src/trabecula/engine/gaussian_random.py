"""Standard normal numbers by coordinate, the same to the last bit on every machine.

The logarithm and cosine of the usual recipe (Box and Muller 1958) may differ in their last bit
between C libraries. Here 16 random bits choose from a table of quantiles, rounded, so that whole
numbers alone decide. The numbers end at 4.3 standard deviations.
"""

from __future__ import annotations

from functools import cache
from statistics import NormalDist

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.random import philox

ONE = 4096
"""The whole number that stands for one standard deviation."""


@cache
def quantiles(one: int = ONE) -> np.ndarray:
    """Return the normal distribution's quantiles in the middle of 65536 equal parts, (65536,)
    int16, where `one` stands for 1.
    """
    half = 1 << 15
    upper = [NormalDist().inv_cdf((half + i + 0.5) / (2 * half)) * one for i in range(half)]
    rising = np.rint(upper).astype(np.int16)
    table = np.concatenate([-rising[::-1], rising])
    table.flags.writeable = False
    return table


@inline
def _place(coordinate, period):
    """Return a coordinate, taken round an axis that repeats (period above 0)."""
    return coordinate if period == 0 else coordinate % period


@kernel
def normal_line(line, key, z, y, first, period, table):
    """Draw normal numbers, in the table's units, for the voxels first, first + 1, ... along x into
    a line: eight a draw.
    """
    group = np.int64(-1) << np.int64(40)
    w = philox(key, 0, 0, 0, 0)
    for i in range(len(line)):
        x = _place(first + i, period)
        if x >> 3 != group:
            group = x >> 3
            w = philox(key, z, y, group, 0)
        at = x & 7
        word = w[0] if at < 2 else w[1] if at < 4 else w[2] if at < 6 else w[3]
        line[i] = table[np.int64((word >> np.uint64(16 * (at & 1))) & np.uint64(0xFFFF))]


@kernel
def normal_cells(cells, key, corner, periods, table):
    """Draw standard normal numbers for every channel of the cells at corner, corner + 1, ...: (C,
    Z, Y, X) float32, eight channels a draw.
    """
    scale = np.float32(1.0 / 4096.0)
    for z in range(cells.shape[1]):
        for y in range(cells.shape[2]):
            for x in range(cells.shape[3]):
                cz = _place(corner[0] + z, periods[0])
                cy = _place(corner[1] + y, periods[1])
                cx = _place(corner[2] + x, periods[2])
                for first in range(0, cells.shape[0], 8):
                    w = philox(key, cz, cy, cx, first >> 3)
                    for c in range(first, min(first + 8, cells.shape[0])):
                        at = c & 7
                        word = w[0] if at < 2 else w[1] if at < 4 else w[2] if at < 6 else w[3]
                        bits = np.int64((word >> np.uint64(16 * (at & 1))) & np.uint64(0xFFFF))
                        cells[c, z, y, x] = np.float32(table[bits]) * scale
