"""Plates and rods of a solid, by the inertia of what surrounds its mid-axis.

Local inertial anisotropy (Vasilic, Rajapakse and Wehrli 2009, doi:10.1118/1.3140582): around every
voxel of the mid-axis the solid in a ball, twice as large as the largest one inside, has the moments
of a rod (one long axis) or of a plate (two). Here the axes a <= b <= c of its inertia give the
ellipsoid factor a / b - b / c (Doube 2015, doi:10.3389/fendo.2015.00015), whose own ellipsoids are
the largest inside. What is not on the mid-axis belongs to the voxel of it that is nearest inside
the solid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.brief import brief
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.morphometry import mid_axis
from trabecula.measure.partition.partition import grow
from trabecula.measure.phases import as_periodic, indicator_in_mask

_TIMES, _LEAST, _MOST = 2.0, 3.0, 16.0
"""Radius of the ball over that of the largest sphere inside; bounds in smallest edges."""


@dataclass(frozen=True)
class PlatesAndRods:
    """Shapes of the parts of a solid."""

    plates: float
    """Share of the solid's voxels in plates, 0..1: where the factor is negative. Where no ball is
    cut by a face of the image, if there is such a place; the figures below likewise."""
    rods: float
    """The rest."""
    factor: float
    """Mean of a / b - b / c over the solid: -1 for wide plates, 1 for long rods."""
    spread: float
    """Standard deviation of it."""
    factor_map: np.ndarray
    """float32 array, the image's shape: the factor of every voxel of the solid; 0 elsewhere."""

    __repr__ = brief


def plates_and_rods(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> PlatesAndRods:
    """Sort a solid into plates and rods.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    mask : bool array, the image's shape, optional
        The region of interest.
    periodic : bool or one per axis
        Distances wrap around the faces; balls are cut there all the same.

    Returns
    -------
    found : PlatesAndRods

    Raises
    ------
    InputError
        A 2-D image; a phase that is empty or fills the image (or mask).

    Notes
    -----
    Joints of rods are neither, and count as what surrounds them looks like. Solids that two widths
    do not separate look like one.

    Examples
    --------
    >>> y, x = np.ogrid[:20, :20]
    >>> rod = np.repeat(((y - 10) ** 2 + (x - 10) ** 2 < 9)[None], 40, axis=0)
    >>> plates_and_rods(rod.astype(np.uint8)).rods
    1.0
    """
    image, inside, region = indicator_in_mask(image, phase, mask)
    if image.ndim != 3:
        raise InputError("plates and rods are of a volume: the image is 2-D")
    free = inside if region is None else inside | ~region
    if not inside.any() or free.all():
        raise InputError(
            "the phase is empty, or fills the whole image: it has no mid-axis; choose another one"
        )
    wraps = as_periodic(periodic, 3)
    scale = min(image.spacing)
    steps = tuple(edge / scale for edge in image.spacing)
    axis, distance = mid_axis(inside, region, steps, wraps)
    seeds = np.flatnonzero(axis)
    reach = np.clip(_TIMES * distance.ravel()[seeds], _LEAST, _MOST).astype(np.float64)
    offsets, square = _ball(float(reach.max()), np.array(steps))
    counts = np.searchsorted(square, reach**2 * (1 + 1e-9), side="right")
    sums = np.zeros((len(seeds), 10))
    edges, solid = np.array(steps), np.ascontiguousarray(inside)
    for_slabs(lambda a, b: _moments(solid, seeds, offsets, counts, edges, sums, a, b), len(seeds))
    factors = _factors(sums, edges)
    at = np.stack(np.unravel_index(seeds, inside.shape), axis=1)
    labels = grow(inside, at, wraps)
    own = np.concatenate([[0.0], factors])[labels]
    # a ball that a face cuts makes plates look like rods: these do not count where others do
    room = np.minimum(at, np.array(inside.shape) - 1 - at) * edges
    whole = np.concatenate([[False], (room >= reach[:, None]).all(axis=1)])[labels]
    values = own[whole] if whole.any() else own[inside]
    plates = float(np.count_nonzero(values < 0) / len(values))
    return PlatesAndRods(
        plates, 1 - plates, float(values.mean()), float(values.std()), own.astype(np.float32)
    )


def _ball(radius: float, steps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the offsets of a ball, nearest first, (K, 3), and their squared lengths."""
    sides = [np.arange(-int(radius / step), int(radius / step) + 1) for step in steps]
    offsets = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    square = ((offsets * steps) ** 2).sum(axis=1)
    order = np.argsort(square, kind="stable")
    return np.ascontiguousarray(offsets[order]), square[order]


def _factors(sums: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return a / b - b / c from 1, z, y, x and their six products, summed over solids."""
    count = sums[:, 0]
    mean = sums[:, 1:4] / count[:, None]
    square = np.empty((len(sums), 3, 3))
    for k, (a, b) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
        moment = sums[:, 4 + k] / count - mean[:, a] * mean[:, b]
        square[:, a, b] = square[:, b, a] = moment + (edges[a] ** 2 / 12 if a == b else 0.0)
    short, middle, long_ = np.sqrt(np.linalg.eigvalsh(square)).T
    return np.asarray(short / middle - middle / long_)


@kernel
def _moments(inside, seeds, offsets, counts, edges, sums, start, stop):
    """Sum 1, z, y, x, and the six products over the solid in the ball around every seed."""
    depth, height, width = inside.shape
    for s in range(start, stop):
        voxel = seeds[s]
        z0 = voxel // (height * width)
        y0 = voxel // width % height
        x0 = voxel % width
        own = sums[s]
        for k in range(counts[s]):
            z, y, x = z0 + offsets[k, 0], y0 + offsets[k, 1], x0 + offsets[k, 2]
            if z < 0 or z >= depth or y < 0 or y >= height or x < 0 or x >= width:
                continue
            if inside[z, y, x]:
                dz = offsets[k, 0] * edges[0]
                dy = offsets[k, 1] * edges[1]
                dx = offsets[k, 2] * edges[2]
                own[0] += 1.0
                own[1] += dz
                own[2] += dy
                own[3] += dx
                own[4] += dz * dz
                own[5] += dy * dy
                own[6] += dx * dx
                own[7] += dz * dy
                own[8] += dz * dx
                own[9] += dy * dx
