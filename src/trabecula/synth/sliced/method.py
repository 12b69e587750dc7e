"""`sliced`: fit learns the pictures at every resolution; generate lays out the coarsest, then
refines level by level.

Sliced rounds move the neighbourhoods in the planes of the views towards the distribution of the
picture's; they copy nothing, and see far because they work on a coarse grid. Search and vote then
make interfaces and thin walls those of the picture (`run`). Steps on the two-point function go
along with both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.engine.memory import Array, Stage, forecast, resident, within
from trabecula.exemplar.views import View, spacing_of
from trabecula.synth.shared.coarse_to_fine import at_level, levels_that_fit
from trabecula.synth.shared.content.fields import channels_of, mean_edge
from trabecula.synth.shared.content.kinds import Content, content_of
from trabecula.synth.shared.matching.principal_components import basis_bytes, principal_basis
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.orient import symmetries
from trabecula.synth.shared.patterns.picture_flips import PictureFlips
from trabecula.synth.shared.pictures import PictureMethod, PictureModel
from trabecula.synth.shared.pyramid import fit_to
from trabecula.synth.shared.solid.method import PROCESS
from trabecula.synth.shared.specks import remove_specks
from trabecula.synth.shared.stages import (
    LevelMemory,
    bound_stages,
    layout_stages,
    region_arrays,
    usage_bytes,
    value_stages,
)
from trabecula.synth.shared.statistics.sliced import transport_stages
from trabecula.synth.shared.statistics.two_point_steps import step_stages
from trabecula.synth.sliced import CAPABILITIES
from trabecula.synth.sliced.aims import Layout, Pictures, SlicedLevel, subsample
from trabecula.synth.sliced.config import SlicedConfig
from trabecula.synth.sliced.run import SlicedRounds, regions_around_known, torus_regions
from trabecula.synth.sliced.steps import distance_stages

_LEAST = 8  # voxels that the result needs along every axis on the level that is laid out
_SAME = 1e-6
_AXES = "zyx"


class Sliced(PictureMethod):
    """Sliced transport and two-point steps, then search and vote."""

    capabilities = CAPABILITIES
    config_type = SlicedConfig
    config: SlicedConfig

    def _width(self) -> int:
        return max(self.config.neighbourhood, self.config.layout_width)

    def _learn(self, exemplars: Sequence[Image], views: tuple[View, ...]) -> SlicedModel:
        return SlicedModel(self.config, exemplars, views)

    def memory(self, exemplars: Sequence[Image]) -> Mapping[str, int]:
        """Forecast the features of every level, counted in components of the pictures as they are,
        and the components' sample.
        """
        config, exemplars = self.config, self._shown(exemplars)
        channels = channels_of(exemplars)
        alone = len(exemplars) == 1 and len(config.views) != 2
        chosen = (
            ("all" if alone else "none") if config.orientations == "auto" else config.orientations
        )
        turns = len(symmetries(chosen, ndim=2))
        content = content_of(exemplars)
        features = 0
        for index in range(
            levels_that_fit(
                min(min(image.shape) for image in exemplars), config.levels, width=self._width()
            )
        ):
            for image in exemplars:
                features += turns * 4**index * _bytes_of(content.fields(image), index, config)
        basis = basis_bytes(
            channels * self._width() ** 2,
            turns * sum(int(np.prod(image.shape)) for image in exemplars),
        )
        return {"interpreter and kernels": PROCESS, "features": features, "basis": basis}


class SlicedModel(PictureModel):
    """Targets of the pictures at every resolution."""

    capabilities = CAPABILITIES
    config: SlicedConfig

    def __init__(
        self, config: SlicedConfig, exemplars: Sequence[Image], views: tuple[View, ...]
    ) -> None:
        super().__init__(config, exemplars, views)
        spacing = spacing_of(views)
        self.content: Content = content_of([view.image for view in views], unit=mean_edge(spacing))
        fields = {view.picture: self.content.fields(view.image) for view in views}
        chosen = config.orientations
        if chosen == "auto":
            alone = (
                len(fields) == 1 and len(views) == 3 and max(spacing) <= min(spacing) * (1 + _SAME)
            )
            chosen = "all" if alone else "none"
        self.flips = PictureFlips(
            views,
            self.content,
            chosen,
            config.interface_rounds,
            config.clip,
            self.sections,
            config.gap,
        )
        pictures = Pictures(fields, views, chosen)
        width = max(config.neighbourhood, config.layout_width)
        smallest = min(min(view.image.shape) for view in views)
        self.top = levels_that_fit(smallest, config.levels, width=width) - 1
        indices = range(self.top + 1)
        self.levels: list[SlicedLevel] = [
            pictures.level(index, config) for index in track(indices, "learning the picture")
        ]
        self.layouts: list[Layout] = [pictures.layout(index, config) for index in indices]

    def _check_request(self, request: Request) -> None:
        super()._check_request(request)
        for axis, (side, wraps) in enumerate(zip(request.shape, request.periodic, strict=True)):
            if side < self._least and (wraps or request.fixed is not None):
                raise RequestError(
                    f"{_AXES[axis]} is {side} voxels long: periodic, or with fixed voxels, it "
                    f"needs at least {self._least}"
                )

    @property
    def _least(self) -> int:
        return max(_LEAST, self.config.neighbourhood, self.config.layout_width)

    def make(self, request: Request) -> np.ndarray | tuple[np.ndarray, Mapping[str, Any]]:
        rounds = SlicedRounds(self, request, self._regions(request))
        with self.flips.part_of_run(request, 0):
            rounds.run()
        rounds.work.enter("deliver")
        votes = fit_to(rounds.work.take("votes"), request.shape)
        return self.flips.finish(self._without_specks(votes, request), request)

    def _without_specks(self, votes: np.ndarray, request: Request) -> np.ndarray:
        """Return votes of the result's shape that leave no specks."""
        if not self.config.specks:
            return votes
        present = self.content.present  # type: ignore[attr-defined]
        values = self.content.to_values(votes, request)
        return remove_specks(votes, values, present, self.config.specks)

    def _top(self, request: Request) -> int:
        """Return the level that is laid out."""
        top = self.top
        while top and min(request.shape) >> top < self._least:
            top -= 1
        return top

    def _regions(self, request: Request) -> list[Region]:
        """Return the regions of levels 0 .. top."""
        top, config = self._top(request), self.config
        bounds = self.content.bounds(request, thin=True)
        if bounds is None:
            return torus_regions(request, top, self._least)
        while True:

            def clip_of(index: int, top: int = top) -> float:
                return config.clip * 2**index

            regions = regions_around_known(request, bounds, top, clip_of, exact=True)
            free = regions[top].free
            if top == 0 or (free is not None and free.any()):
                return regions
            top -= 1

    def memory(self, request: Request) -> Mapping[str, int]:
        return forecast(self._stages(request), self._fixed()).memory

    def resident_memory(self, request: Request) -> Mapping[str, int]:
        return resident(self._stages(request, mapped=True), self._fixed())

    def _fixed(self) -> dict[str, int]:
        """Return the bytes that do not depend on the request."""
        usage = usage_bytes((c for _, c in self.levels[0].views), exact=False)
        return {"interpreter and kernels": PROCESS, "exemplar": self._exemplar_bytes()} | usage

    def _exemplar_bytes(self) -> int:
        """Return the bytes of the pictures' fields and neighbourhoods."""
        candidates = {id(c): c for level in self.levels for _, c in level.views}.values()
        slices = {id(s): s for layout in self.layouts for _, s in layout.views}.values()
        held = sum(
            c.features.nbytes + c.stack.field.nbytes + 9 * c.allowed.nbytes for c in candidates
        )
        return held + sum(s.features.nbytes for s in slices)

    def _region(self, request: Request, index: int) -> Region:
        """Return the region of a level, without known voxels."""
        if request.fixed is None:
            return torus_regions(request, self._top(request), self._least)[index]
        return Region(tuple(-(-side // 2**index) for side in request.shape), request.periodic)

    def _stages(self, request: Request, *, mapped: bool = False) -> tuple[Stage, ...]:
        """Declare the arrays of a run that compete for the peak: of the layout, of the finest
        level, of known voxels before them, and of the result after them.
        """
        top, region = self._top(request), self._region(request, 0)
        finest = self.level_memory(request, 0, region, mapped=mapped)
        result = value_stages(
            request,
            finest.covered.shape,
            finest.channels,
            nbytes=self.output_bytes(request),
            distances=True,
        )
        specks = Array((finest.channels, *request.shape), np.int16) if self.config.specks else None
        return (
            *bound_stages(request, finest.channels, distances=True),
            *self.layout_stages(request, self._region(request, top)),
            *finest.stages(),
            *self.flips.stages(request, finest.channels),
            *within({"votes with specks": specks}, result),
        )

    def level_memory(
        self, request: Request, index: int, region: Region, *, mapped: bool = False
    ) -> LevelMemory:
        """Declare search and vote on level `index`, in a region."""
        config, level = self.config, self.levels[index]
        memory = LevelMemory(request, region, level.views, sweeps=config.sweeps + 1, mapped=mapped)
        if not at_level(config.corrections, index):
            return memory
        step = distance_stages(memory.volume, level.correlations, region.wraps)
        return replace(memory, correction=step)

    def layout_stages(self, request: Request, region: Region) -> tuple[Stage, ...]:
        """Declare the arrays of sliced rounds in a region, and of steps between them."""
        layout = self.layouts[self._top(request)]
        volume = (len(layout.histograms), *region.shape)
        return layout_stages(
            volume,
            region_arrays(request, region.shape, volume[0]),
            transport_stages(volume, layout.views, step=1, known=request.fixed is not None),
            step_stages(region.shape, layout.correlations, region.wraps),
        )


def _bytes_of(field: np.ndarray, index: int, config: SlicedConfig) -> int:
    """Return the bytes of one start of a picture (C, 1, Y, X) on a level."""
    taken = 0
    for width, clip, variance, most, sliced in (
        (config.neighbourhood, config.clip * 2**index, config.variance, config.components, False),
        (config.layout_width, config.layout_clip, 0.95, 64, True),
    ):
        part = subsample(field, index, clip)[0]
        count = principal_basis(
            part, width=width, variance=variance, most=most, flat=True
        ).vectors.shape[1]
        rows = int(np.prod([side - width + 1 for side in part.shape[2:]]))
        taken += rows * (4 << max(2, (count - 1).bit_length()) if sliced else 2 * count + 12)
    return taken
