"""How thick: largest inscribed spheres, and chords.

Local thickness (Hildebrand and Ruegsegger 1997, doi:10.1046/j.1365-2818.1997.1340694.x): at a point, the diameter of
the largest sphere that lies in the phase and holds the point. Three steps:

1. the distance of every voxel of the phase to the rest;
2. the ridge: voxels whose sphere does not lie inside a neighbour's;
3. the ridge's spheres are painted from the largest down. A voxel once painted keeps its value, and every row
   remembers its next voxel that is still bare, so a sphere costs its rows and not its voxels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.compile import inline, kernel
from trabecula.engine.tiles import for_slabs
from trabecula.measure.distance import distance_transform
from trabecula.measure.phases import indicator


def local_thickness(image: Image | ArrayLike, *, phase: str | int | None = None) -> np.ndarray:
    """Diameter of the largest sphere in the phase that holds the voxel.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".

    Returns
    -------
    diameter : float32 array, the image's shape
        In the image's unit; 0 outside the phase. The faces of the image bound nothing, so what they cut may look
        thicker.

    Raises
    ------
    InputError
        The phase fills the whole image, so that nothing bounds it.

    Notes
    -----
    Centres of spheres are voxels and the distance ends at a voxel's centre, so 2 d overshoots a plate of an odd
    number of voxels by 1 and meets one of an even number; 2 d less half a voxel is off by half a voxel in either
    case, and right on average.
    """
    image, inside = indicator(image, phase)
    if inside.all():
        raise InputError("the phase fills the whole image: its thickness has no bound; choose another phase")
    lifted = inside.reshape((1,) * (3 - image.ndim) + image.shape)
    spacing = np.array((1.0,) * (3 - image.ndim) + image.spacing)
    radius = distance_transform(inside, spacing=image.spacing).reshape(lifted.shape)
    ridge = np.zeros(lifted.shape, bool)
    need = _containment(float(radius.max()), spacing)
    smallest = float(spacing.min()) ** 2
    for_slabs(lambda a, b: _find_ridge(radius, need, smallest, ridge, a, b), len(ridge))
    centres = np.flatnonzero(ridge)
    centres = centres[np.argsort(-radius.ravel()[centres], kind="stable")]
    diameter = _paint_spheres(radius, spacing, centres)
    diameter[lifted] -= np.float32(min(image.spacing) / 2)
    return diameter.reshape(image.shape)


def thickness(image: Image | ArrayLike, *, phase: str | int | None = None) -> float:
    """Mean local thickness over the voxels of a phase (default "solid"), in the image's unit; 0 where the phase is
    empty.

    See `local_thickness` for the definition (Hildebrand and Ruegsegger 1997) and its error of half a voxel.
    """
    return _mean_thickness(image, phase, "solid")


def pore_size(image: Image | ArrayLike, *, phase: str | int | None = None) -> float:
    """Mean local thickness over the voxels of the void (or of the phase given), in the image's unit."""
    return _mean_thickness(image, phase, "void")


def chord_length(image: Image | ArrayLike, *, phase: str | int | None = None, axis: int | None = None) -> float:
    """Mean length of the chords that a line cuts out of a phase, in the image's unit.

    Torquato 2002 (doi:10.1007/978-1-4757-6355-3), section 2.2.4: fraction of the phase over half the crossings of
    its interface per length. No chord is measured, so those that the faces cut bias nothing.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    axis : int, optional
        Lines along this axis. Default: the mean crossings over all axes.

    Returns
    -------
    length : float
        Infinite where no line crosses the interface; 0 where the phase is empty.
    """
    image, inside = indicator(image, phase)
    if axis is not None and not -image.ndim <= axis < image.ndim:
        raise InputError(f"axis {axis} does not exist: the image has {image.ndim}")
    axes = range(image.ndim) if axis is None else (axis % image.ndim,)
    rates = []
    for along in axes:
        lines = np.moveaxis(inside, along, 0)
        if len(lines) > 1:
            rates.append(np.count_nonzero(lines[1:] != lines[:-1]) / lines[1:].size / image.spacing[along])
    fraction = int(np.count_nonzero(inside)) / inside.size
    crossings = float(np.mean(rates)) if rates else 0.0
    if fraction == 0:
        return 0.0
    return 2 * fraction / crossings if crossings else float("inf")


