"""Principal curvatures of an interface, and the distribution of its shapes.

Curvatures are those of the levels of the smoothed phase (Goldman 2005,
doi:10.1016/j.cagd.2005.06.005, section 4), taken where neighbours along an axis are of different
phases. Lines along an axis cross an element of area dS with normal n on |n . axis| dS of the plane
across it; so a crossing of unit area stands for |n . axis| of interface, and those along all axes
add up to the area (Cauchy), without a preferred direction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.brief import brief
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.phases import check_sides, indicator
from trabecula.measure.smooth import gaussian

SHAPES = np.linspace(-1, 1, 17)
"""Centres of the bins of the shape index: the plain shapes are in the middle of one."""

_SIGMA = 1.5  # of the smoothing, in the largest voxel edge
_LEAST = 4  # voxels along every axis
_STEEP = 1e-6  # of the gradient: below it there is no normal


@dataclass(frozen=True)
class Curvatures:
    """Principal curvatures of an interface, place by place, in the order of the voxels.

    Positive where the phase bulges out: a ball of radius r has 1 / r twice, a cylinder 1 / r and 0,
    a hole of radius r in the phase -1 / r twice.
    """

    most: np.ndarray
    """(N,) float32: the larger curvature, 1 / length."""
    least: np.ndarray
    """(N,) float32: the smaller curvature, 1 / length."""
    area: np.ndarray
    """(N,) float32: the area that the place stands for, length^2."""

    __repr__ = brief

    @property
    def shape_index(self) -> np.ndarray:
        """Return the shape index of every place, (N,), -1 .. 1 (`shape_index`)."""
        most, least = self.most.astype(np.float64), self.least.astype(np.float64)
        return np.asarray(np.arctan2(most + least, most - least) * (2 / np.pi))

    @property
    def curvedness(self) -> np.ndarray:
        """Return how strongly every place is curved, (N,), 1 / length: the root mean square of
        its two curvatures.
        """
        most, least = self.most.astype(np.float64), self.least.astype(np.float64)
        return np.asarray(np.sqrt((most**2 + least**2) / 2))


def has_curvatures(shape: Sequence[int]) -> bool:
    """Return whether an image of this shape is a volume with room for curvatures."""
    return len(shape) == 3 and min(shape) >= _LEAST


def curvatures(image: Image | ArrayLike, *, phase: str | int | None = None) -> Curvatures:
    """Measure the principal curvatures of the interface of a phase.

    Their joint distribution, weighted with the area, is known as the interfacial shape
    distribution.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
        Any spacing; the interface is smoothed over one and a half voxels (of the largest edge), so
        what is curved more sharply than that is seen blunted. Places near a face are left out,
        where the smoothing knows no neighbours: within three voxels, of equal edges.
    phase : str or int, optional
        Default: "solid", which is every phase but "void".

    Returns
    -------
    curvatures : Curvatures
        Of no places where there is no interface.

    Raises
    ------
    InputError
        A 2-D image, a side below 4 voxels, or as `porosity`.

    Examples
    --------
    >>> z, y, x = np.mgrid[-20:21, -20:21, -20:21]
    >>> ball = curvatures((z**2 + y**2 + x**2 < 12.5**2).astype(np.uint8))
    >>> round(float(np.average(ball.most + ball.least, weights=ball.area)), 2)
    0.16
    """
    image, inside = indicator(image, phase)
    if image.ndim != 3:
        raise InputError("principal curvatures are of an interface in space: the image is 2-D")
    check_sides(image.shape, least=_LEAST, what="is too thin for curvatures")
    edges = np.array(image.spacing, np.float64)
    sigma = _SIGMA * edges.max() / edges
    smooth = gaussian(inside, sigma)
    margin = np.array(
        [
            max(1, min(math.ceil(2 * width), side // 4))
            for side, width in zip(image.shape, sigma, strict=True)
        ]
    )
    depth = image.shape[0] - 2 * int(margin[0])
    counts = np.zeros(depth + 1, np.int64)
    for_slabs(lambda a, b: _count_crossings(inside, margin, counts, a, b), depth)
    ends = np.cumsum(counts)
    found = np.empty((3, int(ends[-1])), np.float32)
    for_slabs(lambda a, b: _curve(smooth, inside, margin, edges, ends, found, a, b), depth)
    return Curvatures(*found)


def shape_index(image: Image | ArrayLike, *, phase: str | int | None = None) -> np.ndarray:
    """Return the distribution of the shape index over the interface of a phase.

    The shape index of a place is 2 / pi arctan((k1 + k2) / (k1 - k2)), with the principal
    curvatures k1 >= k2 (Koenderink and van Doorn 1992, doi:10.1016/0262-8856(92)90076-F): 1 for a
    ball, 1/2 for a cylinder, 0 for a symmetrical saddle, -1/2 for a cylindrical channel, -1 for a
    round pore. It knows no size. Where the interface is flat it says nothing, and what the voxels
    leave of curvature decides.

    Parameters
    ----------
    image, phase
        As for `curvatures`.

    Returns
    -------
    shares : (17,) float64
        Share of the interface's area in bins around -1, -7/8, .. 1; all 0 where there is no
        interface.

    Raises
    ------
    InputError
        As `curvatures`.

    Examples
    --------
    >>> y, x = np.mgrid[-20:21, -20:21]
    >>> rod = np.broadcast_to(y**2 + x**2 < 12.5**2, (41, 41, 41)).astype(np.uint8)
    >>> round(float(shape_index(rod)[12]), 2)  # around 1/2
    1.0
    """
    found = curvatures(image, phase=phase)
    area = found.area.astype(np.float64)
    half = (SHAPES[1] - SHAPES[0]) / 2
    ends = SHAPES[0] - half, SHAPES[-1] + half
    shares, _ = np.histogram(found.shape_index, len(SHAPES), ends, weights=area)
    return np.asarray(shares / area.sum() if area.any() else shares)


@kernel
def _count_crossings(inside, margin, counts, start, stop):
    """Write to counts[1 + plane] between how many neighbours of a plane, or of it and the next,
    there is an interface.
    """
    for k in range(start, stop):
        z, count = k + margin[0], 0
        for y in range(margin[1], inside.shape[1] - margin[1]):
            for x in range(margin[2], inside.shape[2] - margin[2]):
                for axis in range(3):
                    count += _crosses(inside, margin, z, y, x, axis)
        counts[k + 1] = count


@kernel
def _curve(smooth, inside, margin, edges, ends, found, start, stop):
    """Write the curvatures and areas of the interfaces that `_count_crossings` counted."""
    cell = edges[0] * edges[1] * edges[2]
    for k in range(start, stop):
        z, place = k + margin[0], ends[k]
        for y in range(margin[1], inside.shape[1] - margin[1]):
            for x in range(margin[2], inside.shape[2] - margin[2]):
                for axis in range(3):
                    if not _crosses(inside, margin, z, y, x, axis):
                        continue
                    one = derivatives(smooth, z, y, x, edges)
                    w, v, u = z + (axis == 0), y + (axis == 1), x + (axis == 2)
                    two = derivatives(smooth, w, v, u, edges)
                    most, least, normal = _principal(one, two, axis)
                    found[0, place], found[1, place] = most, least
                    found[2, place] = normal * cell / edges[axis]
                    place += 1


@inline
def _crosses(inside, margin, z, y, x, axis):
    """Return whether there is an interface between a voxel and the next along an axis."""
    w, v, u = z + (axis == 0), y + (axis == 1), x + (axis == 2)
    depth, height, width = inside.shape
    if w >= depth - margin[0] or v >= height - margin[1] or u >= width - margin[2]:
        return False
    return inside[w, v, u] != inside[z, y, x]


@inline
def _principal(one, two, axis):
    """Return both curvatures of the level between two voxels, from their derivatives, and the
    normal's part along an axis; 0 where there is no normal.
    """
    gz, gy, gx = one[0] + two[0], one[1] + two[1], one[2] + two[2]
    zz, yy, xx = one[3] + two[3], one[4] + two[4], one[5] + two[5]
    zy, zx, yx = one[6] + two[6], one[7] + two[7], one[8] + two[8]
    size = math.sqrt(gz * gz + gy * gy + gx * gx)
    if size < _STEEP:
        return 0.0, 0.0, 0.0
    gz, gy, gx = gz / size, gy / size, gx / size
    along = gz * gz * zz + gy * gy * yy + gx * gx * xx
    along += 2 * (gz * gy * zy + gz * gx * zx + gy * gx * yx)
    mean = (along - zz - yy - xx) / (2 * size)
    product = gz * gz * (yy * xx - yx * yx) + gy * gy * (zz * xx - zx * zx)
    product += gx * gx * (zz * yy - zy * zy)
    product += 2 * gz * gy * (zx * yx - zy * xx)
    product += 2 * gz * gx * (zy * yx - zx * yy)
    product += 2 * gy * gx * (zy * zx - yx * zz)
    apart = math.sqrt(max(mean * mean - product / (size * size), 0.0))
    normal = gz if axis == 0 else gy if axis == 1 else gx
    return mean + apart, mean - apart, abs(normal)


@inline
def derivatives(f, z, y, x, edges):
    """Return the gradient (z, y, x) and second derivatives (zz, yy, xx, zy, zx, yx) of a field at a
    voxel within, by central differences.
    """
    middle = np.float64(f[z, y, x])
    gz = (f[z + 1, y, x] - f[z - 1, y, x]) / (2 * edges[0])
    gy = (f[z, y + 1, x] - f[z, y - 1, x]) / (2 * edges[1])
    gx = (f[z, y, x + 1] - f[z, y, x - 1]) / (2 * edges[2])
    zz = (f[z + 1, y, x] + f[z - 1, y, x] - 2 * middle) / edges[0] ** 2
    yy = (f[z, y + 1, x] + f[z, y - 1, x] - 2 * middle) / edges[1] ** 2
    xx = (f[z, y, x + 1] + f[z, y, x - 1] - 2 * middle) / edges[2] ** 2
    zy = f[z + 1, y + 1, x] - f[z + 1, y - 1, x] - f[z - 1, y + 1, x] + f[z - 1, y - 1, x]
    zx = f[z + 1, y, x + 1] - f[z + 1, y, x - 1] - f[z - 1, y, x + 1] + f[z - 1, y, x - 1]
    yx = f[z, y + 1, x + 1] - f[z, y + 1, x - 1] - f[z, y - 1, x + 1] + f[z, y - 1, x - 1]
    return (
        gz,
        gy,
        gx,
        zz,
        yy,
        xx,
        zy / (4 * edges[0] * edges[1]),
        zx / (4 * edges[0] * edges[2]),
        yx / (4 * edges[1] * edges[2]),
    )
