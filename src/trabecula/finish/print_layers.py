"""What happens layer by layer, from z = 0 upwards: parts that start in the air, ceilings, resin
that is sealed off.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.measure.distance import distance_transform
from trabecula.measure.labelling import label_components
from trabecula.measure.smooth import gaussian
from trabecula.measure.union_find import root_of

_SOFT = 1.5
"""Voxels over which the direction of a surface is averaged: the faces of voxels know six directions
only.
"""

_STEEPEST = 0.1
"""Least cosine between a surface's normal and the vertical that is told from a staircase's wall."""


def islands(solid: np.ndarray) -> tuple[int, np.ndarray]:
    """Parts of a layer that lie on nothing of the layer below: their number, and where they are
    (bool, like `solid`).

    The first layer lies on the plate.
    """
    count = 0
    alone = np.zeros(solid.shape, bool)
    for z in range(1, len(solid)):
        labels, sizes = label_components(solid[z], connectivity=8)
        hangs = np.ones(len(sizes) + 1, bool)
        hangs[labels[solid[z - 1]]] = False
        hangs[0] = False
        count += int(np.count_nonzero(hangs))
        alone[z] = hangs[labels]
    return count, alone


def overhang(solid: np.ndarray, spacing: tuple[float, ...], angle: float) -> tuple[float, float]:
    """Area of the surface that faces down, and of that part of it that leans by more than `angle`
    degrees from the vertical; in the unit of `spacing` squared. What lies on the plate is left out.

    Every face of a voxel that looks down stands for the piece of surface above it: its area over
    the cosine between the vertical and the normal, which is the gradient of the smoothed volume.
    """
    down = solid[1:] & ~solid[:-1]
    if not down.any():
        return 0.0, 0.0
    # Beyond the faces the part goes on, so that where it ends there its surface does not seem to
    # bend.
    level = gaussian(solid, _SOFT)
    slopes = [
        np.gradient(level, edge, axis=axis) if solid.shape[axis] > 1 else np.zeros_like(level)
        for axis, edge in enumerate(spacing)
    ]
    # In the plane between the voxel and the one below it.
    here = [((slope[1:] + slope[:-1]) / 2)[down] for slope in slopes]
    cosine = here[0] / np.maximum(np.sqrt(here[0] ** 2 + here[1] ** 2 + here[2] ** 2), 1e-12)
    area = spacing[1] * spacing[2] / np.maximum(cosine, _STEEPEST)
    leans = cosine > np.sin(np.deg2rad(angle)) - 1e-6
    return float(area.sum(dtype=np.float64)), float(area[leans].sum(dtype=np.float64))


def reach(solid: np.ndarray, spacing: tuple[float, ...]) -> float:
    """How far, at most, a voxel with nothing below lies from one of its layer with something below,
    in the unit of `spacing`. Islands do not count: no bridge carries them."""
    held = solid[1:] & solid[:-1]
    free = solid[1:] & ~solid[:-1] & ~islands(solid)[1][1:]
    if not free.any():
        return 0.0
    # Layers so far apart that the nearest voxel is always one of the own layer.
    extent = max(side * edge for side, edge in zip(solid.shape, spacing, strict=True))
    away = distance_transform(~held, spacing=(extent * 4, *spacing[1:]))
    return float(away[free].max())


def sealed(solid: np.ndarray) -> int:
    """Most voxels of void that any one pocket holds which, at some time of the print, only the
    layer in hand leaves open.

    Such a pocket is a cup: it opens towards the side from which the next layer comes, and to
    nowhere else. Below the first layer it is open, as between supports.
    """
    void = np.pad(~solid, ((1, 0), (1, 1), (1, 1)), constant_values=True)
    return int(_largest_cup(np.ascontiguousarray(void)))


@kernel
def _largest_cup(void):
    """Union-find over the void, layer by layer; node 0 is the outside, which the margin of every
    layer belongs to.
    """
    depth, height, width = void.shape
    layer = height * width
    parent = np.zeros(depth * layer + 1, np.int32)
    size = np.zeros(depth * layer + 1, np.int32)
    largest = 0
    for z in range(depth):
        for y in range(height):
            for x in range(width):
                if not void[z, y, x]:
                    continue
                k = 1 + z * layer + y * width + x
                margin = y == 0 or x == 0 or y == height - 1 or x == width - 1
                parent[k] = 0 if margin else k
                size[k] = 1
                for step in range(3):
                    if step == 0:
                        other = k - 1 if x > 0 and void[z, y, x - 1] else -1
                    elif step == 1:
                        other = k - width if y > 0 and void[z, y - 1, x] else -1
                    else:
                        other = k - layer if z > 0 and void[z - 1, y, x] else -1
                    if other >= 0:
                        a, b = root_of(parent, k), root_of(parent, other)
                        if a != b:
                            low, high = min(a, b), max(a, b)
                            parent[high] = low
                            size[low] += size[high]
        # Pockets that are still sealed off when this layer is done and that reach down into earlier
        # ones.
        for y in range(1, height - 1):
            for x in range(1, width - 1):
                if z > 0 and void[z, y, x] and void[z - 1, y, x]:
                    root = root_of(parent, 1 + z * layer + y * width + x)
                    if root != 0 and size[root] > largest:
                        largest = size[root]
    return largest
