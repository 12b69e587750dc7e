"""Solid texture from pictures by search and vote on the planes of up to three views: what `kopf`
and `chen` share.

From coarse to fine, on every level: each view finds for the squares in its planes the nearest ones
in its picture; what overlaps in a voxel, from all views, votes. How votes become the next field is
each method's own (`_vote`).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import Any, ClassVar

import numpy as np

from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine import memmap
from trabecula.engine.checkpoint import resume
from trabecula.engine.memory import Plan
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
from trabecula.synth.shared.orient import oriented, symmetries
from trabecula.synth.shared.pictures import PictureModel
from trabecula.synth.shared.pyramid import fit_to, halve
from trabecula.synth.shared.solid_config import SolidConfig
from trabecula.synth.shared.solid_fit import PROCESS, levels_that_fit
from trabecula.synth.shared.solid_forecast import Run
from trabecula.synth.shared.solid_state import State, even_weights
from trabecula.synth.shared.statistics.correlate import (
    Correlations,
    corrected,
    correlations_at,
    owed,
    step_bytes,
    step_slab_bytes,
)
from trabecula.synth.shared.votes import votes_of


@dataclass(frozen=True)
class Level:
    """The pictures at one resolution: the neighbourhoods of every view, and the histograms of all
    of them together.
    """

    views: tuple[tuple[int, Candidates], ...]
    histograms: tuple[Histogram, ...]
    correlations: Correlations | None  # where rounds step towards them


class SolidModel(PictureModel):
    """Pictures as pyramids of fields with the neighbourhoods of every level."""

    spills: ClassVar[bool] = True
    config: Any

    def __init__(
        self, config: SolidConfig, exemplars: Sequence[Image], views: tuple[View, ...]
    ) -> None:
        super().__init__(config, exemplars, views)
        unit = mean_edge(spacing_of(views))
        pictures = [view.image for view in views]
        self.content: Content = content_of(pictures, histogram=config.histogram, unit=unit)
        # Views of the same picture share everything that is learnt from it.
        self.numbers = [
            next(n for n, other in enumerate(pictures) if other is picture) for picture in pictures
        ]
        fields = {n: self.content.fields(pictures[n]) for n in sorted(set(self.numbers))}
        count = levels_that_fit(min(min(picture.shape) for picture in pictures), config)
        self.levels: list[Level] = []
        for index in track(range(count), "learning the picture"):
            own = {n: self._quantised(field, index) for n, field in fields.items()}
            made = {n: self._learnt(field, index, pictures[n]) for n, field in own.items()}
            stacks = [made[n].stack.histograms for n in self.numbers]
            histograms = tuple(Histogram.pooled(channel) for channel in zip(*stacks, strict=True))
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
        """A field of level `index` in int8: a distance counts in the voxels of its level, a grey
        value is what it is.
        """
        if self.content.distances:
            return quantise(field / np.float32(2**index), clip=self.config.clip)
        return quantise(field, clip=FULL)

    def make(self, request: Request) -> np.ndarray:
        used = levels_for(request.shape, len(self.levels), width=self.config.neighbourhood)
        regions = regions_of(
            request, used, self.content.bounds(request, thin=True), self._quantised, thin=True
        )
        state, begin, done = self._resumed(used)
        del regions[begin + 1 :]
        while regions:
            index = len(regions) - 1
            level = self.levels[index]
            frame = Frame.over(
                regions.pop(), level.views, self.content.aims(level.histograms, request)
            )
            if state is None:
                state = self._started(frame, self._key(request, index))
            elif index < begin:
                state, done = self._continued(frame, self.levels[index + 1], state), 0
            self._run(frame, state, index, used, request, done)
        assert state is not None  # there is at least one level
        return self._delivered(state, request)

    def _resumed(self, used: int) -> tuple[State | None, int, int]:
        """The state that an interrupted run left, its level and its rounds done; none, and the
        coarsest level.
        """
        for index in range(used):
            left = resume(_stage(index))
            if left is not None:
                return State.of(left.arrays), index, left.number
        return None, used - 1, 0

    def _key(self, request: Request, index: int) -> np.uint64:
        return key(request.seed, f"{self.capabilities.name}/{index}")

    def _run(
        self, frame: Frame, state: State, index: int, used: int, request: Request, done: int
    ) -> None:
        """The rounds of a level from round `done` on."""
        config, target = self.config, self.levels[index].correlations
        rounds = config.first_rounds if index == used - 1 else _at(config.rounds, index)
        trims = self._trims(rounds) if index == 0 else [0] * rounds
        steps, sweeps = _at(config.corrections, index), _at(config.sweeps, index)
        for number in track(range(done, rounds), f"level {used - index} of {used}"):
            self._round(frame, state, self._key(request, index), number, trims[number], sweeps)
            if target is not None and steps and request.fixed is None:
                last = index == 0 and number == rounds - 1
                state.debt = None if last else self._owed(frame, state, target)
                self._correct(frame, state, target, steps)
            state.offer(_stage(index), number + 1)

    def _trims(self, rounds: int) -> list[int]:
        """How much of a neighbourhood's rim does not vote, round by round of the finest level."""
        trims = [self.config.trim] * rounds
        if not self.content.distances:
            # A mean of grey values loses their grain: in the end every voxel takes one
            # neighbourhood's from each view.
            trims[-2:] = [(self.config.neighbourhood - self.config.step) // 2] * len(trims[-2:])
        return trims

    def _started(self, frame: Frame, stage: np.uint64) -> State:
        """Random patches."""
        matches = [
            random_matches(plane.grid, stage + np.uint64(place))
            for place, plane in enumerate(frame.planes)
        ]
        shape = (len(frame.targets), *frame.region.shape)
        state = State(matches, memmap.zeros(shape, np.int16), memmap.zeros(shape, np.int8))
        self._vote(frame, state, [even_weights(plane.grid.active) for plane in frame.planes], 0)
        return state

    def _continued(self, frame: Frame, coarser: Level, state: State) -> State:
        """The result so far at twice the resolution: its field doubled (a distance doubles too),
        its matches moved along.
        """
        region = frame.region
        field = refined(
            state.field, region.wraps, distances=self.content.distances, shape=region.shape
        )
        field = region.bounded(field)
        matches = [
            carried(match, old, plane.grid.candidates, plane.grid.shape, factor=2)
            for match, (_, old), plane in zip(
                state.matches, coarser.views, frame.planes, strict=True
            )
        ]
        return State(matches, votes_of(field), field)

    def _round(
        self, frame: Frame, state: State, stage: np.uint64, number: int, trim: int, sweeps: int
    ) -> None:
        """Search in every view, then vote."""
        weights = []
        for place, plane in enumerate(frame.planes):
            old = state.matches[place]
            match, distance = self._matched(
                plane, old, state.field, stage + np.uint64(place), number, sweeps
            )
            state.matches[place] = match
            weights.append(robust_weights(plane.grid, distance, self.config.robustness))
            del old, match, distance
        self._vote(frame, state, weights, trim)

    def _owed(self, frame: Frame, state: State, target: Correlations) -> np.ndarray:
        """What the steps to come owe the two-point function, of the voxels that are made."""
        return owed(
            state.debt, state.field, target, periodic=frame.region.wraps, free=frame.region.free
        )

    def _correct(self, frame: Frame, state: State, target: Correlations, steps: int) -> None:
        """Steps on the two-point function, of the voxels that are made."""
        region = frame.region
        for _ in range(steps):
            state.votes = corrected(
                state.field, target, debt=state.debt, periodic=region.wraps, free=region.free
            )
            state.field = rematched(region, state.votes, frame.targets)

    def _matched(
        self,
        plane: Plane,
        old: np.ndarray,
        field: np.ndarray,
        stage: np.uint64,
        number: int,
        sweeps: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        config = self.config
        seen = plane.turned(field)
        if config.search == "exact":
            return nearest_matches(
                plane.grid, old, features_of(plane.grid, seen), index_penalty=config.index_penalty
            )
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

    def _make(self, frame: Frame, state: State, votes: np.ndarray) -> None:
        """Votes as the next state: joined to what is known, with the histograms asked for."""
        state.votes = joined_votes(frame.region, votes)
        state.field = rematched(
            frame.region, state.votes, frame.targets if self.config.histogram else None
        )

    @abstractmethod
    def _vote(self, frame: Frame, state: State, weights: Sequence[np.ndarray], trim: int) -> None:
        """Bring the state to what its matches vote for, with these weights (sz, sy, sx) int32, one
        a view.
        """

    def _delivered(self, state: State, request: Request) -> np.ndarray:
        return self.content.delivered(fit_to(state.votes, request.shape), request)

    def _plan(self, request: Request) -> Plan:
        run = self._forecast(request)
        return Plan(
            memory={
                "interpreter and kernels": PROCESS,
                "exemplar": self._kept(),
                "output": run.output,
                "scratch": run.scratch,
            },
            disk=prod(request.shape) * run.itemsize,
        )

    def _plan_spilled(self, request: Request) -> dict[str, int]:
        run, target = self._forecast(request), self.levels[0].correlations
        slab = run.slab
        if run.correcting and target is not None:
            slab = max(slab, step_slab_bytes(run.shape, target, request.periodic))
        return {"interpreter and kernels": PROCESS, "exemplar": self._kept(), "slab": slab}

    def _kept(self) -> int:
        """Bytes of the pictures' fields and neighbourhoods."""
        # Views of one picture share its candidates; the exact search holds their features once
        # more, in another order.
        candidates = {id(c): c for level in self.levels for _, c in level.views}.values()
        own = 3 if self.config.search == "exact" else 1
        return sum(
            own * c.features.nbytes + c.stack.field.nbytes + 9 * c.allowed.nbytes
            for c in candidates
        )

    def _forecast(self, request: Request) -> Run:
        target = self.levels[0].correlations
        run = Run(
            request,
            Region(request.shape, request.periodic),
            self.levels[0].views,
            distances=self.content.distances,
            itemsize=self.dtype.itemsize * (3 if self.facts[0].kind == "colour" else 1),
            chosen=self._chooses,
            exact=self.config.search == "exact",
            repeated=_at(self.config.sweeps, 0) > 1,
        )
        if target is None or request.fixed is not None or not _at(self.config.corrections, 0):
            return run
        return replace(run, correcting=step_bytes(run.shape, target, request.periodic))

    @property
    def _chooses(self) -> bool:
        """Whether voxels become pixels of the pictures."""
        return False


def _stage(index: int) -> str:
    """Of the rounds of a level, among those of a run."""
    return f"level {index}"


def _at(counts: tuple[int, ...], index: int) -> int:
    """What a setting says of a level: finest first, the last counts for the rest."""
    return counts[min(index, len(counts) - 1)]
