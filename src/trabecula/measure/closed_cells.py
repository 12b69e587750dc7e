"""Closed cells of a volume: whether one of its phases is walls between bodies that it keeps apart.

Walls of closed cells are even: the mean square of the depth in them is near that of a plate. A
matrix between separate balls is thick where three of them are near, and thin where two are.
"""

from __future__ import annotations

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.centre_crop import centre_box
from trabecula.measure.distance import distance_transform
from trabecula.measure.labelling import label_components, labels_at_faces

BOX = 128
"""Voxels a side of the centre that is looked at, at most."""

ALONE = 0.3
"""Of a phase: the largest share of one component at which the phase still consists of bodies."""

BYTES = 16
"""Of a voxel of that centre, at its peak."""

_CELLS, _CELL = 5, 20  # whole cells, of so many voxels each, at least
_FILLED = 0.3  # of the volume, that cells fill at least
_EVEN = 1.2  # thickening of walls, at most: of foams 1.02 to 1.14, between balls 1.27 to 1.37


def thickening(walls: np.ndarray) -> float:
    """Return the mean square of the depth in walls, bool, over the square of its mean."""
    depth = distance_transform(walls)[walls]
    return float(np.mean(depth**2, dtype=np.float64) / np.mean(depth, dtype=np.float64) ** 2)


def wall_phase(image: Image) -> int | None:
    """Return the label of the phase of a volume that is walls between closed cells; None where none
    is.
    """
    values = centre_box(image.values, BOX)
    counts = {int(label): _whole_cells(values != label) for label in np.unique(values)}
    walls = [label for label in counts if counts[label] and thickening(values == label) <= _EVEN]
    return max(walls, key=lambda label: (counts[label], -label), default=None)


def _whole_cells(interior: np.ndarray) -> int:
    """Return how many bodies of an interior (Z, Y, X) no face cuts; 0 where they are no cells."""
    if interior.mean() < _FILLED:
        return 0
    labels, sizes = label_components(interior, connectivity=6)
    if sizes.max() > ALONE * sizes.sum():
        return 0
    whole = (sizes >= _CELL) & ~labels_at_faces(labels, len(sizes))[1:]
    return int(whole.sum()) if whole.sum() >= _CELLS else 0
