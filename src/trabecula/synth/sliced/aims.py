"""Targets learnt from pictures at each resolution: neighbourhoods, histograms, two-point functions.

A coarser level is the distance field at every second pixel, from every one of the starts there are,
not a mean: a mean over pixels of a picture and one over voxels of a volume differ, values at points
of a plane do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trabecula.exemplar.views import View, spacing_of
from trabecula.synth.shared.content.fields import FULL, mean_edge, quantise
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.matching.sources import Candidates, Stack
from trabecula.synth.shared.orient import apply_symmetry, symmetries
from trabecula.synth.shared.statistics.pairs import Pairs
from trabecula.synth.shared.statistics.slices import SliceTarget, slice_target
from trabecula.synth.shared.statistics.two_point import (
    Correlations,
    correlations_of,
)
from trabecula.synth.sliced.config import SlicedConfig
from trabecula.synth.sliced.steps import FAR

# farthest distance of pairs in pixels of the picture, and at least so many of a level's own
_REACH, _NEAR = 30, 6
_HARD = 1.0  # softness of an indicator that is 0 or 1


@dataclass(frozen=True)
class SlicedLevel:
    """One resolution of search and vote; two-point functions are those of the phases, for
    `steps.stepped`.
    """

    views: tuple[tuple[int, Candidates], ...]
    histograms: tuple[Histogram, ...]
    correlations: Correlations


@dataclass(frozen=True)
class Layout:
    """The resolution that sliced rounds lay out."""

    views: tuple[tuple[int, SliceTarget], ...]
    histograms: tuple[Histogram, ...]
    correlations: Correlations


@dataclass(frozen=True)
class Pictures:
    """The distance fields (C, 1, Y, X) float32 of the pictures by their numbers, in voxels, and how
    they are seen.

    `orientations` ("none", "mirrors", "all") are those of the copies that are learnt from.
    """

    fields: dict[int, np.ndarray]
    views: tuple[View, ...]
    orientations: str

    def level(self, index: int, config: SlicedConfig) -> SlicedLevel:
        """Learn level `index` for search and vote."""
        clip = config.clip * 2**index
        stacks = {number: Stack.of(parts) for number, parts in self._parts(index, clip).items()}
        made = {
            number: Candidates.of(
                stack,
                width=config.neighbourhood,
                step=config.step if index == 0 else 1,
                variance=config.variance,
                most=config.components,
                flat=True,
            )
            for number, stack in stacks.items()
        }
        target = replace(
            self._correlations(index, clip, _HARD), softness=config.softness * FULL / FAR
        )
        return SlicedLevel(
            tuple((v.axis, made[v.picture]) for v in self.views), self._histograms(stacks), target
        )

    def layout(self, index: int, config: SlicedConfig) -> Layout:
        """Learn level `index` for sliced rounds."""
        parts = self._parts(index, config.layout_clip)
        made = {
            number: slice_target(part, width=config.layout_width, flat=True)
            for number, part in parts.items()
        }
        stacks = {number: Stack.of(part) for number, part in parts.items()}
        # The soft interface is as wide as a voxel of the level, where the clipped field is that
        # wide.
        softness = min(2.0, 2**index / config.layout_clip) * FULL
        target = self._correlations(index, config.layout_clip, softness)
        return Layout(
            tuple((v.axis, made[v.picture]) for v in self.views), self._histograms(stacks), target
        )

    def _histograms(self, stacks: dict[int, Stack]) -> tuple[Histogram, ...]:
        """Pool the histograms of all views, one a channel."""
        seen = [stacks[view.picture].histograms for view in self.views]
        return tuple(Histogram.pool(channel) for channel in zip(*seen, strict=True))

    def _parts(self, index: int, clip: float) -> dict[int, list[np.ndarray]]:
        """Return every picture as int8 fields of a level, one for each start and orientation."""
        found = {}
        for number, field in self.fields.items():
            spacing = next(view.image.spacing for view in self.views if view.picture == number)
            turns = symmetries(self.orientations, ndim=2, spacing=spacing)
            thin = subsample(field, index, clip)
            found[number] = [
                apply_symmetry(part[:, 0], turn)[:, None] for part in thin for turn in turns
            ]
        return found

    def _correlations(self, index: int, clip: float, softness: float) -> Correlations:
        """Measure the two-point functions in the planes; where turned pictures count as well, one
        for all directions.
        """
        spacing = spacing_of(self.views)
        edges = [edge / mean_edge(spacing) for edge in spacing]
        parts = [
            np.moveaxis(part, 1, 1 + view.axis)
            for view in self.views
            for part in subsample(self.fields[view.picture], index, clip)
        ]
        shortest = min(min(field.shape[2:]) for field in self.fields.values())
        reach = max(_NEAR, min(_REACH, shortest // 2 - 1) // 2**index)
        target = correlations_of(parts, softness=softness, r_max=reach, edges=edges)
        return (
            make_isotropic(target, [part.shape[1:] for part in parts])
            if self.orientations == "all"
            else target
        )


def subsample(field: np.ndarray, index: int, clip: float) -> list[np.ndarray]:
    """Return a field (C, 1, Y, X) in int8 at every 2**index-th pixel, from every start."""
    stride = 2**index
    whole = quantise(field, clip=clip)
    return [whole[:, :, y::stride, x::stride] for y in range(stride) for x in range(stride)]


def make_isotropic(target: Correlations, shapes: Sequence[tuple[int, ...]]) -> Correlations:
    """Average the three directions of a target, measured in fields of these shapes, to one function
    of distance.
    """
    bins = target.r_max + 1
    fits = np.sum(
        [Pairs(shape, target.r_max, edges=target.edges).fits for shape in shapes], axis=0
    ).reshape(3, bins)
    sums = (target.curves.reshape(-1, 3, bins) * fits).sum(axis=1) / np.maximum(fits.sum(axis=0), 1)
    return replace(target, curves=np.tile(sums, (1, 3)), held=np.tile(fits.sum(axis=0) > 0, 3))
