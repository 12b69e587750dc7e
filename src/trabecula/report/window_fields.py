"""Local fraction, surface and direction of windows that fill an image side by side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
"""Axes of the six sums of products that make up a window's tensor."""


def window_box(shape: Sequence[int], edges: Sequence[int]) -> tuple[slice, ...]:
    """Return the part of an image that whole windows cover, in its middle."""
    found = []
    for side, edge in zip(shape, edges, strict=True):
        count = side // edge
        start = (side - count * edge) // 2
        found.append(slice(start, start + count * edge))
    return tuple(found)


def mean_of_windows(field: np.ndarray, edges: Sequence[int]) -> np.ndarray:
    """Return the means of the windows that fit, centred in the image."""
    part = field[window_box(field.shape, edges)]
    counts = [side // edge for side, edge in zip(part.shape, edges, strict=True)]
    split = part.reshape([size for pair in zip(counts, edges, strict=True) for size in pair])
    return np.asarray(split.mean(axis=tuple(range(1, 2 * field.ndim, 2)), dtype=np.float64))


def surface_of_windows(inside: np.ndarray, edges: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Measure the surface of a phase in windows, and where it faces.

    Every cube of 2 x 2 x 2 voxels has a gradient, differences of the means of opposite faces. Its
    length adds to the surface, its products to the window's tensor, as in a structure tensor
    (Bigun and Granlund 1987).

    Parameters
    ----------
    inside : (Z, Y, X) or (Y, X) bool
    edges : sequence of int
        Of a window, voxels.

    Returns
    -------
    surface : (windows along z, y, x) float64
        Area per voxel, in faces of a voxel. Two axes of a picture.
    tensor : (windows along z, y, x, ndim, ndim) float64
        Share of the surface that faces each way, of trace 1; isotropic where there is none.
    """
    ndim = inside.ndim
    part = inside[window_box(inside.shape, edges)]
    sides = tuple(edges)
    if ndim == 2:  # equal slices: no gradient across them
        part, sides = np.stack([part, part]), (2, *sides)
    counts = [side // edge for side, edge in zip(part.shape, sides, strict=True)]
    sums = np.zeros((*counts, 7))
    deep = np.ascontiguousarray(part).view(np.uint8)
    for_slabs(
        lambda start, stop: _add_cubes(deep, np.array(sides), sums, start, stop), counts[0], least=1
    )
    area = sums[..., 6]
    products = np.empty((*counts, 3, 3))
    for n, (a, b) in enumerate(PAIRS):
        products[..., a, b] = products[..., b, a] = sums[..., n]
    trace = sums[..., :3].sum(axis=-1)
    if ndim == 2:
        products, trace, area = products[0][..., 1:, 1:], trace[0], area[0]
    held = trace > 0
    tensor = np.where(
        held[..., None, None],
        products / np.where(held, trace, 1)[..., None, None],
        np.eye(ndim) / ndim,
    )
    cubes = np.ones(())
    for count, edge in zip(area.shape, edges, strict=True):
        along = np.full(count, float(edge))
        along[-1] -= 1  # no cube begins at the last voxel
        cubes = np.multiply.outer(cubes, along)
    return area / cubes, tensor


@kernel
def _add_cubes(inside, edges, sums, start, stop):
    """Add the gradients of the cubes whose first voxel lies in the windows start..stop along z.

    sums: (windows, 7), products in the order of `PAIRS` and lengths; gradients in quarters.
    """
    depth, height, length = inside.shape
    for z in range(start * edges[0], min(stop * edges[0], depth - 1)):
        for y in range(height - 1):
            window = sums[z // edges[0], y // edges[1]]
            a, b = np.int64(inside[z, y, 0]), np.int64(inside[z, y + 1, 0])
            c, d = np.int64(inside[z + 1, y, 0]), np.int64(inside[z + 1, y + 1, 0])
            for x in range(length - 1):
                e, f = np.int64(inside[z, y, x + 1]), np.int64(inside[z, y + 1, x + 1])
                g, h = np.int64(inside[z + 1, y, x + 1]), np.int64(inside[z + 1, y + 1, x + 1])
                total = a + b + c + d + e + f + g + h
                if 0 < total < 8:
                    gz = c + d + g + h - a - b - e - f
                    gy = b + d + f + h - a - c - e - g
                    gx = e + f + g + h - a - b - c - d
                    here = window[x // edges[2]]
                    here[0] += gz * gz
                    here[1] += gy * gy
                    here[2] += gx * gx
                    here[3] += gz * gy
                    here[4] += gz * gx
                    here[5] += gy * gx
                    here[6] += np.sqrt(float(gz * gz + gy * gy + gx * gx)) / 4
                a, b, c, d = e, f, g, h
