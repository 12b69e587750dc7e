"""Solid texture from pictures by search and vote on the planes of up to three views: what `kopf` and `chen` share.

From coarse to fine, on every level: each view finds for the squares in its planes the nearest ones in its picture; what
overlaps in a voxel, from all views, votes. How votes become the next field is each method's own (`_voted`).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine.plan import Plan
from trabecula.engine.tiles import thread_count
from trabecula.exemplar.views import View, spacing_of
from trabecula.synth.shared.content import Content, content_of
from trabecula.synth.shared.fields import FULL, mean_edge, quantise
from trabecula.synth.shared.histogram import Histogram
from trabecula.synth.shared.matching.grid import features_of, nearest_matches, random_matches, swept
from trabecula.synth.shared.matching.levels import grain_of, levels_for, variance_in
from trabecula.synth.shared.matching.planes import Frame, Plane
from trabecula.synth.shared.matching.region import Region, regions_of
from trabecula.synth.shared.matching.rounds import joined_votes, refined, rematched, robust_weights
from trabecula.synth.shared.matching.sources import Candidates, Stack, carried
from trabecula.synth.shared.neighbourhoods import basis_bytes, block_bytes
from trabecula.synth.shared.orient import oriented, symmetries
from trabecula.synth.shared.pictures import ROOM, PictureMethod, PictureModel
from trabecula.synth.shared.pyramid import fit_to, halve
from trabecula.synth.shared.solid_config import SolidConfig
from trabecula.synth.shared.statistics.correlate import Correlations, corrected, correlations_at, owed
from trabecula.synth.shared.statistics.pairs import Pairs

_PROCESS = 180 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded


@dataclass(frozen=True)
class Level:
    """The pictures at one resolution: the neighbourhoods of every view, and the histograms of all of them together."""

    views: tuple[tuple[int, Candidates], ...]
    histograms: tuple[Histogram, ...]
    correlations: Correlations | None  # where rounds step towards them


@dataclass(frozen=True)
class State:
    """The output at one resolution."""

    matches: tuple[np.ndarray, ...]  # one a view, (sz, sy, sx) int32
    votes: np.ndarray  # (C, Z, Y, X) int16, 256 times what was voted
    field: np.ndarray  # (C, Z, Y, X) int8
    sources: np.ndarray | None = None  # (Z, Y, X) int32, where every voxel was taken from


class Solid(PictureMethod):
    """A method that makes a volume of which planes look like pictures."""

    config: Any

    def _width(self) -> int:
        return int(self.config.neighbourhood)

    def _plan_fit(self, exemplars: Sequence[Image]) -> Plan:
        """Fields and neighbourhoods of the levels learnt so far, and what learning the next one takes beside them."""
        channels, width = channels_of(exemplars), self._width()
        turns = len(symmetries(self.config.orientations, ndim=2))
        size = channels * sum(int(np.prod(image.shape)) for image in exemplars)
        kept, peak = 0, 16 * size
        for index in range(_levels_that_fit(min(min(image.shape) for image in exemplars), self.config)):
            smooth = grain_of(width, smooth=exemplars[0].kind == "labels" and index == 0) == 2
            length = channels * width**2 // (4 if smooth else 1)
            places = [[side // 2**index - width + 1 for side in image.shape] for image in exemplars]
            count = turns * sum(y * x for y, x in places)
            most = min(self.config.components, length)
            features = 2 * most * count
            # A sample of up to 8192 is held twice, of sums over blocks in float64 as well.
            basis = basis_bytes(length, count) + min(8192, count) * length * (12 if smooth else 4)
            rows = features + 8 * count + min(4096, count) * (4 * length + 16 * most)
            peak = max(peak, kept + max(basis, rows))
            kept += features + turns * size // 4**index
        return Plan({"interpreter and kernels": _PROCESS, "fields": 5 * size, "neighbourhoods": peak})


class SolidModel(PictureModel):
    """Pictures as pyramids of fields with the neighbourhoods of every level."""

    config: Any

    def __init__(self, config: SolidConfig, exemplars: Sequence[Image], views: tuple[View, ...]) -> None:
        super().__init__(config, exemplars, views)
        unit = mean_edge(spacing_of(views))
        pictures = [view.image for view in views]
        self.content: Content = content_of(pictures, histogram=config.histogram, unit=unit)
        # Views of the same picture share everything that is learnt from it.
        self.numbers = [next(n for n, other in enumerate(pictures) if other is picture) for picture in pictures]
        fields = {n: self.content.fields(pictures[n]) for n in sorted(set(self.numbers))}
        count = _levels_that_fit(min(min(picture.shape) for picture in pictures), config)
        self.levels: list[Level] = []
        for index in track(range(count), "learning the picture"):
            own = {n: self._quantised(field, index) for n, field in fields.items()}
            made = {n: self._learnt(field, index, pictures[n]) for n, field in own.items()}
            stacks = [made[n].stack.histograms for n in self.numbers]
            histograms = tuple(Histogram.pooled(channel) for channel in zip(*stacks, strict=True))
            seen = tuple((view.axis, made[n]) for view, n in zip(views, self.numbers, strict=True))
            target = None
            if self.content.distances and any(config.corrections):
                deep = [np.moveaxis(own[n], 1, 1 + view.axis) for view, n in zip(views, self.numbers, strict=True)]
                target = correlations_at(deep, index, edges=[e / unit for e in spacing_of(views)], clip=config.clip)
            self.levels.append(Level(seen, histograms, target))
            fields = {n: halve(field) for n, field in fields.items()}

    def _learnt(self, field: np.ndarray, index: int, picture: Image) -> Candidates:
        """The neighbourhoods of one picture (C, 1, y, x) int8 on one level."""
        config = self.config
        turns = symmetries(config.orientations, ndim=2, spacing=picture.spacing)
        stack = Stack.of([oriented(field[:, 0], turn)[:, None] for turn in turns])
        width = config.neighbourhood
        grain = grain_of(width, smooth=index == 0 and self.content.distances)
        return Candidates.of(
            stack,
            width=width,
            step=config.step,
            variance=variance_in(grain, config.variance),
            most=config.components,
            grain=grain,
            k=config.nearest,
            flat=True,
        )

    def _quantised(self, field: np.ndarray, index: int) -> np.ndarray:
        """A field of level `index` in int8: a distance counts in the voxels of its level, a grey value is what it is."""
        if self.content.distances:
            return quantise(field / np.float32(2**index), clip=self.config.clip)
        return quantise(field, clip=FULL)

    def _generate(self, request: Request) -> np.ndarray:
        used = levels_for(request.shape, len(self.levels), width=self.config.neighbourhood)
        regions = regions_of(request, used, self.content.bounds(request, thin=True), self._quantised, thin=True)
        state: State | None = None
        for index in reversed(range(used)):
            level, region = self.levels[index], regions[index]
            frame = Frame.over(region, level.views, self.content.aims(level.histograms, request))
            stage = key(request.seed, f"{self.spec.name}/{index}")
            if state is None:
                state, rounds = self._started(frame, stage), self.config.first_rounds
            else:
                state = self._continued(frame, self.levels[index + 1], state)
                rounds = _at(self.config.rounds, index)
            trims = self._trims(rounds) if index == 0 else [0] * rounds
            steps, sweeps = _at(self.config.corrections, index), _at(self.config.sweeps, index)
            debt = None
            for number in track(range(rounds), f"level {used - index} of {used}"):
                state = self._round(frame, state, stage, number, trims[number], sweeps)
                if level.correlations is not None and steps and request.fixed is None:
                    last = index == 0 and number == rounds - 1
                    debt = None if last else self._owed(frame, state, level.correlations, debt)
                    state = self._corrected(frame, state, level.correlations, debt, steps)
        assert state is not None  # there is at least one level
        return self._delivered(state, request)

    def _trims(self, rounds: int) -> list[int]:
        """How much of a neighbourhood's rim does not vote, round by round of the finest level."""
        trims = [self.config.trim] * rounds
        if not self.content.distances:
            # A mean of grey values loses their grain: in the end every voxel takes one neighbourhood's from each view.
            trims[-2:] = [(self.config.neighbourhood - self.config.step) // 2] * len(trims[-2:])
        return trims

    def _started(self, frame: Frame, stage: np.uint64) -> State:
        """Random patches."""
        matches = tuple(
            random_matches(plane.grid, stage + np.uint64(place)) for place, plane in enumerate(frame.planes)
        )
        weights = [plane.grid.active.astype(np.int32) for plane in frame.planes]
        shape = (len(frame.targets), *frame.region.shape)
        nothing = State(matches, np.zeros(shape, np.int16), np.zeros(shape, np.int8))
        return self._voted(frame, nothing, matches, weights, 0)

    def _continued(self, frame: Frame, coarser: Level, state: State) -> State:
        """The result so far at twice the resolution: its field doubled (a distance doubles too), its matches moved along."""
        region = frame.region
        field = refined(state.field, region.wraps, distances=self.content.distances)
        field = region.bounded(fit_to(field, region.shape))
        matches = tuple(
            carried(match, old, plane.grid.candidates, plane.grid.shape, factor=2)
            for match, (_, old), plane in zip(state.matches, coarser.views, frame.planes, strict=True)
        )
        return State(matches, field.astype(np.int16) * 256, field)

    def _round(self, frame: Frame, state: State, stage: np.uint64, number: int, trim: int, sweeps: int) -> State:
        """Search in every view, then vote."""
        matches, weights = [], []
        for place, (plane, old) in enumerate(zip(frame.planes, state.matches, strict=True)):
            match, distance = self._matched(plane, old, state.field, stage + np.uint64(place), number, sweeps)
            matches.append(match)
            weights.append(robust_weights(plane.grid, distance, self.config.robustness))
        return self._voted(frame, state, tuple(matches), weights, trim)

    def _owed(self, frame: Frame, state: State, target: Correlations, debt: np.ndarray | None) -> np.ndarray:
        """What the steps to come owe the two-point function, of the voxels that are made."""
        return owed(debt, state.field, target, periodic=frame.region.wraps, free=frame.region.free)

    def _corrected(
        self, frame: Frame, state: State, target: Correlations, debt: np.ndarray | None, steps: int
    ) -> State:
        """Steps on the two-point function, of the voxels that are made."""
        votes, field, region = state.votes, state.field, frame.region
        for _ in range(steps):
            votes = corrected(field, target, debt=debt, periodic=region.wraps, free=region.free)
            field = rematched(region, votes, frame.targets)
        return replace(state, votes=votes, field=field)

    def _matched(
        self, plane: Plane, old: np.ndarray, field: np.ndarray, stage: np.uint64, number: int, sweeps: int
    ) -> tuple[np.ndarray, np.ndarray]:
        config = self.config
        seen = plane.turned(field)
        if config.search == "exact":
            return nearest_matches(plane.grid, old, features_of(plane.grid, seen), index_penalty=config.index_penalty)
        return swept(
            plane.grid,
            old,
            seen,
            stage=stage,
            first=number * sweeps + 1,
            count=sweeps,
            tries=config.tries,
            index_penalty=config.index_penalty,
        )

    def _made(self, frame: Frame, matches: tuple[np.ndarray, ...], votes: np.ndarray) -> State:
        """Votes as the next state: joined to what is known, with the histograms asked for."""
        votes = joined_votes(frame.region, votes)
        return State(matches, votes, rematched(frame.region, votes, frame.targets if self.config.histogram else None))

    @abstractmethod
    def _voted(
        self, frame: Frame, state: State, matches: tuple[np.ndarray, ...], weights: Sequence[np.ndarray], trim: int
    ) -> State:
        """The state after a vote of the matches; `state` is the one before."""

    def _delivered(self, state: State, request: Request) -> np.ndarray:
        inside = (slice(None), *(slice(side) for side in request.shape))
        return self.content.delivered(np.ascontiguousarray(state.votes[inside]), request)

    def _plan(self, request: Request) -> Plan:
        # Views of one picture share its candidates; the exact search holds their features once more, in another order.
        candidates = {id(c): c for level in self.levels for _, c in level.views}.values()
        own = 3 if self.config.search == "exact" else 1
        finest = max((c for _, c in self.levels[0].views), key=lambda c: c.features.shape[1])
        width, step = finest.basis.width, finest.step
        region = Region(request.shape, request.periodic)
        shape = region.covered(box=(width,) * 3, steps=(step,) * 3).shape
        voxels, sites = int(np.prod(shape, dtype=np.int64)), 0
        scratch = 0
        for axis, seen in self.levels[0].views:
            grid = region.seen(axis).grid(box=seen.basis.box, steps=seen.steps)
            sites = max(sites, int(np.prod(grid, dtype=np.int64)))
            scratch = max(scratch, block_bytes(seen.basis, grid))
        channels, views = len(finest.stack.field), len(self.views)
        vote = voxels * self._bytes(channels, request) + sites * (2 * finest.features.shape[1] + 12 * views + 12)
        target = self.levels[0].correlations
        step = 0
        if target is not None and request.fixed is None:
            pairs = Pairs(shape, target.r_max, request.periodic, target.edges)
            step = 16 * int(np.prod(pairs.sides, dtype=np.int64)) + 8 * voxels * (1 + channels) + 4 * sites * views
            step += 24 * int(np.prod([len(along) for along in pairs.offsets]))
        return Plan(
            memory={
                "interpreter and kernels": _PROCESS,
                "exemplar": sum(
                    own * c.features.nbytes + c.stack.field.nbytes + 9 * c.allowed.nbytes for c in candidates
                ),
                "output": max(vote, step),
                "scratch": thread_count() * scratch + 16 * len(finest.features),
            },
            disk=int(np.prod(request.shape, dtype=np.int64)),
        )

    def _bytes(self, channels: int, request: Request) -> int:
        """Memory per voxel of the output, in a vote."""
        parts = 6 * (request.mask is not None or request.fixed is not None)
        parts += 12 * channels * (request.fixed is not None)
        return 18 * channels + 8 + parts


def channels_of(exemplars: Sequence[Image]) -> int:
    """Channels of the fields of images."""
    first = exemplars[0]
    if first.kind != "labels":
        return 3 if first.kind == "colour" else 1
    present = len(np.unique(np.concatenate([np.unique(exemplar.values) for exemplar in exemplars])))
    return 1 if present == 2 else present


def _at(counts: tuple[int, ...], index: int) -> int:
    """What a setting says of a level: finest first, the last counts for the rest."""
    return counts[min(index, len(counts) - 1)]


def _levels_that_fit(smallest: int, config: SolidConfig) -> int:
    """Resolutions at which a picture has room for a neighbourhood."""
    count = 1
    while count < config.levels and smallest // 2**count >= config.neighbourhood + ROOM:
        count += 1
    return count