def _mean_thickness(image: Image | ArrayLike, phase: str | int | None, default: str) -> float:
    image, inside = indicator(image, phase, default=default)
    if not inside.any():
        return 0.0
    alone = Image(inside, "labels", spacing=image.spacing, unit=image.unit)
    return float(local_thickness(alone, phase=1)[inside].mean(dtype=np.float64))


def _containment(largest: float, spacing: np.ndarray) -> np.ndarray:
    """Squared radius that a neighbour's sphere must exceed to hold every voxel of a sphere, by offset and squared
    radius.

    Dougherty and Kunzelmann 2007 (doi:10.1017/S1431927607074430): spheres are compared as sets of voxels, since
    hardly any pair of them holds as spheres of the plane do. Entry [4 dz + 2 dy + dx, n] is for all voxels nearer
    than sqrt(n) smallest edges.
    """
    smallest = spacing.min() ** 2
    steps = int(np.ceil(largest**2 / smallest)) + 1
    z, y, x = (np.arange(int(np.sqrt(steps * smallest) / edge) + 2.0) for edge in spacing)
    norm = ((z * spacing[0]) ** 2)[:, None, None] + ((y * spacing[1]) ** 2)[:, None] + (x * spacing[2]) ** 2
    # The ball of step n holds the voxels of norm < n; norm n itself first counts at step n + 1.
    step = np.floor(norm / smallest * (1 + 1e-9)).astype(np.int64) + 1
    inside = step <= steps
    need = np.zeros((8, steps + 1), np.float32)
    for offset in range(1, 8):
        dz, dy, dx = offset >> 2, offset >> 1 & 1, offset & 1
        far = (
            (((z + dz) * spacing[0]) ** 2)[:, None, None]
            + (((y + dy) * spacing[1]) ** 2)[:, None]
            + ((x + dx) * spacing[2]) ** 2
        )
        np.maximum.at(need[offset], step[inside], far[inside].astype(np.float32))
        np.maximum.accumulate(need[offset], out=need[offset])
    return need


@kernel
def _find_ridge(radius, need, smallest, ridge, start, stop):
    """True where no neighbour with a larger radius holds every voxel of this sphere."""
    depth, height, width = radius.shape
    for z in range(start, stop):
        for y in range(height):
            for x in range(width):
                own = radius[z, y, x]
                keep = own > 0
                n = int(np.ceil(own * own / smallest - 1e-3))
                for k in range(max(z - 1, 0), min(z + 2, depth)):
                    for j in range(max(y - 1, 0), min(y + 2, height)):
                        for i in range(max(x - 1, 0), min(x + 2, width)):
                            other = radius[k, j, i]
                            if keep and other > own:
                                offset = 4 * abs(k - z) + 2 * abs(j - y) + abs(i - x)
                                keep = other * other < need[offset, n] * np.float32(1.000001)
                ridge[z, y, x] = keep


@inline
def _next_bare(bare, x):
    """The first voxel from x on that nothing has painted (the width of the row, if none is)."""
    at = x
    while bare[at] != at:
        at = bare[at]
    while bare[x] != at and x != at:
        bare[x], x = at, bare[x]
    return at


@kernel
def _paint_spheres(radius, spacing, centres):
    depth, height, width = radius.shape
    diameter = np.zeros(radius.shape, np.float32)
    bare = np.empty((depth, height, width + 1), np.int32)
    for x in range(width + 1):
        bare[:, :, x] = x
    for centre in centres:
        z0, y0, x0 = centre // (height * width), centre // width % height, centre % width
        own = radius[z0, y0, x0]
        # Voxels nearer than the radius, the nearest outside voxel (at exactly the radius) left out.
        limit = np.float64(own) * np.float64(own) * (1.0 - 1e-6)
        reach = int(own / spacing[0])
        for z in range(max(0, z0 - reach), min(depth, z0 + reach + 1)):
            rest = limit - ((z - z0) * spacing[0]) ** 2
            if rest <= 0.0:
                continue
            wide = int(np.sqrt(rest) / spacing[1])
            for y in range(max(0, y0 - wide), min(height, y0 + wide + 1)):
                left = rest - ((y - y0) * spacing[1]) ** 2
                if left <= 0.0:
                    continue
                half = int(np.sqrt(left) / spacing[2])
                row = bare[z, y]
                x = _next_bare(row, max(0, x0 - half))
                while x <= x0 + half and x < width:
                    diameter[z, y, x] = 2.0 * own
                    row[x] = x + 1
                    x = _next_bare(row, x + 1)
    return diameter
