"""Sums and products of vectors in a fixed order, whatever the number of threads (BLAS promises no
order).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_items

_CHUNK = 1 << 19
"""Numbers that are summed by themselves, and that one thread takes at once."""


def dot(a: np.ndarray, b: np.ndarray) -> float:
    """Return the scalar product, accumulated in float64."""
    parts = np.zeros(max(1, -(-len(a) // _CHUNK)))

    def work(start: int, stop: int) -> None:
        inside = slice(start // _CHUNK, -(-stop // _CHUNK))
        _dot(a[start:stop], b[start:stop], parts[inside], _CHUNK)

    for_chunks(work, len(a))
    return float(parts.sum())


def combine(s: float, a: np.ndarray, t: float, b: np.ndarray) -> np.ndarray:
    """Return s a + t b."""
    c = np.empty_like(a)
    for_chunks(
        lambda start, stop: _combine(s, a[start:stop], t, b[start:stop], c[start:stop]), len(a)
    )
    return c


def subtract(a: np.ndarray, t: float, b: np.ndarray) -> np.ndarray:
    """Return a - t b."""
    c = np.empty_like(a)
    for_chunks(
        lambda start, stop: _subtract(a[start:stop], t, b[start:stop], c[start:stop]), len(a)
    )
    return c


def add_to(a: np.ndarray, t: float, b: np.ndarray) -> None:
    """Add t b to a."""
    for_chunks(lambda start, stop: _add_to(a[start:stop], t, b[start:stop]), len(a))


def for_chunks(work: Callable[[int, int], object], length: int) -> None:
    """Call `work(start, stop)` on whole chunks of a vector, the last one shorter, in threads."""
    if length <= _CHUNK:
        work(0, length)
        return
    for_items(
        lambda first, last: work(first * _CHUNK, min(last * _CHUNK, length)), -(-length // _CHUNK)
    )


@kernel
def _dot(a, b, parts, chunk):
    """Set the scalar product of every chunk, in eight interleaved sums: one sum would wait for each
    addition.
    """
    for n in range(len(parts)):
        u, v = a[n * chunk : (n + 1) * chunk], b[n * chunk : (n + 1) * chunk]
        p0 = p1 = p2 = p3 = p4 = p5 = p6 = p7 = 0.0
        for k in range(len(u) // 8):
            i = 8 * k
            p0 += np.float64(u[i]) * np.float64(v[i])
            p1 += np.float64(u[i + 1]) * np.float64(v[i + 1])
            p2 += np.float64(u[i + 2]) * np.float64(v[i + 2])
            p3 += np.float64(u[i + 3]) * np.float64(v[i + 3])
            p4 += np.float64(u[i + 4]) * np.float64(v[i + 4])
            p5 += np.float64(u[i + 5]) * np.float64(v[i + 5])
            p6 += np.float64(u[i + 6]) * np.float64(v[i + 6])
            p7 += np.float64(u[i + 7]) * np.float64(v[i + 7])
        total = p0 + p1 + p2 + p3 + p4 + p5 + p6 + p7
        for i in range(len(u) // 8 * 8, len(u)):
            total += np.float64(u[i]) * np.float64(v[i])
        parts[n] = total


@kernel
def _combine(s, a, t, b, c):
    for i in range(len(a)):
        c[i] = s * a[i] + t * b[i]


@kernel
def _subtract(a, t, b, c):
    for i in range(len(a)):
        c[i] = a[i] - t * b[i]


@kernel
def _add_to(a, t, b):
    for i in range(len(a)):
        a[i] += t * b[i]
