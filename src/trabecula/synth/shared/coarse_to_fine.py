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
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from trabecula.core.progress import track
from trabecula.engine.checkpoint import Checkpoint, due, offer, resume
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

    Every array is held by the run alone, so that a step can drop what the next one does not need
    before it allocates.
    """

    def run(self) -> None:
        """Go through all stages, or through those that an interrupted run left."""
        first, checkpoint = find_checkpoint(self.names)
        done = 0 if checkpoint is None else checkpoint.number
        resumes = checkpoint is not None
        if checkpoint is not None:
            self.restore(checkpoint.arrays)
        del checkpoint
        for place in range(first, len(self.names)):
            stage = self.open_stage(place)
            if not resumes:
                self.enter(stage, place)
            for number in track(range(done, stage.rounds), stage.label):
                if self.converges(stage, number):
                    break
                self.round(stage, number)
                if due() and (arrays := self.arrays(stage, number)):
                    offer(stage.name, number + 1, **arrays)
            self.leave(stage)
            resumes, done = False, 0

    def round(self, stage: StageT, number: int) -> None:
        """Do round `number` of a stage."""
        self.search(stage, number)
        self.vote(stage, number)
        self.correct(stage, number)

    @property
    @abstractmethod
    def names(self) -> Sequence[str]:
        """List the names of the stages, coarsest first."""

    @abstractmethod
    def open_stage(self, place: int) -> StageT:
        """Prepare the grid and the settings of a stage."""

    @abstractmethod
    def enter(self, stage: StageT, place: int) -> None:
        """Start the arrays at the first stage, or bring them from the one before to this."""

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
    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Take over the arrays of a checkpoint."""

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
