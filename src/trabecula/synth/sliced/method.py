"""`sliced`: fit keeps what the pictures say at every resolution; generate lays out the coarsest, then refines level by level.

Sliced rounds (`layout`) move the neighbourhoods in the planes of the views towards the distribution of the picture's; they copy
nothing, and see far because they work on a coarse grid. Search and vote (`passes`) then make interfaces and thin walls those of
the picture. Steps on the two-point function go along with both.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine.plan import Plan
from trabecula.engine.tiles import thread_count
from trabecula.exemplar.views import View, spacing_of
from trabecula.synth.shared.content import Content, content_of
from trabecula.synth.shared.fields import mean_edge
from trabecula.synth.shared.matching.planes import Frame
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import refined
from trabecula.synth.shared.neighbourhoods import basis_bytes, block_bytes, principal_basis
from trabecula.synth.shared.orient import symmetries
from trabecula.synth.shared.pictures import ROOM, PictureMethod, PictureModel
from trabecula.synth.shared.pyramid import fit_to
from trabecula.synth.shared.solid import channels_of
from trabecula.synth.shared.statistics.pairs import Pairs
from trabecula.synth.sliced import SPEC
from trabecula.synth.sliced.aims import Layout, Level, Pictures, leaning, thinned
from trabecula.synth.sliced.config import SlicedConfig
from trabecula.synth.sliced.domain import around_known, torus
from trabecula.synth.sliced.layout import laid_out
from trabecula.synth.sliced.passes import passed
from trabecula.synth.sliced.specks import without_specks

_PROCESS = 180 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded
_LEAST = 8  # voxels that the result needs along every axis on the level that is laid out
_SAME = 1e-6
_AXES = "zyx"


class Sliced(PictureMethod):
    """Sliced transport and two-point steps, then search and vote."""

    spec = SPEC
    config_type = SlicedConfig
    config: SlicedConfig

    def _width(self) -> int:
        return max(self.config.neighbourhood, self.config.layout_width)

    def _learn(self, exemplars: Sequence[Image], views: tuple[View, ...]) -> SlicedModel:
        return SlicedModel(self.config, exemplars, views)

    def _plan_fit(self, exemplars: Sequence[Image]) -> Plan:
        """Features of every level, counted in components of the pictures as they are, and the components' sample."""
        config, channels = self.config, channels_of(exemplars)
        alone = len(exemplars) == 1 and len(config.views) != 2
        chosen = ("all" if alone else "none") if config.orientations == "auto" else config.orientations
        turns = len(symmetries(chosen, ndim=2))
        content = content_of(exemplars)
        features = 0
        for index in range(1 + _top_for(min(min(image.shape) for image in exemplars), config)):
            for image in exemplars:
                features += turns * 4**index * _bytes_of(content.fields(image), index, config)
        basis = basis_bytes(
            channels * self._width() ** 2, turns * sum(int(np.prod(image.shape)) for image in exemplars)
        )
        return Plan({"interpreter and kernels": _PROCESS, "features": features, "basis": basis})


