"""Solid texture from pictures by search and vote on the planes of up to three views, the model of
`kopf` and `chen`.

From coarse to fine, on every level: each view searches for the squares in its planes the nearest
ones in its picture; all squares of all views that overlap in a voxel vote. The votes become the
next field in each method's own way (`SolidRounds.cast`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.engine.memory import Stage, Workspace, forecast, resident
from trabecula.exemplar.views import View, spacing_of
from trabecula.synth.shared.coarse_to_fine import at_level, levels_that_fit
from trabecula.synth.shared.content.fields import FULL, mean_edge, quantise
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.content.kinds import Content, content_of
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Candidates, Stack
from trabecula.synth.shared.orient import apply_symmetry, symmetries
from trabecula.synth.shared.patterns.picture_flips import PictureFlips
from trabecula.synth.shared.pictures import PictureModel
from trabecula.synth.shared.pyramid import fit_to, halve
from trabecula.synth.shared.solid.config import SolidConfig
from trabecula.synth.shared.solid.method import PROCESS
from trabecula.synth.shared.solid.run import SolidRounds
from trabecula.synth.shared.stages import LevelMemory, bound_stages, usage_bytes, value_stages
from trabecula.synth.shared.statistics.two_point import Correlations, correlations_at
from trabecula.synth.shared.statistics.two_point_steps import step_stages


@dataclass(frozen=True)
class SolidLevel:
    """The pictures at one resolution: the neighbourhoods of every view, and the histograms of all
    of them together.
    """

    views: tuple[tuple[int, Candidates], ...]
    histograms: tuple[Histogram, ...]
    correlations: Correlations | None  # where rounds step towards them


class SolidModel(PictureModel):
    """Pictures as pyramids of fields with the neighbourhoods of every level."""

    rounds_type: ClassVar[type[SolidRounds]] = SolidRounds
    config: Any

    def __init__(
        self, config: SolidConfig, exemplars: Sequence[Image], views: tuple[View, ...]
    ) -> None:
        super().__init__(config, exemplars, views)
        unit = mean_edge(spacing_of(views))
        pictures = [view.image for view in views]
        self.content: Content = content_of(
            pictures,
            histogram=config.histogram,
            unit=unit,
            rim=config.clip if config.feature else None,
        )
        self.flips = PictureFlips(
            views,
            self.content,
            config.orientations,
            config.interface_rounds,
            config.clip,
            self.sections,
            config.gap,
        )
        # Views of the same picture share all that is learnt from it.
        self.numbers = [
            next(n for n, other in enumerate(pictures) if other is picture) for picture in pictures
        ]
        fields = {n: self.content.fields(pictures[n]) for n in sorted(set(self.numbers))}
        count = levels_that_fit(
            min(min(picture.shape) for picture in pictures),
            config.levels,
            width=config.neighbourhood,
        )
        self.levels: list[SolidLevel] = []
        for index in track(range(count), "learning the picture"):
            own = {n: self.quantise_level(field, index) for n, field in fields.items()}
            made = {n: self._learn_picture(field, index, pictures[n]) for n, field in own.items()}
            stacks = [made[n].stack.histograms for n in self.numbers]
            histograms = tuple(Histogram.pool(channel) for channel in zip(*stacks, strict=True))
            seen = tuple((view.axis, made[n]) for view, n in zip(views, self.numbers, strict=True))
            target = None
            if self.content.distances and any(config.corrections):
                deep = [
                    np.moveaxis(own[n], 1, 1 + view.axis)
                    for view, n in zip(views, self.numbers, strict=True)
                ]
                target = correlations_at(
                    deep, index, edges=[e / unit for e in spacing_of(views)], clip=config.clip
                )
            self.levels.append(SolidLevel(seen, histograms, target))
            fields = {n: halve(field) for n, field in fields.items()}

    def _learn_picture(self, field: np.ndarray, index: int, picture: Image) -> Candidates:
        """Learn the neighbourhoods of one picture (C, 1, y, x) int8 on one level."""
        config = self.config
        turns = symmetries(config.orientations, ndim=2, spacing=picture.spacing)
        stack = Stack.of([apply_symmetry(field[:, 0], turn)[:, None] for turn in turns])
        return Candidates.of(
            stack,
            width=config.neighbourhood,
            step=config.step,
            variance=config.variance,
            most=config.components,
            smooth=index == 0 and self.content.distances,
            k=config.nearest,
            flat=True,
        )

    def quantise_level(self, field: np.ndarray, index: int) -> np.ndarray:
        """Round a field of level `index` to int8: a distance, also that of a feature, counts in the
        voxels of its level, a grey value is unchanged.
        """
        if self.content.distances:
            return quantise(field / np.float32(2**index), clip=self.config.clip)
        if not self.content.features:
            return quantise(field, clip=FULL)
        units = np.ones((len(field), 1, 1, 1), np.float32)
        units[-self.content.features :] = 2**index
        return quantise(field / units, clip=FULL)

    def make(self, request: Request) -> np.ndarray | tuple[np.ndarray, Mapping[str, Any]]:
        rounds = self.rounds_type(self, request)
        with self.flips.part_of_run(request, 0):
            rounds.run()
        rounds.work.enter("deliver")
        return self._to_values(rounds.work, request)

    def _to_values(
        self, work: Workspace, request: Request
    ) -> np.ndarray | tuple[np.ndarray, Mapping[str, Any]]:
        """Return the result's values from the last votes, and a report where voxels flip."""
        return self.flips.finish(fit_to(work.take("votes"), request.shape), request)

    def memory(self, request: Request) -> Mapping[str, int]:
        return forecast(self._stages(request), self._fixed()).memory

    def resident_memory(self, request: Request) -> Mapping[str, int]:
        return resident(self._stages(request, mapped=True), self._fixed())

    def level_memory(
        self, request: Request, index: int, region: Region, *, mapped: bool = False
    ) -> LevelMemory:
        """Declare search and vote on level `index`, in a region."""
        config, level = self.config, self.levels[index]
        memory = LevelMemory(
            request,
            region,
            level.views,
            sweeps=at_level(config.sweeps, index),
            exact=config.search == "exact",
            chosen=self._chooses,
            mapped=mapped,
        )
        target = level.correlations
        kept = request.fixed is not None or request.coarse is not None
        if target is None or kept or not at_level(config.corrections, index):
            return memory
        return replace(memory, correction=step_stages(memory.covered.shape, target, region.wraps))

    def _stages(self, request: Request, *, mapped: bool = False) -> tuple[Stage, ...]:
        """Declare the arrays of a run that compete for the peak: those of the finest level, of
        known voxels before it, and of the result after it.
        """
        region, distances = Region(request.shape, request.periodic), self.content.distances
        finest = self.level_memory(request, 0, region, mapped=mapped)
        return (
            *bound_stages(request, finest.channels, distances=distances),
            *finest.stages(),
            *self.flips.stages(request, finest.channels),
            *value_stages(
                request,
                finest.covered.shape,
                finest.channels,
                nbytes=self.output_bytes(request),
                distances=distances,
            ),
        )

    def _fixed(self) -> dict[str, int]:
        """Return the bytes that do not depend on the request."""
        usage = usage_bytes(
            (c for _, c in self.levels[0].views), exact=self.config.search == "exact"
        )
        return {"interpreter and kernels": PROCESS, "exemplar": self._exemplar_bytes()} | usage

    def _exemplar_bytes(self) -> int:
        """Return the bytes of the pictures' fields and neighbourhoods."""
        # Views of one picture share its candidates; the exact search holds their features once
        # more, in another order.
        candidates = {id(c): c for level in self.levels for _, c in level.views}.values()
        own = 3 if self.config.search == "exact" else 1
        return sum(
            own * c.features.nbytes + c.stack.field.nbytes + 9 * c.allowed.nbytes
            for c in candidates
        )

    @property
    def _chooses(self) -> bool:
        """Return whether voxels become pixels of the pictures."""
        return False
