"""The coarse-to-fine loop of synthesis by search and vote, which `texture`, `kopf`, `chen` and
`sliced` configure.

A run goes through stages, from the coarsest grid to the finest, each of some rounds. In a round
every neighbourhood of the output searches its nearest one in the exemplar; the matches vote for the
values of the voxels, whose histogram is matched; then steps are taken on the two-point function.
After every round the arrays that the next one starts from are offered as a checkpoint, and an
interrupted run resumes after the last of them. A round is a function of these arrays, the stage and
the round's number, so the result does not depend on interruptions.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from trabecula.core.progress import part_of, track
from trabecula.core.request import Request
from trabecula.engine.checkpoint import Checkpoint, due, offer, resume
from trabecula.engine.memory import Stage, Workspace
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.matching.grid import Grid
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import join_to_known, match_votes, robust_weights
from trabecula.synth.shared.pictures import ROOM

_WIDTHS = 2.75  # neighbourhoods that lie side by side in the output on its coarsest level, at least


@dataclass(frozen=True)
class RoundStage:
    """Rounds on one grid.

    Attributes
    ----------
    name : str
        Among the checkpoints of the run.
    label : str
        For a progress bar.
    rounds : int
        At most.
    """

    name: str
    label: str
    rounds: int


StageT = TypeVar("StageT", bound=RoundStage)


class CoarseToFine(ABC, Generic[StageT]):
    """A run, with the arrays that its rounds replace.

    Attributes
    ----------
    request : Request
    work : Workspace
        The declared arrays of the stage; the state between rounds by its names in checkpoints.
    """

    request: Request
    work = Workspace(())

    def run(self) -> None:
        """Go through all stages, or through those that an interrupted run left."""
        first, checkpoint = find_checkpoint(self.names)
        costs = self.costs
        for place in range(first, len(costs)):
            with part_of(costs, place):
                self._run_stage(place, checkpoint)
            checkpoint = None

    def _run_stage(self, place: int, checkpoint: Checkpoint | None) -> None:
        """Go through a stage from its beginning, or from a checkpoint."""
        stage = self.open_stage(place)
        before, self.work = self.work, Workspace(self.memory(stage))
        if checkpoint is None:
            done = 0
            self.enter(stage, place, before)
        else:
            done = checkpoint.number
            self.restore(stage, checkpoint.arrays)
            checkpoint.arrays.clear()  # the workspace holds them
        del before  # the arrays of a coarser grid
        for number in track(range(done, stage.rounds), stage.label):
            if self.converges(stage, number):
                break
            self.round(stage, number)
            if due() and (arrays := self.arrays(stage, number)):
                offer(stage.name, number + 1, **arrays)
        self.leave(stage)

    def round(self, stage: StageT, number: int) -> None:
        """Do round `number` of a stage."""
        self.search(stage, number)
        self.vote(stage, number)
        self.correct(stage, number)

    @property
    @abstractmethod
    def names(self) -> Sequence[str]:
        """List the names of the stages, coarsest first."""

    @property
    @abstractmethod
    def costs(self) -> Sequence[float]:
        """List how long the stages take, in any unit: rounds times voxels, for a progress bar."""

    @abstractmethod
    def open_stage(self, place: int) -> StageT:
        """Prepare the grid and the settings of a stage."""

    @abstractmethod
    def memory(self, stage: StageT) -> Iterable[Stage]:
        """Declare the arrays of a stage."""

    @abstractmethod
    def enter(self, stage: StageT, place: int, before: Workspace) -> None:
        """Start the arrays at the first stage, or make them of those of the one `before`."""

    @abstractmethod
    def search(self, stage: StageT, number: int) -> None:
        """Find new matches."""

    @abstractmethod
    def vote(self, stage: StageT, number: int) -> None:
        """Make the field that the matches vote for, with the histogram that is required."""

    @abstractmethod
    def correct(self, stage: StageT, number: int) -> None:
        """Take the stage's steps on the two-point function."""

    @abstractmethod
    def arrays(self, stage: StageT, number: int) -> dict[str, np.ndarray]:
        """Return all that the next round starts from; nothing where no round can follow."""

    @abstractmethod
    def restore(self, stage: StageT, arrays: dict[str, np.ndarray]) -> None:
        """Take over the arrays of a checkpoint."""

    def open_region(self, name: str, region: Region, active: Mapping[str, np.ndarray]) -> None:
        """Begin with a stage of this name; hold what stays as it is: the free voxels of a region,
        the bounds of the known ones, and which sites are active.
        """
        self.work.enter(name)
        parts = {"free": region.free, "low": region.low, "high": region.high, **active}
        for part, array in parts.items():
            if array is not None and array is not self.request.mask:  # which is the caller's
                self.work.adopt(part, array)

    def weigh_matches(
        self,
        grid: Grid,
        found: tuple[np.ndarray, np.ndarray],
        robustness: float,
        place: int = 0,
    ) -> None:
        """Replace the matches of a grid by those `found` with their distances; weigh them for the
        next vote.
        """
        work = self.work
        work.enter(f"weigh{place}")
        work.release(f"match{place}")
        work.adopt(f"match{place}", found[0])
        work.adopt("distance", found[1])
        work.adopt(f"weight{place}", robust_weights(grid, found[1], robustness))

    def join_votes(self, region: Region) -> None:
        """Remove the step of the votes beside known voxels."""
        if region.low is not None:
            self.work.enter("join")
            join_to_known(region, self.work["votes"])

    def match_field(self, region: Region, targets: tuple[Histogram, ...] | None) -> None:
        """Make the votes a field with the histograms of the targets."""
        self.work.enter("match")
        if "field" in self.work:
            self.work.release("field")
        self.work.adopt("field", match_votes(region, self.work["votes"], targets))

    def converges(self, stage: StageT, number: int) -> bool:
        """Return whether a stage ends before round `number`."""
        return False

    def leave(self, stage: StageT) -> None:
        """Do what follows the rounds of a stage."""


