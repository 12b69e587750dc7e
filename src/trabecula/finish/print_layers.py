"""Checks of a print layer by layer, from z = 0 upwards: cups, islands, overhangs and bridges.

Each check returns a `Finding`; the figures behind it are functions of a solid (Z, Y, X), bool, in
which z is the direction of the layers.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.finish.printers import Finding, Part, Printer
from trabecula.measure.distance import distance_transform
from trabecula.measure.labelling import label_components
from trabecula.measure.smooth import gaussian
from trabecula.measure.union_find import root_of

_LEANING = 0.05
"""Share of the surface that faces down above which supports are worth a warning."""

_SOFT = 1.5
"""Voxels over which the direction of a surface is averaged, since the faces of voxels have six
directions only.
"""

_STEEPEST = 0.1
"""Least cosine between a surface's normal and the vertical: below it, a wall of voxels."""


def check_cups(part: Part, limit: float) -> Finding:
    """Check that no more resin than `limit`, mm**3, is sealed off during the print."""
    volume = largest_cup(part.solid) * part.voxel
    figures = {"volume": float(volume), "cup": limit}
    if volume <= limit:
        return Finding("cups", "pass", figures, f"the largest cup holds {volume:.3g} mm3")
    says = (
        f"a cup of {volume:.3g} mm3 seals resin off while it is printed: turn the part, or give "
        "the cup a drain"
    )
    return Finding("cups", "warn", figures, says)


def check_islands(part: Part, printer: Printer) -> Finding:
    """Check that nothing starts in the air."""
    count, places = find_islands(part.solid)
    figures = {"islands": count, "volume": float(np.count_nonzero(places) * part.voxel)}
    if not count:
        return Finding("islands", "pass", figures, "every layer lies on the one before")
    says = (
        f"{count} places start in the air: print with supports (soluble ones inside of pores), or "
        "turn the part"
    )
    return Finding("islands", "refuse" if printer.process == "fdm" else "warn", figures, says)


def check_overhangs(part: Part, angle: float) -> Finding:
    """Check that little of the surface leans more than `angle` degrees from the vertical."""
    down, leaning = overhang_area(part.solid, part.spacing, angle)
    share = leaning / down if down else 0.0
    figures = {"share": round(share, 6), "area": leaning, "overhang": angle}
    says = f"{share:.1%} of the surface facing down leans more than {angle:g} degrees"
    if share <= _LEANING:
        return Finding("overhangs", "pass", figures, says)
    return Finding("overhangs", "warn", figures, f"{says}: it needs supports, or sags")


def check_bridges(part: Part, limit: float) -> Finding:
    """Check that no bridge spans more than `limit`.

    A bridge is held at both ends, so its middle is half of the span away from its supports.
    """
    span = 2 * longest_reach(part.solid, part.spacing)
    figures = {"span": float(span), "bridge": limit}
    if span <= limit:
        return Finding("bridges", "pass", figures, f"the longest span is {span:.3g} mm")
    says = f"a span of {span:.3g} mm is longer than {limit:g}: it needs supports"
    return Finding("bridges", "warn", figures, says)


def find_islands(solid: np.ndarray) -> tuple[int, np.ndarray]:
    """Find the components of a layer that rest on nothing of the layer below.

    Returns their number and their voxels (bool, of the shape of `solid`). The first layer rests on
    the plate.
    """
    count = 0
    alone = np.zeros(solid.shape, bool)
    for z in range(1, len(solid)):
        labels, sizes = label_components(solid[z], connectivity=8)
        unsupported = np.ones(len(sizes) + 1, bool)
        unsupported[labels[solid[z - 1]]] = False
        unsupported[0] = False
        count += int(np.count_nonzero(unsupported))
        alone[z] = unsupported[labels]
    return count, alone


def overhang_area(
    solid: np.ndarray, spacing: tuple[float, ...], angle: float
) -> tuple[float, float]:
    """Return the area of the surface that faces down, and of its share beyond `angle`.

    The angle is in degrees from the vertical, areas are in the unit of `spacing` squared; the
    bottom on the plate is left out. Every downward face of a voxel represents the surface patch
    above it: its area over the cosine between the vertical and the normal, which is the gradient of
    the smoothed volume.
    """
    down = solid[1:] & ~solid[:-1]
    if not down.any():
        return 0.0, 0.0
    # The Gaussian continues the part beyond the faces of the image, so that its surface does not
    # seem to bend where they cut it.
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


def longest_reach(solid: np.ndarray, spacing: tuple[float, ...]) -> float:
    """Return the largest distance of an unsupported voxel to a supported one of its layer.

    In the unit of `spacing`; a voxel is supported by the one below it. Islands do not count: no
    bridge carries them.
    """
    held = solid[1:] & solid[:-1]
    free = solid[1:] & ~solid[:-1] & ~find_islands(solid)[1][1:]
    if not free.any():
        return 0.0
    # Layers so far apart that the nearest voxel is always one of the same layer.
    extent = max(side * edge for side, edge in zip(solid.shape, spacing, strict=True))
    away = distance_transform(~held, spacing=(extent * 4, *spacing[1:]))
    return float(away[free].max())


def largest_cup(solid: np.ndarray) -> int:
    """Return the voxels of the largest cup at any time of the print.

    A cup is a pocket of void that is open only to the side of the next layer. Below the first layer
    the void is open, as between supports.
    """
    void = np.pad(~solid, ((1, 0), (1, 1), (1, 1)), constant_values=True)
    return int(_largest_cup(np.ascontiguousarray(void)))


@kernel
def _largest_cup(void):
    """Join the void by union-find, layer by layer; node 0 is the outside, with every margin."""
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
        # Pockets that are still sealed off after this layer and that reach down into earlier ones.
        for y in range(1, height - 1):
            for x in range(1, width - 1):
                if z > 0 and void[z, y, x] and void[z - 1, y, x]:
                    root = root_of(parent, 1 + z * layer + y * width + x)
                    if root != 0 and size[root] > largest:
                        largest = size[root]
    return largest
