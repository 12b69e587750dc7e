"""Growth voxel by voxel in NumPy, straight from its definition: the reference of the kernels."""

import numpy as np


def void(places, brakes, points, *, wall, level, across=1.0, along=1.0, flow=(0, 0, 0)):
    """Return a mask of the void among points (N, 3).

    It is where the first bubble comes before T^2 = level, and no other meets it within half a wall.
    """
    return np.concatenate(
        [
            _void(places, brakes, part, wall, level, across, along, flow)
            for part in np.array_split(points, len(points) // 256)
        ]
    )


def _void(places, brakes, points, wall, level, across, along, flow):
    u = points[None] - places[:, None]
    q = np.asarray(flow, float)
    form = np.eye(3) * (1 + (across - 1) * (q @ q)) - (across - along) * np.outer(q, q)
    rises = 2 * (u @ form) * brakes[:, None, None] ** 2
    squares = 0.5 * (rises * u).sum(2)
    own, everywhere = squares.argmin(0), np.arange(len(points))
    least = squares[own, everywhere]
    met = squares - least < 0.5 * wall * np.linalg.norm(rises - rises[own, everywhere], axis=2)
    met[own, everywhere] = False
    return (least <= level) & ~met.any(0)
