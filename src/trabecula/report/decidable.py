"""What a certificate will be able to decide about material made from an exemplar: said before
anything is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.report.band import LEAST_COUNT, LEAST_PART, LONG_RANGE, part_boxes
from trabecula.report.stationarity import Stationarity


@dataclass(frozen=True)
class Decidable:
    """What a certificate can decide.

    Attributes
    ----------
    parts : int
        Of the exemplar, that give the bands; 1 where it cannot be cut, so that nothing can be
        decided.
    part : tuple of int
        Voxels of a part.
    figures : str
        What is judged by the bands.
    limits : tuple of str
        What is not decided, a sentence each.
    """

    parts: int
    part: tuple[int, ...]
    figures: str
    limits: tuple[str, ...]

    @property
    def anything(self) -> bool:
        """Whether there are bands."""
        return self.parts > 1

    def to_json(self) -> dict[str, Any]:
        """Plain JSON."""
        return {
            "anything": self.anything,
            "parts": self.parts,
            "part": list(self.part),
            "figures": self.figures,
            "limits": list(self.limits),
        }


def decidable(image: Image, lengths: Sequence[float], stationarity: Stationarity) -> Decidable:
    """Tell what a certificate can decide of an exemplar, as it is learnt from.

    Parameters
    ----------
    image : Image
    lengths : sequence of float
        Correlation length along every axis, voxels.
    stationarity : Stationarity
    """
    boxes = part_boxes(image.shape)
    if not boxes:
        size = " x ".join(map(str, image.shape))
        reason = (
            f"{size} is too small for parts of {LEAST_PART} voxels a side, so no band says what real material differs by: a side "
            f"of {2 * LEAST_PART} is the least"
        )
        return Decidable(1, image.shape, "nothing", (reason,))
    figures = (
        "textures" if image.kind != "labels" else "fractions, correlations, sizes and connectivity"
    )
    part = tuple(each.stop - each.start for each in boxes[0])
    limits = tuple(_limits(image, lengths, stationarity, len(boxes)))
    return Decidable(len(boxes), part, figures + (" in slices" if image.ndim == 2 else ""), limits)


def _limits(
    image: Image, lengths: Sequence[float], stationarity: Stationarity, parts: int
) -> list[str]:
    found = []
    if parts < LEAST_COUNT:
        found.append(
            f"how much real material differs from itself: {parts} parts are too few to tell"
        )
    sizes = [
        side / length if length > 0 else np.inf
        for side, length in zip(image.shape, lengths, strict=True)
    ]
    short = ["zyx"[n + 3 - image.ndim] for n, size in enumerate(sizes) if size < LONG_RANGE]
    if short:
        found.append(
            f"what is typical along {', '.join(short)}: the side has fewer than {LONG_RANGE} correlation lengths, bands are wide"
        )
    if stationarity.stationary is None:
        found.append("whether the scan is the same all over: too few independent windows")
    elif not stationarity.stationary:
        field = "" if image.ndim == 2 else ", or make it with a target field"
        found.append(
            f"a pass: the scan has a trend itself, so that it is no sample of one material; crop an even part{field}"
        )
    if image.ndim == 2:
        found.append(
            "what no slice shows: whether components are joined in space, transport, stiffness"
        )
    return found
