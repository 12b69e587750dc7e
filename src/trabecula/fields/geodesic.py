"""Distance inside a domain, around what is not in it: the shortest way, not the straight line.

The eikonal equation |grad t| = 1 by fast sweeping: upwind differences of first order, updated in
the eight orders in which the axes can be run through (Zhao 2005,
doi:10.1090/S0025-5718-04-01678-3), until nothing changes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.engine.compile import inline, kernel

# voxels around the source in which the straight line is taken, where nothing is in its way
_BALL = 4
_SETTLED = 1e-9  # of a voxel's edge
_MOST = 1000  # rounds; a maze with more turns than this is none that a material is put into


def interior_distance(
    inside: np.ndarray, point: Sequence[float], spacing: Sequence[float]
) -> np.ndarray:
    """Length of the shortest way inside a domain from a point to every voxel's middle.

    Parameters
    ----------
    inside : (Z, Y, X) or (Y, X) bool
        The domain.
    point : one float per axis
        From the first voxel's corner, in the unit of the spacing; in a voxel of the domain.
    spacing : one float per axis
        Voxel edges.

    Returns
    -------
    distance : float64 array, the domain's shape
        Infinite outside the domain, and where no way leads. First order: up to some percent long
        across the grid.
    """
    deep = np.ascontiguousarray(inside if inside.ndim == 3 else inside[None])
    edges = np.array(spacing if inside.ndim == 3 else (1.0, *spacing), np.float64)
    at = np.array(point if inside.ndim == 3 else (0.5, *point), np.float64)
    time = np.full(deep.shape, np.inf)
    held = _begun(deep, at, edges, time)
    for _ in range(_MOST):
        if _swept(deep, held, edges, time) <= _SETTLED * edges.min():
            break
    return time if inside.ndim == 3 else time[0]


def _begun(inside: np.ndarray, at: np.ndarray, edges: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Straight lines around the source, written into `time`; and where they are."""
    cell = np.clip((at / edges).astype(np.int64), 0, np.array(inside.shape) - 1)
    for reach in (_BALL, 1, 0):
        box = tuple(slice(max(0, c - reach), c + reach + 1) for c in cell)
        if inside[box].all() or reach == 0:
            break
    grid = np.meshgrid(
        *(np.arange(s.start, min(s.stop, n)) for s, n in zip(box, inside.shape, strict=True)),
        indexing="ij",
    )
    apart = [
        (index + 0.5) * edge - origin for index, edge, origin in zip(grid, edges, at, strict=True)
    ]
    time[box] = np.sqrt(sum(difference**2 for difference in apart))
    held = np.zeros(inside.shape, bool)
    held[box] = True
    return held


@inline
def _upwind(a, b, c, p, q, r):
    """The arrival time behind neighbours that were reached at a, b, c, at steps p, q, r along their
    axes.
    """
    if b < a:
        a, b, p, q = b, a, q, p
    if c < b:
        b, c, q, r = c, b, r, q
    if b < a:
        a, b, p, q = b, a, q, p
    t = a + p
    if t <= b:
        return t
    # ((t - a) / p)^2 + ((t - b) / q)^2 = 1, and then with the third.
    u, v = 1.0 / (p * p), 1.0 / (q * q)
    square, line, rest = u + v, u * a + v * b, u * a * a + v * b * b - 1.0
    t = (line + np.sqrt(max(0.0, line * line - square * rest))) / square
    if t <= c:
        return t
    w = 1.0 / (r * r)
    square, line, rest = square + w, line + w * c, rest + w * c * c
    return (line + np.sqrt(max(0.0, line * line - square * rest))) / square


@kernel
def _swept(inside, held, edges, time):
    """One round of the eight orders; the largest change."""
    depth, height, width = time.shape
    largest = 0.0
    far = np.inf
    for order in range(8):
        for i in range(depth):
            z = i if order & 4 else depth - 1 - i
            for j in range(height):
                y = j if order & 2 else height - 1 - j
                for k in range(width):
                    x = k if order & 1 else width - 1 - k
                    if not inside[z, y, x] or held[z, y, x]:
                        continue
                    a = min(
                        time[z - 1, y, x] if z else far, time[z + 1, y, x] if z + 1 < depth else far
                    )
                    b = min(
                        time[z, y - 1, x] if y else far,
                        time[z, y + 1, x] if y + 1 < height else far,
                    )
                    c = min(
                        time[z, y, x - 1] if x else far, time[z, y, x + 1] if x + 1 < width else far
                    )
                    if min(a, b, c) == far:
                        continue
                    t = _upwind(a, b, c, edges[0], edges[1], edges[2])
                    if t < time[z, y, x]:
                        change = time[z, y, x] - t
                        largest = max(largest, change)
                        time[z, y, x] = t
    return largest
