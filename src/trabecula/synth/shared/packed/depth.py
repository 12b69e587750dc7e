"""How deep voxels lie in bodies: edges rounded, and the deepest of them chosen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from trabecula.engine.parallel import for_slabs
from trabecula.measure.smooth import gaussian, reach_of

REACH = 4.5
"""Edges beyond a body's surface as far as its distance is drawn."""

_MARKS = 1025  # shares whose depth is known, from 0 to 1


class Copies(NamedTuple):
    """Bodies of a box that repeats which meet a field of voxels; m copies, of the first body first.

    Attributes
    ----------
    owners : (m,) int64
        The bodies.
    shifts : (m, 3) float64
        From a body to its copy, edges.
    starts, stops : (m, 3) int64
        Voxels of the field within reach of it.
    """

    owners: np.ndarray
    shifts: np.ndarray
    starts: np.ndarray
    stops: np.ndarray


def depth_field(
    draw: Callable[[Copies, np.ndarray, np.ndarray, int, int], object],
    places: np.ndarray,
    reach: np.ndarray,
    sides: np.ndarray,
    shape: Sequence[int],
    steps: np.ndarray,
    fillet: float,
) -> np.ndarray:
    """Return how deep voxels lie in the nearest body, edges, negative outside.

    Parameters
    ----------
    draw : callable
        Of the copies of bodies that meet a field of `-REACH`, the field, the voxels (3,) of it
        before the first of the shape, and planes start and stop: raises these planes to the depth
        in bodies.
    places : (n, 3) float64
        Middles of bodies, edges.
    reach : (n,) float64
        From there, as far as a body is drawn.
    sides : (3,) float64
        Of the box that repeats, edges.
    shape : three ints
        Voxels from the first corner of the box on.
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
    copies = _copies(places, reach[:, None], sides, steps, margin, np.array(field.shape))
    for_slabs(lambda a, b: draw(copies, field, margin, a, b), len(field))
    if fillet:
        np.clip(field, -REACH, REACH, out=field)
        field = gaussian(field, sigma)
    inner = tuple(slice(m, m + side) for m, side in zip(margin, shape, strict=True))
    return field[inner]


def _copies(
    places: np.ndarray,
    reach: np.ndarray,
    sides: np.ndarray,
    steps: np.ndarray,
    margin: np.ndarray,
    size: np.ndarray,
) -> Copies:
    """Return the copies of bodies that meet a field of this size, whose voxel `margin` is the box's
    first.
    """
    low, high = -margin * steps - places - reach, (size - margin) * steps - places + reach
    first, last = np.ceil(low / sides).astype(np.int64), np.floor(high / sides).astype(np.int64)
    counts = np.maximum(last - first + 1, 0)
    each = counts.prod(axis=1)
    owners = np.repeat(np.arange(len(places)), each)
    number = np.arange(len(owners)) - np.repeat(np.cumsum(each) - each, each)
    own = counts[owners]
    number, x = np.divmod(number, own[:, 2])
    z, y = np.divmod(number, own[:, 1])
    shifts = (first[owners] + np.stack([z, y, x], axis=1)) * sides
    at = places[owners] + shifts
    starts = np.floor((at - reach[owners]) / steps).astype(np.int64) + margin
    stops = np.ceil((at + reach[owners]) / steps).astype(np.int64) + margin + 1
    return Copies(owners, shifts, np.maximum(starts, 0), np.minimum(stops, size))


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
