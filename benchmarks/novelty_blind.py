"""Measures of novelty on verbatim copies, on and off the grid that the literature compares with.

The least aligned Hamming distance is the least share of differing voxels between an image and the
exemplar's crops on a grid. A copy whose corner lies between the places of that grid is as far from
them all as independent material is.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

import trabecula as tb
from common import table
from descriptors import scans
from fakes import cut

SIDE = 64
GRID = 34
DEPTH = 132
"""Planes of a scan that are the exemplar; what lies behind them is independent."""
COUNT = 8
SCANS = ("Berea", "bone a")


def novelty_blind() -> None:
    """Least aligned Hamming distance and coherence of copies on and off a grid of 34 voxels, and of
    independent material, 64^3.
    """
    row = table("exemplar", "image", "Hamming, least", "median", "coherence(4)", "highest")
    for name in SCANS:
        scan = scans()[name]
        exemplar = cut(scan, (0, 0, 0), (DEPTH, 200, 200))
        for what, images in cases(scan, exemplar).items():
            apart = [least_hamming(exemplar, image) for image in images]
            along = [tb.measure.coherence(exemplar, image, k=4)[4] for image in images]
            row(
                name,
                what,
                f"{min(apart):.3f}",
                f"{np.median(apart):.3f}",
                f"{np.median(along):.3f}",
                f"{max(along):.3f}",
            )


def cases(scan: tb.Image, exemplar: tb.Image) -> dict[str, list[tb.Image]]:
    """Return images of 64^3 by what they are."""
    last = min(scan.shape)
    behind = [(last - SIDE, y, x) for y, x in product((0, 68, 136), repeat=2)][:COUNT]
    on = [(z, y, x) for z, y, x in product((0, GRID), repeat=3)][:COUNT]
    off = [(z + GRID // 2, y + GRID // 2, x + GRID // 2) for z, y, x in on]
    found = {"copy on the grid": on, "copy 17 voxels off it": off, "independent": behind}
    return {
        what: [cut(scan, corner, (SIDE,) * 3) for corner in corners]
        for what, corners in found.items()
    }


def grid_crops(exemplar: tb.Image) -> Iterator[np.ndarray]:
    """Yield the exemplar's crops whose corners lie on the grid."""
    for corner in product(*(range(0, side - SIDE + 1, GRID) for side in exemplar.shape)):
        yield exemplar.values[tuple(slice(a, a + SIDE) for a in corner)]


def least_hamming(exemplar: tb.Image, image: tb.Image) -> float:
    """Return the least share of voxels that differ from a crop on the grid."""
    return min(float((crop != image.values).mean()) for crop in grid_crops(exemplar))
