"""How much memory `mrf` will take, from shapes and settings alone; the factors were measured."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.image import Image
from trabecula.synth.mrf.config import MrfConfig
from trabecula.synth.mrf.content import Content
from trabecula.synth.mrf.frame import BATCH_OF_BITS, BATCH_OF_PRODUCTS
from trabecula.synth.mrf.source import Source

_TABLES = 80_000  # bytes of the two tables of a source
_PAIRS = 32  # bytes a voxel of spectra, when a field is convolved


def learning_bytes(image: Image, scale: int, config: MrfConfig) -> tuple[int, int]:
    """What a picture's neighbourhoods at a scale take once they are learnt, and meanwhile."""
    width, around = config.neighbourhood, config.neighbourhood**2 - 1
    stride, edge = 2**scale, config.neighbourhood - 1
    corners = list(np.ndindex(stride, stride)) if config.every else [(0, 0)]
    count = sum(
        int(
            np.prod(
                [max(0, -(-(side - first) // stride) - edge) for side, first in zip(image.shape, corner, strict=True)]
            )
        )
        for corner in corners
    )
    chosen = min(count, config.candidates)
    if image.kind == "labels" and config.relaxation != "icm":
        kept, meanwhile = chosen * around // 2, chosen * around * 7
    else:
        channels = {"labels": len(image.phases) if len(image.phases) > 2 else 1, "grey": 1, "colour": 3}[image.kind]
        levels = {"labels": 16, "grey": config.levels, "colour": config.colours}[image.kind]
        kept = 4 * chosen * around * (2 * channels + 1) + 8 * min(levels, image.values.size) ** 2 + _TABLES
        meanwhile = kept + 9 * chosen * around
    return kept, max(3 * width**2 * count, width**2 * count + meanwhile)


def lattice_bytes(voxels: int, content: Content, views: int, config: MrfConfig) -> int:
    """The lattices of all scales, the sites of a class with their scores, the couplings, and the centre's Gaussians."""
    levels, channels = content.features.shape
    marks = 6 + 5 * (config.relaxation == "icm")
    groups = int(content.groups.max()) + 1
    site = 48 + 4 * levels + config.shares * (4 * levels + 8 * groups) + views * channels
    classes = (config.neighbourhood // 2 + 1) ** 2
    coupled = 2 * channels + _PAIRS if config.coupling_of(content.kind) else 0
    return int(voxels * (marks + site / classes + coupled)) + 8 * views * levels**2


def scratch_bytes(sources: Sequence[Source], content: Content, views: int, config: MrfConfig) -> int:
    """What a batch of sites takes in one thread."""
    around, levels = config.neighbourhood**2 - 1, len(content.features)
    shares = levels * (24 * views + 24) + around * 11
    if sources[0].bits is not None:
        return BATCH_OF_BITS * (shares + 16 * max(len(source.bits) for source in sources if source.bits is not None))
    widest = max(len(source.centres) for source in sources)
    return BATCH_OF_PRODUCTS * (shares + 4 * widest + 4 * around * (content.features.shape[1] + 1)) + 5 * widest
