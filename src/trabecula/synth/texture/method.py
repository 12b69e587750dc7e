"""`texture`: fit keeps the exemplars' pyramid, generate optimises the output level by level.

Per level: random patches (coarsest) or the doubled result, then rounds of search (nearest neighbourhood of the exemplar
for each of a sparse grid), vote (robust mean of what overlaps) and histogram matching. The fields of labels are clipped
signed distances, so the last threshold is exact.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine.plan import Plan
from trabecula.engine.tiles import thread_count
from trabecula.synth.base import Method, Model
from trabecula.synth.shared.fields import FULL, quantise
from trabecula.synth.shared.neighbourhoods import basis_bytes, block_bytes
from trabecula.synth.shared.pyramid import double, fit_to, halve
from trabecula.synth.texture import SPEC
from trabecula.synth.texture.balance import Balance, balanced
from trabecula.synth.texture.config import TextureConfig
from trabecula.synth.texture.content import Content, content_of
from trabecula.synth.texture.kernels import start_matches
from trabecula.synth.texture.optimise import (
    Grid,
    State,
    cast,
    features_of,
    joined_votes,
    nearest_matches,
    rematched,
    robust_weights,
    searched,
)
from trabecula.synth.texture.orient import oriented, symmetries
from trabecula.synth.texture.region import Region, regions_of
from trabecula.synth.texture.sources import Candidates, Stack, carried

_PROCESS = 180 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded
_WIDE = 8  # voxels: a neighbourhood that is described by enough blocks
_BLOCKS_MISS = 0.4  # of the variance that may be dropped, the share that is left for sums over blocks
_ROOM = 4  # positions that a neighbourhood needs along an axis of the exemplar, at least, on any level
_SPARSE_BELOW = 4  # a coarsest level at less than this scale is too large for neighbourhoods at every voxel
_WIDTHS = 2.75  # neighbourhoods that lie side by side in the output on its coarsest level, at least


class Texture(Method):
    """3-D exemplar optimisation."""

    spec = SPEC
    config_type = TextureConfig

    def _fit(self, exemplars: Sequence[Image]) -> TextureModel:
        width = max(self.config.neighbourhood)
        for exemplar in exemplars:
            if min(exemplar.shape) < width + _ROOM:
                raise InputError(
                    f"the exemplar is {exemplar.shape}, a neighbourhood of {width} needs at least {width + _ROOM} "
                    "voxels along every axis: give a larger exemplar, or a smaller neighbourhood"
                )
        return TextureModel(self.config, exemplars)

    def _plan_fit(self, exemplars: Sequence[Image]) -> Plan:
        """The principal components, and the finest level's fields and candidates."""
        channels = _channels(exemplars)
        size = sum(
            exemplar.values[..., 0].size if exemplar.kind == "colour" else exemplar.values.size
            for exemplar in exemplars
        )
        fields = size * (14 + 11 * channels)
        width = max(self.config.neighbourhood)
        # Of the second level, where neighbourhoods are described in full.
        count = sum(int(np.prod([max(1, side // 2 - width + 1) for side in exemplar.shape])) for exemplar in exemplars)
        basis = basis_bytes(channels * width**3, count)
        return Plan({"interpreter and kernels": _PROCESS, "fields": fields, "basis": basis})


@dataclass(frozen=True)
class Level:
    """The exemplars at one resolution, and their neighbourhoods of every width."""

    stack: Stack
    candidates: tuple[Candidates, ...]  # one per width of the config


class TextureModel(Model):
    """Exemplars as a pyramid of fields with the neighbourhoods of every level."""

    spec = SPEC
    config: TextureConfig

    def __init__(self, config: TextureConfig, exemplars: Sequence[Image]) -> None:
        super().__init__(config, exemplars)
        self.content: Content = content_of(exemplars, field=config.field, histogram=config.histogram)
        turns = symmetries(config.orientations, spacing=exemplars[0].spacing)
        fields = [self.content.fields(exemplar) for exemplar in exemplars]
        pyramid = [[oriented(field, turn) for field in fields for turn in turns]]
        smallest = min(min(exemplar.shape) for exemplar in exemplars)
        for _ in range(_levels_that_fit(smallest, config) - 1):
            pyramid.append([halve(field) for field in pyramid[-1]])
        self.levels = [
            self._level([self._quantised(field, index) for field in fields], finest=index == 0)
            for index, fields in track(list(enumerate(pyramid)), "learning the exemplar")
        ]

    def _quantised(self, field: np.ndarray, index: int) -> np.ndarray:
        """A field of level `index` in int8: a distance counts in the voxels of its level, a grey value is what it is."""
        if self.content.distances:
            return quantise(field / np.float32(2**index), clip=self.config.clip)
        return quantise(field, clip=FULL)

    def _level(self, fields: list[np.ndarray], *, finest: bool) -> Level:
        config, stack = self.config, Stack.of(fields)
        made = []
        for width in config.neighbourhood:
            # On the finest level distances are so smooth that ten components hold them, and those of blocks are nearly the
            # same ones; what varies within a block is missing from the variance that they share.
            grain = 2 if finest and self.content.distances and width >= _WIDE and width % 2 == 0 else 1
            share = config.variance if grain == 1 else 1 - (1 - config.variance) * _BLOCKS_MISS
            made.append(
                Candidates.of(
                    stack,
                    width=width,
                    step=config.step_of(width),
                    variance=share,
                    most=config.components,
                    grain=grain,
                    k=config.nearest,
                )
            )
        return Level(stack, tuple(made))

    def _generate(self, request: Request) -> tuple[np.ndarray, dict[str, Any]]:
        used = _levels_for(request.shape, len(self.levels), max(self.config.neighbourhood))
        regions = self._regions(request, used)
        state: State | None = None
        before: Candidates | None = None
        told: list[dict[str, Any]] = []
        for index in reversed(range(used)):
            first = index == used - 1
            for number, candidates in enumerate(self.levels[index].candidates):
                if first and 2**index >= _SPARSE_BELOW and self.config.step:
                    candidates = replace(candidates, step=1)
                grid = Grid.over(regions[index], candidates)
                stage = key(request.seed, f"texture/{index}" + (f"/{number}" if number else ""))
                if state is None or before is None:
                    begin = partial(self._started, grid, stage)
                else:
                    begin = partial(self._continued, grid, before, state, finer=number == 0)
                state, trace = self._optimise(grid, begin, stage, index=index, first=first, used=used)
                told += [{"level": index, "width": candidates.basis.width, "energy": trace}] if trace else []
                before = candidates
        assert state is not None  # there is at least one level
        inside = (slice(None), *(slice(side) for side in request.shape))
        votes = np.ascontiguousarray(state.votes[inside])
        return self.content.delivered(votes, request), {"levels": told} if told else {}

    def _regions(self, request: Request, used: int) -> list[Region]:
        bounds = self.content.bounds(request)
        return regions_of(request, used, None if bounds is None else bounds, self._quantised)

    def _started(self, grid: Grid, stage: np.uint64) -> State:
        """Random patches."""
        candidates = grid.candidates
        match = np.empty(grid.shape, np.int32)
        start_matches(match, len(candidates.numbers), stage)
        match = candidates.numbers[match].astype(np.int32)
        return cast(grid, match, grid.active.astype(np.int32))

    def _continued(self, grid: Grid, before: Candidates, state: State, *, finer: bool) -> State:
        """The result so far on the next grid: its field doubled (a distance doubles too), its matches moved along."""
        field, region = state.field, grid.region
        if finer:
            field = double(field, region.wraps)
            if self.content.distances:
                field = np.clip(field.astype(np.int16) * 2, -FULL, FULL).astype(np.int8)
        field = region.bounded(fit_to(field, region.shape))
        match = carried(state.match, before, grid.candidates, grid.shape, factor=2 if finer else 1)
        return State(match, field.astype(np.int16) * 256, field)

    def _optimise(
        self, grid: Grid, begin: Callable[[], State], stage: np.uint64, *, index: int, first: bool, used: int
    ) -> tuple[State, list[dict[str, Any]]]:
        config = self.config
        rounds = config.first_rounds if first else config.rounds[min(index, len(config.rounds) - 1)]
        balance = Balance.at_first(config, rounds)
        state = begin()  # here, so that nobody else holds on to it
        for number in track(range(rounds), f"level {used - index} of {used}"):
            match, distance = self._search(grid, state, stage, number)
            trim = self._trim(grid, index, last=number >= rounds - 2)
            if config.energetic:
                votes, balance = balanced(grid, state.field, match, balance, config, trim=trim)
                del state
                votes = joined_votes(grid, votes)
                state = State(match, votes, rematched(grid, votes, histogram=config.histogram))
                if balance.feedback.done:
                    break
            else:
                del state
                weights = robust_weights(grid, distance, config.robustness)
                state = cast(grid, match, weights, trim=trim, histogram=config.histogram)
        return state, balance.trace()

    def _search(self, grid: Grid, state: State, stage: np.uint64, number: int) -> tuple[np.ndarray, np.ndarray]:
        config = self.config
        features = features_of(grid, state.field)
        match = state.match
        if config.search == "exact":
            return nearest_matches(grid, match, features, index_penalty=config.index_penalty)
        for sweep in range(config.sweeps):
            match, distance = searched(
                grid,
                match,
                features,
                stage=stage,
                sweep=number * config.sweeps + sweep + 1,
                tries=config.tries,
                index_penalty=config.index_penalty,
            )
        return match, distance

    def _trim(self, grid: Grid, index: int, *, last: bool) -> int:
        """How much of a neighbourhood's rim does not vote."""
        if index > 0:
            return 0
        if last and not self.content.distances:
            # A mean of grey values loses their grain: in the end every voxel takes one neighbourhood's.
            return (grid.candidates.basis.width - grid.candidates.step) // 2
        return self.config.trim

    def _check_request(self, request: Request) -> None:
        super()._check_request(request)
        width = min(self.config.neighbourhood)
        if request.mask is not None and not _has_room(request.mask, width):
            raise RequestError(
                f"the mask nowhere has room for a neighbourhood of {width} voxels: voxelise it at a finer spacing, or "
                "choose a smaller neighbourhood (--set neighbourhood=4)"
            )

    def _plan(self, request: Request) -> Plan:
        finest = self.levels[0].candidates[-1]
        region = Region(request.shape, request.periodic)
        width, step = finest.basis.width, finest.step
        grid, shape = region.grid(width=width, step=step), region.covered(width=width, step=step).shape
        voxels = int(np.prod(shape, dtype=np.int64))
        sites = int(np.prod(grid, dtype=np.int64))
        channels, dimensions = len(finest.stack.field), finest.features.shape[1]
        parts = 6 * (request.mask is not None or request.fixed is not None) + 12 * channels * (
            request.fixed is not None
        )
        # Three moments compete for the peak: a search, a histogram match, and the last choice.
        searching = voxels * (3 * channels + parts) + sites * (2 * dimensions + 20)
        matching = voxels * (4 * channels + 2 + parts) + sites * 12
        choosing = voxels * (20 * channels + 10 if self.content.distances and channels > 1 else 6 * channels + 12)
        return Plan(
            memory={
                "interpreter and kernels": _PROCESS,
                "exemplar": sum(
                    level.stack.field.nbytes + sum(c.features.nbytes + 9 * c.allowed.nbytes for c in level.candidates)
                    for level in self.levels
                ),
                "output": max(searching, matching, choosing),
                "scratch": thread_count() * block_bytes(finest.basis, grid) + 16 * len(finest.features),
            },
            disk=int(np.prod(request.shape, dtype=np.int64)),  # uncompressed; most formats take a tenth
        )


def _channels(exemplars: Sequence[Image]) -> int:
    first = exemplars[0]
    if first.kind != "labels":
        return 3 if first.kind == "colour" else 1
    present = len(np.unique(np.concatenate([np.unique(exemplar.values) for exemplar in exemplars])))
    return 1 if present == 2 else present


def _levels_that_fit(smallest: int, config: TextureConfig) -> int:
    """Resolutions at which the exemplar has room for the widest neighbourhood."""
    count = 1
    while count < config.levels and smallest // 2**count >= max(config.neighbourhood) + _ROOM:
        count += 1
    return count


def _levels_for(shape: tuple[int, ...], most: int, width: int) -> int:
    """Resolutions at which the output is some neighbourhoods wide: else the first rounds would copy the exemplar whole."""
    side = float(np.prod(shape, dtype=np.float64)) ** (1 / len(shape))
    count = 1
    while count < most and side / 2**count >= _WIDTHS * width:
        count += 1
    return count


def _has_room(mask: np.ndarray, width: int) -> bool:
    """Whether a cube of `width` voxels fits into a mask (one that is thinner along an axis may fill that axis)."""
    room = mask
    for axis, side in enumerate(mask.shape):
        sums = np.cumsum(room, axis=axis, dtype=np.int32)
        sums = np.concatenate([np.zeros_like(sums.take([0], axis)), sums], axis)
        reach = min(width, side)
        cells = np.arange(side - reach + 1)
        room = sums.take(cells + reach, axis) - sums.take(cells, axis) == reach
    return bool(room.any())
