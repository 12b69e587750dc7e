"""Which label new voxels of a phase take."""

from __future__ import annotations

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.distance import distance_transform


def repainted(image: Image, before: np.ndarray, after: np.ndarray, background: int) -> np.ndarray:
    """The labels of `image` where a phase that was `before` has become `after` (bool arrays of its
    shape).

    What the phase has left becomes `background`; where it is new it takes the label of its nearest
    voxel, the lower one of two at one distance.
    """
    values = np.array(image.values, order="C")
    values[before & ~after] = background
    new = after & ~before
    present = np.flatnonzero(np.bincount(image.values[before], minlength=1))
    if len(present) == 1:
        values[new] = present[0]
    elif new.any():
        away = [
            distance_transform(~(before & (image.values == label)), spacing=image.spacing)[new]
            for label in present
        ]
        values[new] = present[np.argmin(away, axis=0)]
    return values
