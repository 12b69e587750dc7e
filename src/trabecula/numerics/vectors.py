"""Sums and products of vectors in a fixed order, whatever the number of threads (BLAS promises no
order).
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel


@kernel
def dot(a, b):
    """Return the scalar product, accumulated in float64 in eight interleaved sums: one sum would
    wait for each addition.
    """
    part = np.zeros(8)
    whole = len(a) // 8 * 8
    for i in range(0, whole, 8):
        for n in range(8):
            part[n] += np.float64(a[i + n]) * np.float64(b[i + n])
    total = part[0] + part[1] + part[2] + part[3] + part[4] + part[5] + part[6] + part[7]
    for i in range(whole, len(a)):
        total += np.float64(a[i]) * np.float64(b[i])
    return total


@kernel
def combine(s, a, t, b):
    """Return s a + t b."""
    c = np.empty_like(a)
    for i in range(len(a)):
        c[i] = s * a[i] + t * b[i]
    return c


@kernel
def subtract(a, t, b):
    """Return a - t b."""
    c = np.empty_like(a)
    for i in range(len(a)):
        c[i] = a[i] - t * b[i]
    return c


@kernel
def add_to(a, t, b):
    """Add t b to a."""
    for i in range(len(a)):
        a[i] += t * b[i]
