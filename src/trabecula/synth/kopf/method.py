"""`kopf`: the frame of `shared.solid` with the soft histogram matching of the paper's weights.

A contribution of an exemplar's pixel weighs less by 1 + sum over channels of max(0, H_S(b) - H_E(b)), where b is the bin of its
value, H_S the histogram of the result so far and H_E that of the pictures.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.image import Image
from trabecula.exemplar.views import View
from trabecula.synth.kopf import SPEC
from trabecula.synth.kopf.config import KopfConfig
from trabecula.synth.shared.histogram import Histogram
from trabecula.synth.shared.matching.planes import Frame, voted_planes
from trabecula.synth.shared.solid import Solid, SolidModel, State

_BINS = 16


class Kopf(Solid):
    """Solid texture synthesis from 2-D exemplars."""

    spec = SPEC
    config_type = KopfConfig

    def _learn(self, exemplars: Sequence[Image], views: tuple[View, ...]) -> KopfModel:
        return KopfModel(self.config, exemplars, views)


class KopfModel(SolidModel):
    """Pictures as pyramids of fields."""

    spec = SPEC
    config: KopfConfig

    def _voted(
        self, frame: Frame, state: State, matches: tuple[np.ndarray, ...], weights: Sequence[np.ndarray], trim: int
    ) -> State:
        factors = None
        if self.config.reweighting:
            excess = excess_of((state.votes >> 8).astype(np.int8), frame, self.config.reweighting)
            factors = [factors_of(plane.grid.candidates.stack.field, excess, frame.full) for plane in frame.planes]
        votes = voted_planes(frame, matches, weights, factors=factors, trim=trim)
        return self._made(frame, matches, votes)


def excess_of(field: np.ndarray, frame: Frame, strength: float) -> np.ndarray:
    """(C, 16): strength times the share of a bin in a field (C, Z, Y, X) int8 beyond its share in the target."""
    free = frame.region.free
    excess = []
    for channel, target in zip(field, frame.targets, strict=True):
        held = channel if free is None else channel[free]
        own = np.bincount(_bin(held.ravel()), minlength=_BINS) / max(1, held.size)
        excess.append(strength * np.maximum(own - _shares(target), 0))
    return np.array(excess)


def factors_of(exemplar: np.ndarray, excess: np.ndarray, full: int) -> np.ndarray:
    """The factor (z, y, x) int16 of every voxel of (C, z, y, x) int8: `full` over 1 + the excess of its values' bins."""
    total = np.ones(exemplar.shape[1:])
    for channel, over in zip(exemplar, excess, strict=True):
        total += over[_bin(channel)]
    return np.maximum(np.rint(full / total), 1).astype(np.int16)


def _shares(target: Histogram) -> np.ndarray:
    counts = np.diff(target.up_to, prepend=0)
    return np.bincount(_bin(target.values), weights=counts, minlength=_BINS) / counts.sum()


def _bin(values: np.ndarray) -> np.ndarray:
    return (values.astype(np.int16) + 128) >> 4
