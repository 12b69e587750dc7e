"""What a certificate will be able to decide about material made from an exemplar: said before anything is made."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.image import Image
from trabecula.report.band import LEAST_PART
from trabecula.report.stationarity import Stationarity

LONG_RANGE = 6
"""Correlation lengths that the shortest side has to have for an exemplar to hold what is typical of its material."""
FEWEST_PARTS = 4
"""Parts of an exemplar from which the spread of real material can be told at all."""


def limits_of(image: Image, lengths: Sequence[float], stationarity: Stationarity) -> tuple[bool, tuple[str, ...]]:
    """Return whether anything can be decided, and what cannot be, each in a sentence."""
    parts = int(np.prod([2 if side // 2 >= LEAST_PART else 1 for side in image.shape]))
    if parts == 1:
        size = " x ".join(map(str, image.shape))
        return False, (
            f"nothing: {size} is too small for parts of {LEAST_PART} voxels a side, so no band says what real material "
            f"differs by; a side of {2 * LEAST_PART} is the least",
        )
    found = []
    if parts < FEWEST_PARTS:
        found.append(f"little: only {parts} parts of {LEAST_PART} voxels a side fit in, so bands are guesses")
    sizes = [side / length if length > 0 else np.inf for side, length in zip(image.shape, lengths, strict=True)]
    short = ["zyx"[n + 3 - image.ndim] for n, size in enumerate(sizes) if size < LONG_RANGE]
    if short:
        found.append(
            f"not what is typical along {', '.join(short)}: fewer than {LONG_RANGE} correlation lengths; bands are wide there"
        )
    if stationarity.stationary is None:
        found.append("not whether the scan is the same everywhere: too few independent windows")
    elif not stationarity.stationary:
        found.append(
            "not a single fraction: the scan has a trend, which widens the bands; crop an even part, or make it with a target field"
        )
    if image.ndim == 2:
        found.append("nothing in 3-D that a slice does not show: whether components are joined in space, transport, stiffness")
    if image.kind != "labels":
        found.append("textures alone while it is not segmented: no fractions, no connectivity")
    return True, tuple(found)
