"""Contours of a layer: the lines where a share crosses one half, by marching squares.

Where two solid corners of a square lie on a diagonal the solid is separated, as on the surfaces of
`mesh`. Every cut edge begins one line and ends one, so all lines close.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel

_HALF = 0.5


def find_contours(shares: np.ndarray) -> list[np.ndarray]:
    """Return the closed lines around a phase.

    Parameters
    ----------
    shares : (Y, X) float32
        Of the phase at the centres of pixels.

    Returns
    -------
    list of (N, 2) float64
        x and y in pixels, the centre of the first pixel at (0.5, 0.5); the last point is not the
        first one again. Solid is to the left where y points up: outlines turn counter-clockwise,
        holes clockwise. Solid ends at the border of the layer.
    """
    padded = np.pad(shares.astype(np.float32), 1)
    follower = np.full(2 * padded.size, -1, np.int64)
    _link(padded, follower)
    points = np.empty((np.count_nonzero(follower >= 0), 2))
    ends = _walk(padded, follower, points)
    return [line for line in np.split(points, ends) if len(line)]


def signed_area(line: np.ndarray) -> float:
    """Return the area within a closed line; negative: it turns clockwise."""
    x, y = line[:, 0], line[:, 1]
    return float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2)


@kernel
def _link(shares, follower):
    """Write for every cut edge the one that the line goes to.

    Edge 2 (y X + x) leads from corner (y, x) to (y, x + 1), the one after it to (y + 1, x).
    """
    height, width = shares.shape
    solid = np.empty(4, np.bool_)
    edges = np.empty(4, np.int64)
    for y in range(height - 1):
        for x in range(width - 1):
            # counter-clockwise with y up; edge k is between corner k and the next
            solid[0] = shares[y, x] >= _HALF
            solid[1] = shares[y, x + 1] >= _HALF
            solid[2] = shares[y + 1, x + 1] >= _HALF
            solid[3] = shares[y + 1, x] >= _HALF
            edges[0] = 2 * (y * width + x)
            edges[1] = 2 * (y * width + x + 1) + 1
            edges[2] = 2 * ((y + 1) * width + x)
            edges[3] = 2 * (y * width + x) + 1
            for k in range(4):
                if solid[k] and not solid[(k + 1) % 4]:
                    first = k
                    while solid[(first + 3) % 4]:
                        first = (first + 3) % 4
                    # the line enters beyond the last solid corner and leaves before the first
                    follower[edges[k]] = edges[(first + 3) % 4]


@kernel
def _walk(shares, follower, points):
    """Write the points of all lines one after the other, and return where each ends."""
    width = shares.shape[1]
    ends = np.empty(len(points), np.int64)
    lines = count = 0
    for start in range(len(follower)):
        edge = start
        while follower[edge] >= 0:
            corner, down = edge // 2, edge % 2
            y, x = corner // width, corner % width
            low = shares[y, x]
            high = shares[y + 1, x] if down else shares[y, x + 1]
            along = (_HALF - low) / (high - low)
            points[count, 0] = x - 0.5 + (0.0 if down else along)
            points[count, 1] = y - 0.5 + (along if down else 0.0)
            count += 1
            after = follower[edge]
            follower[edge] = -1
            edge = after
        if count > (ends[lines - 1] if lines else 0):
            ends[lines] = count
            lines += 1
    return ends[:lines]
