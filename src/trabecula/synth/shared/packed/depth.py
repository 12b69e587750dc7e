"""How deep voxels lie in bodies: edges rounded, and the deepest of them chosen."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from trabecula.engine.parallel import for_slabs
from trabecula.measure.smooth import gaussian, reach_of

REACH = 4.5
"""Edges beyond a body's surface as far as its distance is drawn."""

_MARKS = 1025  # shares whose depth is known, from 0 to 1


def depth_field(
    draw: Callable[[np.ndarray, np.ndarray, int, int], object],
    shape: Sequence[int],
    steps: np.ndarray,
    fillet: float,
) -> np.ndarray:
    """Return how deep voxels lie in the nearest body, edges, negative outside.

    Parameters
    ----------
    draw : callable
        Of a field of `-REACH`, the voxels (3,) of it before the first of the shape, and planes
        start and stop: raises these planes to the depth in bodies.
    shape : three ints
    steps : (3,) float64
        Edges of a voxel in units of the smallest.
    fillet : float
        Standard deviation of the Gaussian that rounds it, edges.

    Returns
    -------
    depth : float32 array, (Z, Y, X)
    """
    sigma = fillet / steps
    margin = np.array([reach_of(float(width)) for width in sigma])
    field = np.full(tuple(np.asarray(shape) + 2 * margin), -REACH, np.float32)
    for_slabs(lambda a, b: draw(field, margin, a, b), len(field))
    if fillet:
        np.clip(field, -REACH, REACH, out=field)
        field = gaussian(field, sigma)
    inner = tuple(slice(m, m + side) for m, side in zip(margin, shape, strict=True))
    return field[inner]


def deepest_share(depth: np.ndarray, share: float, inside: np.ndarray | None = None) -> np.ndarray:
    """Return the voxels that lie deepest, (Z, Y, X) bool: this share of all, or of those `inside`;
    of equally deep ones the first.
    """
    values = depth.ravel() if inside is None else depth[inside]
    count = round(share * values.size)
    if not 0 < count < values.size:
        chosen = np.full(values.size, count > 0)
    else:
        least = np.partition(values, values.size - count)[values.size - count]
        chosen = values > least
        level = np.flatnonzero(values == least)
        chosen[level[: count - int(np.count_nonzero(chosen))]] = True
    if inside is None:
        return chosen.reshape(depth.shape)
    found = np.zeros(depth.shape, bool)
    found[inside] = chosen
    return found


def deepest_by_share(
    depth: np.ndarray, shares: np.ndarray, inside: np.ndarray | None = None
) -> np.ndarray:
    """Return the voxels that lie deeper than all but a share of them (or of those `inside`), which
    is given for every voxel: (Z, Y, X) bool. Bodies grow where it is large.
    """
    values = depth.ravel() if inside is None else depth[inside]
    marks = np.linspace(0, 1, _MARKS)
    levels = np.quantile(values, 1 - marks)
    found = depth > np.interp(shares, marks, levels)
    return found if inside is None else found & inside
