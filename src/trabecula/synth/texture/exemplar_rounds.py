"""Search and vote from random patches to the finest level: the paper's way, and `novelty` 0."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine.checkpoint import Checkpoint as Left
from trabecula.engine.checkpoint import resume
from trabecula.synth.shared.matching.grid import Grid
from trabecula.synth.shared.matching.levels import grain_of, variance_in
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Candidates, Stack
from trabecula.synth.shared.statistics.correlate import Correlations
from trabecula.synth.texture.config import TextureConfig
from trabecula.synth.texture.graded import leaning_grid, settled
from trabecula.synth.texture.search_vote import Course, Run

# a coarsest level at less than this scale is too large for neighbourhoods at every voxel
_SPARSE_BELOW = 4

Level = tuple[Candidates, ...]
"""The exemplars' neighbourhoods at one resolution, one entry per width of the config."""


def level_of(stack: Stack, index: int, config: TextureConfig, *, distances: bool) -> Level:
    """Learn one level; `distances` says whether its field is smooth."""
    made = []
    for width in config.neighbourhood:
        grain = grain_of(width, smooth=index == 0 and distances)
        made.append(
            Candidates.of(
                stack,
                width=width,
                step=config.step_of(width),
                variance=variance_in(grain, config.variance),
                most=config.components,
                grain=grain,
                k=config.nearest,
            )
        )
    return tuple(made)


@dataclass(frozen=True)
class Job:
    """What is to be made of what.

    Levels and regions are as many, finest first, as are `targets` where `corrections` of the config
    step towards them, and `shares` where the request asks for a phase here more and there less
    (`grading`). `distances` says that fields are smooth.
    """

    levels: Sequence[Level]
    regions: Sequence[Region]
    request: Request
    config: TextureConfig
    distances: bool
    targets: Sequence[Correlations] = ()
    shares: Sequence[np.ndarray] = ()

    def stages(self) -> list[tuple[int, int]]:
        """Level and place of the width of every grid, in the order in which they are gone over."""
        return [
            (index, n)
            for index in reversed(range(len(self.regions)))
            for n in range(len(self.levels[index]))
        ]

    def course(self, index: int, number: int) -> Course:
        """What the rounds on one grid go by."""
        config, used = self.config, len(self.regions)
        candidates, first = self.levels[index][number], index == used - 1
        if first and 2**index >= _SPARSE_BELOW and config.step:
            candidates = replace(candidates, step=1)
        grid, leaning = Grid.over(self.regions[index], candidates), None
        if self.shares:
            grid, leaning = leaning_grid(grid, self.shares[index], index)
        rounds = config.first_rounds if first else config.rounds[min(index, len(config.rounds) - 1)]
        even = self.request.fixed is None and not self.shares
        target = self.targets[index] if index < len(self.targets) and even else None
        return Course(
            name=_name(index, number),
            said=f"level {used - index} of {used}",
            grid=grid,
            stage=key(self.request.seed, f"texture/{index}" + (f"/{number}" if number else "")),
            trims=_trims(grid, rounds, config, distances=self.distances)
            if index == 0
            else [0] * rounds,
            target=target,
            steps=config.corrections[min(index, len(config.corrections) - 1)] if target else 0,
            leaning=leaning,
            finest=index == 0,
            last=(index, number) == self.stages()[-1],
        )


def made_plain(job: Job) -> tuple[np.ndarray, list[dict[str, Any]]]:
    """The last votes (C, Z, Y, X) int16 on what neighbourhoods cover, and the energies where rounds
    go by them.
    """
    stages = job.stages()
    begin, left = _resumed(stages)
    run = Run() if left is None else Run.resumed(left.arrays)
    before: Candidates | None = None
    for index, number in stages[begin:]:
        course = job.course(index, number)
        done = 0 if left is None else left.number
        if left is None and before is None:
            run.start(course)
        elif left is None and before is not None:
            run.go_over(course, before, finer=number == 0, distances=job.distances)
        left = None  # nor does anybody else hold on to its arrays
        run.go_on(course, job.config, done)
        before = course.grid.candidates
        run.tell({"level": index, "width": before.basis.width})
    assert run.votes is not None  # the last course leaves them
    return run.votes if course.leaning is None else settled(run.votes, course.leaning), run.told


def _name(index: int, number: int) -> str:
    """Of a level and the place of a width, among the stages that an interrupted run can go on from."""
    return f"level {index} width {number}"


def _resumed(stages: Sequence[tuple[int, int]]) -> tuple[int, Left | None]:
    """The stage in which an interrupted run goes on, and its state; the first, and none."""
    for place in reversed(range(len(stages))):
        left = resume(_name(*stages[place]))
        if left is not None:
            return place, left
    return 0, None


def _trims(grid: Grid, rounds: int, config: TextureConfig, *, distances: bool) -> list[int]:
    """How much of a neighbourhood's rim does not vote, round by round of the finest level."""
    trims = [config.trim] * rounds
    if not distances and config.field != "indicator" and not config.energetic:
        # A mean of grey values loses their grain: in the end every voxel takes one neighbourhood's.
        trims[-2:] = [(grid.candidates.basis.width - grid.candidates.step) // 2] * len(trims[-2:])
    return trims
