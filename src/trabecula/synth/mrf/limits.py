"""What settings and pictures allow: scales, and numbers that stay exact."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.image import Image
from trabecula.synth.mrf.config import MrfConfig
from trabecula.synth.shared.pictures import ROOM

STEPS = 16
"""Steps of (1 - t)^2, the weight of a neighbour of temperature t."""


def scales_of(images: Sequence[Image], config: MrfConfig) -> int:
    """How many scales leave room for a neighbourhood in every picture."""
    smallest, count = min(min(image.shape) for image in images), 1
    while count < config.scales and smallest // 2**count >= config.neighbourhood + ROOM:
        count += 1
    return count


def largest_feature(kind: str, config: MrfConfig) -> int:
    """Such that distances stay exact in float32: 3 W F^2 C K < 2^24, with weights up to W."""
    channels = 3 if kind == "colour" else 1
    weight = STEPS if config.relaxation == "icm" else 1
    return min(
        127, int(np.sqrt((2**24 - 1) / (3 * weight * channels * (config.neighbourhood**2 - 1))))
    )