def find_checkpoint(names: Sequence[str]) -> tuple[int, Checkpoint | None]:
    """Return the place of the stage in which an interrupted run stopped, and its checkpoint; the
    first place and None where there is none.
    """
    for place in reversed(range(len(names))):
        checkpoint = resume(names[place])
        if checkpoint is not None:
            return place, checkpoint
    return 0, None


def at_level(values: Sequence[int], index: int) -> int:
    """Return a setting's value on a level: finest first, the last counts for the rest."""
    return values[min(index, len(values) - 1)]


def levels_that_fit(smallest: int, most: int, *, width: int) -> int:
    """Count the resolutions at which an exemplar has room for a neighbourhood.

    Parameters
    ----------
    smallest : int
        The exemplar's shortest side.
    most : int
    width : int
        Of the neighbourhood.
    """
    count = 1
    while count < most and smallest // 2**count >= width + ROOM:
        count += 1
    return count


def levels_for(shape: tuple[int, ...], most: int, *, width: int) -> int:
    """Count the resolutions at which an output is some neighbourhoods wide: on coarser ones the
    first rounds would copy the exemplar whole.
    """
    side = float(np.prod(shape, dtype=np.float64)) ** (1 / len(shape))
    count = 1
    while count < most and side / 2**count >= _WIDTHS * width:
        count += 1
    return count


def trim_schedule(rounds: int, trim: int, *, width: int, step: int, grain: bool) -> list[int]:
    """Return the rim of a neighbourhood, in voxels, that does not vote in each round of the finest
    level.

    With `grain` neighbourhoods hardly overlap in the last two rounds: a mean of grey values loses
    their grain, so in the end every voxel takes the value of one neighbourhood.
    """
    trims = [trim] * rounds
    if grain:
        trims[-2:] = [(width - step) // 2] * len(trims[-2:])
    return trims
