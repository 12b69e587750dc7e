"""Targets of direction and size: patches of turned and scaled copies, chosen by the local fabric
and the size of their copy as further descriptors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from trabecula.core.image import Image
from trabecula.core.target import FRAME, OF_A_PHASE, Target, densities_of, porosity_of
from trabecula.synth.quilt.config import QuiltConfig
from trabecula.synth.quilt.patch_library import PatchLibrary
from trabecula.synth.shared.frames import TargetFrames
from trabecula.synth.shared.turned_exemplars import (
    PAIRS,
    TurnedExemplars,
    turn_exemplars,
    wanted_fabric,
)

_FABRIC = tuple(f"fabric:{'zyx'[i]}{'zyx'[j]}" for i, j in PAIRS)
_SIZE = "size"

_VARIETY = 0.02  # least; hardly two patches have one fabric, so all seeds would choose the same


def turned_library(
    exemplars: Sequence[Image], library: PatchLibrary, config: QuiltConfig, frames: TargetFrames
) -> PatchLibrary:
    """Return the patches of turned and scaled copies, of the size of those of a library."""
    copies = turn_exemplars(exemplars, frames, least=library.patch + 1)
    settings = replace(
        config, patch=library.patch, overlap=library.overlap, orientations="none", period="none"
    )
    turned = PatchLibrary.build(copies.images, settings)
    return replace(turned, measured=_measure_copies(copies, turned))


def _measure_copies(
    copies: TurnedExemplars, library: PatchLibrary
) -> dict[str, tuple[np.ndarray, ...]]:
    """Return the fabric amid every patch of every copy, and the size of the copy, by name."""
    middle = library.patch // 2
    counts = library.counts
    found: dict[str, tuple[np.ndarray, ...]] = {
        _SIZE: tuple(
            np.full(count, np.log2(size), np.float32)
            for count, size in zip(counts, copies.sizes, strict=True)
        )
    }
    if copies.fabrics:
        fabrics = [
            copies.fabric_at(number, [np.arange(side) + middle for side in count])
            for number, count in enumerate(counts)
        ]
        for entry, name in enumerate(_FABRIC):
            found[name] = tuple(np.ascontiguousarray(one[..., entry]) for one in fabrics)
    return found


def frame_targets(target: Mapping[str, Target], porosity: float) -> dict[str, Target]:
    """Return targets with direction and size as descriptors of patches; without a volume fraction
    the exemplar's porosity is one, since void fits to void anywhere.
    """
    found = densities_of(target)
    if porosity_of(found) is None and not any(name.startswith(OF_A_PHASE) for name in found):
        found["porosity"] = porosity
    if "orientation" in target:
        fabric = wanted_fabric(target["orientation"])
        for entry, name in enumerate(_FABRIC):
            value = fabric[..., entry]
            found[name] = np.ascontiguousarray(value) if value.ndim else float(value)
    if "size" in target:
        size = np.log2(target["size"])
        found[_SIZE] = size.astype(np.float32) if np.ndim(size) else float(size)
    return found


def frame_config(config: QuiltConfig) -> QuiltConfig:
    """Return the settings of patches that follow a frame: the weight of the direction is shared
    among the entries of the fabric, and some variety makes results depend on their seeds.
    """
    share = config.weights.get("orientation", 1.0) / 3
    found = {name: weight for name, weight in config.weights.items() if name not in FRAME}
    size = config.weights.get("size", 1.0)
    weights = {**found, **dict.fromkeys(_FABRIC, share), _SIZE: size}
    return replace(config, weights=weights, variety=max(config.variety, _VARIETY))
