"""`sliced`: fit keeps what the pictures say at every resolution; generate lays out the coarsest,
then refines level by level.

Sliced rounds (`layout`) move the neighbourhoods in the planes of the views towards the distribution
of the picture's; they copy nothing, and see far because they work on a coarse grid. Search and vote
(`passes`) then make interfaces and thin walls those of the picture. Steps on the two-point function
go along with both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import prod
from typing import ClassVar

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine.checkpoint import resume
from trabecula.engine.memory import Plan
from trabecula.exemplar.views import View, spacing_of
from trabecula.synth.shared.content import Content, content_of
from trabecula.synth.shared.fields import mean_edge
from trabecula.synth.shared.matching.planes import Frame
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import refined
from trabecula.synth.shared.neighbourhoods import basis_bytes, principal_basis
from trabecula.synth.shared.orient import symmetries
from trabecula.synth.shared.pictures import ROOM, PictureMethod, PictureModel
from trabecula.synth.shared.pyramid import fit_to
from trabecula.synth.shared.solid_fit import PROCESS, channels_of
from trabecula.synth.shared.solid_forecast import Run
from trabecula.synth.shared.solid_state import State
from trabecula.synth.shared.statistics.correlate import step_bytes, step_slab_bytes
from trabecula.synth.shared.statistics.moved import round_bytes
from trabecula.synth.sliced import CAPABILITIES
from trabecula.synth.sliced.aims import Layout, Level, Pictures, leaning, thinned
from trabecula.synth.sliced.config import SlicedConfig
from trabecula.synth.sliced.domain import around_known, torus
from trabecula.synth.sliced.layout import laid_out
from trabecula.synth.sliced.passes import begun, passed
from trabecula.synth.sliced.specks import without_specks

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

    def _plan_fit(self, exemplars: Sequence[Image]) -> Plan:
        """Features of every level, counted in components of the pictures as they are, and the
        components' sample.
        """
        config, channels = self.config, channels_of(exemplars)
        alone = len(exemplars) == 1 and len(config.views) != 2
        chosen = (
            ("all" if alone else "none") if config.orientations == "auto" else config.orientations
        )
        turns = len(symmetries(chosen, ndim=2))
        content = content_of(exemplars)
        features = 0
        for index in range(1 + _top_for(min(min(image.shape) for image in exemplars), config)):
            for image in exemplars:
                features += turns * 4**index * _bytes_of(content.fields(image), index, config)
        basis = basis_bytes(
            channels * self._width() ** 2,
            turns * sum(int(np.prod(image.shape)) for image in exemplars),
        )
        return Plan({"interpreter and kernels": PROCESS, "features": features, "basis": basis})


class SlicedModel(PictureModel):
    """What the pictures say at every resolution."""

    capabilities = CAPABILITIES
    spills: ClassVar[bool] = True
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
        pictures = Pictures(fields, views, chosen)
        self.top = _top_for(min(min(view.image.shape) for view in views), config)
        indices = range(self.top + 1)
        self.levels: list[Level] = [
            pictures.level(index, config) for index in track(indices, "learning the picture")
        ]
        self.layouts: list[Layout] = [pictures.layout(index, config) for index in indices]

    def _check_request(self, request: Request) -> None:
        super()._check_request(request)
        for axis, (side, wraps) in enumerate(zip(request.shape, request.periodic, strict=True)):
            if side < self._least and (wraps or request.fixed is not None):
                raise RequestError(
                    f"{_AXES[axis]} is {side} voxels long: periodic, or with fixed voxels, it needs at least {self._least}"
                )

    @property
    def _least(self) -> int:
        return max(_LEAST, self.config.neighbourhood, self.config.layout_width)

    def make(self, request: Request) -> np.ndarray:
        regions = self._regions(request)
        top = len(regions) - 1
        state, begin, done = self._resumed(top)
        if state is None:
            field = self._laid_out(regions[top], top, request)
            # The layout is made of coarse neighbourhoods already, but not beside known voxels.
            begin -= bool(top and request.fixed is None)
        del regions[begin + 1 :]
        while regions:
            index = len(regions) - 1
            frame = self._frame(regions.pop(), index, request)
            if state is None:
                state = begun(
                    frame, _fitted(field, frame.region, finer=index < top), _key(request, index)
                )
            self._pass(frame, state, index, request, done)
            field, votes, state, done = state.field, state.votes, None, 0
        del field, frame
        return self._delivered(fit_to(votes, request.shape), request)

    def _resumed(self, top: int) -> tuple[State | None, int, int]:
        """The state that an interrupted run left, its level and its rounds done; none, and the
        coarsest level.
        """
        for index in range(top + 1):
            left = resume(_stage(index))
            if left is not None:
                return State.of(left.arrays), index, left.number
        return None, top, 0

    def _laid_out(self, region: Region, top: int, request: Request) -> np.ndarray:
        layout = self.layouts[top]
        return laid_out(
            layout, region, self.content.aims(layout.histograms, request), request.seed, self.config
        )

    def _frame(self, region: Region, index: int, request: Request) -> Frame:
        level = self.levels[index]
        return Frame.over(region, level.views, self.content.aims(level.histograms, request))

    def _pass(self, frame: Frame, state: State, index: int, request: Request, done: int) -> None:
        """Search and vote on one level."""
        config, level = self.config, self.levels[index]
        passed(
            frame,
            state,
            leaning(level.correlations, level.histograms, frame.targets, softness=1.0),
            config,
            stage=_key(request, index),
            done=done,
            rounds=config.rounds[min(index, len(config.rounds) - 1)],
            steps=config.corrections[min(index, len(config.corrections) - 1)],
            said=_stage(index),
        )

    def _delivered(self, votes: np.ndarray, request: Request) -> np.ndarray:
        """The result's values from votes of its shape, without specks."""
        values = self.content.delivered(votes, request)
        if not self.config.specks:
            return values
        votes = without_specks(votes, values, self.content.present, self.config.specks)  # type: ignore[attr-defined]
        del values
        return self.content.delivered(votes, request)

    def _top(self, request: Request) -> int:
        """The level that is laid out."""
        top = self.top
        while top and min(request.shape) >> top < self._least:
            top -= 1
        return top

    def _regions(self, request: Request) -> list[Region]:
        """Where levels 0 .. top are made."""
        top, config = self._top(request), self.config
        bounds = self.content.bounds(request, thin=True)
        if bounds is None:
            return torus(request, top, self._least)
        while True:

            def clip_of(index: int, top: int = top) -> float:
                return config.clip * 2**index

            regions = around_known(request, bounds, top, clip_of, exact=True)
            free = regions[top].free
            if top == 0 or (free is not None and free.any()):
                return regions
            top -= 1

    def _plan(self, request: Request) -> Plan:
        run = self._forecast(request)
        return Plan(
            memory={
                "interpreter and kernels": PROCESS,
                "exemplar": self._kept(),
                "output": max(run.output, self._layout_bytes(request)),
                "scratch": run.scratch,
            },
            disk=prod(request.shape),
        )

    def _plan_spilled(self, request: Request) -> dict[str, int]:
        run, region = self._forecast(request), self._region(request, 0)
        moments = [run.slab, step_slab_bytes(run.shape, self.levels[0].correlations, region.wraps)]
        moments += [round_bytes(slices) for _, slices in self.layouts[self._top(request)].views]
        return {"interpreter and kernels": PROCESS, "exemplar": self._kept(), "slab": max(moments)}

    def _kept(self) -> int:
        """Bytes of the pictures' fields and neighbourhoods."""
        candidates = {id(c): c for level in self.levels for _, c in level.views}.values()
        slices = {id(s): s for layout in self.layouts for _, s in layout.views}.values()
        held = sum(
            c.features.nbytes + c.stack.field.nbytes + 9 * c.allowed.nbytes for c in candidates
        )
        return held + sum(s.features.nbytes for s in slices)

    def _region(self, request: Request, index: int) -> Region:
        """Where a level is made, without what is known there."""
        if request.fixed is None:
            return torus(request, self._top(request), self._least)[index]
        return Region(tuple(-(-side // 2**index) for side in request.shape), request.periodic)

    def _forecast(self, request: Request) -> Run:
        """Of search and vote on the finest level."""
        region, target = self._region(request, 0), self.levels[0].correlations
        run = Run(request, region, self.levels[0].views, distances=True, itemsize=1, repeated=True)
        channels = len(self.levels[0].histograms)
        return replace(
            run, correcting=step_bytes(run.shape, target, region.wraps) + channels * prod(run.shape)
        )

    def _layout_bytes(self, request: Request) -> int:
        """Of sliced rounds: sums in two orders, and components; or of steps between them."""
        top = self._top(request)
        region, layout = self._region(request, top), self.layouts[top]
        channels, voxels = len(layout.histograms), prod(region.shape)
        components = max(slices.basis.vectors.shape[1] for _, slices in layout.views)
        known = (3 + 4 * channels) * voxels * (request.fixed is not None)
        rounds = voxels * (14 * channels + 9 + 2 * components) + max(
            round_bytes(slices) for _, slices in layout.views
        )
        return known + max(
            rounds,
            5 * channels * voxels + step_bytes(region.shape, layout.correlations, region.wraps),
        )


def _fitted(field: np.ndarray, region: Region, *, finer: bool) -> np.ndarray:
    """A field (C, Z, Y, X) int8 on a region, which is `finer` by two or the same."""
    if finer:
        return region.bounded(refined(field, region.wraps, distances=True, shape=region.shape))
    return region.bounded(fit_to(field, region.shape))


def _stage(index: int) -> str:
    """Of the rounds of a level, among those of a run."""
    return f"level {index}"


def _key(request: Request, index: int) -> np.uint64:
    return key(request.seed, f"sliced/{index}")


def _bytes_of(field: np.ndarray, index: int, config: SlicedConfig) -> int:
    """What one start of a picture (C, 1, Y, X) takes on a level."""
    taken = 0
    for width, clip, variance, most, sliced in (
        (config.neighbourhood, config.clip * 2**index, config.variance, config.components, False),
        (config.layout_width, config.layout_clip, 0.95, 64, True),
    ):
        part = thinned(field, index, clip)[0]
        count = principal_basis(
            part, width=width, variance=variance, most=most, flat=True
        ).vectors.shape[1]
        rows = int(np.prod([side - width + 1 for side in part.shape[2:]]))
        taken += rows * (4 << max(2, (count - 1).bit_length()) if sliced else 2 * count + 12)
    return taken


def _top_for(smallest: int, config: SlicedConfig) -> int:
    """The coarsest level at which a picture has room for the neighbourhoods."""
    top, least = 0, max(config.neighbourhood, config.layout_width) + ROOM
    while top + 1 < config.levels and smallest >> (top + 1) >= least:
        top += 1
    return top