class SlicedModel(PictureModel):
    """What the pictures say at every resolution."""

    spec = SPEC
    config: SlicedConfig

    def __init__(self, config: SlicedConfig, exemplars: Sequence[Image], views: tuple[View, ...]) -> None:
        super().__init__(config, exemplars, views)
        spacing = spacing_of(views)
        self.content: Content = content_of([view.image for view in views], unit=mean_edge(spacing))
        fields = {view.picture: self.content.fields(view.image) for view in views}
        chosen = config.orientations
        if chosen == "auto":
            alone = len(fields) == 1 and len(views) == 3 and max(spacing) <= min(spacing) * (1 + _SAME)
            chosen = "all" if alone else "none"
        pictures = Pictures(fields, views, chosen)
        self.top = _top_for(min(min(view.image.shape) for view in views), config)
        indices = range(self.top + 1)
        self.levels: list[Level] = [pictures.level(index, config) for index in track(indices, "learning the picture")]
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

    def _generate(self, request: Request) -> np.ndarray:
        config, regions = self.config, self._regions(request)
        top = len(regions) - 1
        layout = self.layouts[top]
        field = laid_out(layout, regions[top], self.content.aims(layout.histograms, request), request.seed, config)
        votes = field.astype(np.int16) * np.int16(256)
        for index in reversed(range(top + 1)):
            if index < top:
                field = refined(field, regions[index].wraps, distances=True)
            elif top and request.fixed is None:
                continue  # the layout is made of coarse neighbourhoods already
            field, votes = self._passed(field, regions[index], index, request)
        inside = (slice(None), *(slice(side) for side in request.shape))
        votes = np.ascontiguousarray(votes[inside])
        del field
        values = self.content.delivered(votes, request)
        if config.specks:
            votes = without_specks(votes, values, self.content.present, config.specks)  # type: ignore[attr-defined]
            values = self.content.delivered(votes, request)
        return values

    def _passed(self, field: np.ndarray, region: Region, index: int, request: Request) -> tuple[np.ndarray, np.ndarray]:
        """Search and vote on one level."""
        config, level = self.config, self.levels[index]
        frame = Frame.over(region, level.views, self.content.aims(level.histograms, request))
        field = frame.region.bounded(fit_to(field, frame.region.shape))
        return passed(
            frame,
            field,
            leaning(level.correlations, level.histograms, frame.targets, softness=1.0),
            config,
            stage=key(request.seed, f"sliced/{index}"),
            rounds=config.rounds[min(index, len(config.rounds) - 1)],
            steps=config.corrections[min(index, len(config.corrections) - 1)],
            said=f"level {index}",
        )

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
        candidates = {id(c): c for level in self.levels for _, c in level.views}.values()
        slices = {id(s): s for layout in self.layouts for _, s in layout.views}.values()
        finest = max((c for _, c in self.levels[0].views), key=lambda c: c.features.shape[1])
        top = self._top(request)
        region = (
            torus(request, top, self._least)[0] if request.fixed is None else Region(request.shape, request.periodic)
        )
        width, step = finest.basis.width, finest.step
        shape = region.covered(box=(width,) * 3, steps=(step,) * 3).shape
        voxels = int(np.prod(shape, dtype=np.int64))
        sites = max(
            int(np.prod(region.seen(axis).grid(box=c.basis.box, steps=c.steps), dtype=np.int64))
            for axis, c in self.levels[0].views
        )
        scratch = max(
            block_bytes(c.basis, region.seen(axis).grid(box=c.basis.box, steps=c.steps))
            for axis, c in self.levels[0].views
        )
        channels, views = len(finest.stack.field), len(self.views)
        known = voxels * (6 + 24 * channels) * (request.fixed is not None)
        target = self.levels[0].correlations
        pairs = Pairs(shape, target.r_max, region.wraps, target.edges)
        offsets = int(np.prod([len(along) for along in pairs.offsets]))
        widest = max(s.features.shape[1] for _, s in self.layouts[top].views)
        # Of several threads a quarter of the neighbourhoods is put back at any time, of one all.
        rebuilt = 16 * channels * self.config.layout_width**2 / (4 if thread_count() > 1 else 1)
        moments = [
            voxels * (14 * channels + 10) + sites * (2 * finest.features.shape[1] + 12 * views + 12),
            16 * int(np.prod(pairs.sides, dtype=np.int64))
            + 24 * offsets
            + 10 * voxels * (1 + channels)
            + 4 * sites * views,
            round((90 + 19 * widest + rebuilt) * voxels / 8**top),
        ]
        return Plan(
            memory={
                "interpreter and kernels": _PROCESS,
                "exemplar": sum(c.features.nbytes + c.stack.field.nbytes + 9 * c.allowed.nbytes for c in candidates)
                + sum(s.features.nbytes for s in slices),
                "output": max(moments) + known,
                "scratch": thread_count() * scratch + 16 * len(finest.features),
            },
            disk=int(np.prod(request.shape, dtype=np.int64)),
        )


def _bytes_of(field: np.ndarray, index: int, config: SlicedConfig) -> int:
    """What one start of a picture (C, 1, Y, X) takes on a level."""
    taken = 0
    for width, clip, variance, most, sliced in (
        (config.neighbourhood, config.clip * 2**index, config.variance, config.components, False),
        (config.layout_width, config.layout_clip, 0.95, 64, True),
    ):
        part = thinned(field, index, clip)[0]
        count = principal_basis(part, width=width, variance=variance, most=most, flat=True).vectors.shape[1]
        rows = int(np.prod([side - width + 1 for side in part.shape[2:]]))
        taken += rows * (4 << max(2, (count - 1).bit_length()) if sliced else 2 * count + 12)
    return taken


def _top_for(smallest: int, config: SlicedConfig) -> int:
    """The coarsest level at which a picture has room for the neighbourhoods."""
    top, least = 0, max(config.neighbourhood, config.layout_width) + ROOM
    while top + 1 < config.levels and smallest >> (top + 1) >= least:
        top += 1
    return top
