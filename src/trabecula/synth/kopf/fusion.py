"""Rounds of search and vote that a low-resolution scan lays out.

Every vote is moved to where the blocks of the scan are right (`back_projection`), so the next
search finds squares of the picture that go with them: the scan says where things are, the picture
what they look like.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trabecula.core.request import Request
from trabecula.engine.memory import Workspace
from trabecula.engine.parallel import for_slabs
from trabecula.synth.kopf.back_projection import back_project
from trabecula.synth.kopf.coarse_scan import CoarseScan
from trabecula.synth.shared.content.fields import quantise, votes_of
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.content.kinds import Labels
from trabecula.synth.shared.matching.rounds import round_votes
from trabecula.synth.shared.pyramid import fit_to
from trabecula.synth.shared.solid.run import SolidRounds, SolidStage

if TYPE_CHECKING:
    from trabecula.synth.shared.solid.model import SolidLevel, SolidModel

_ROUNDS = 8  # of back-projection after a vote
_MARGIN = 200.0  # votes beyond the interface that a block is moved: less than a step of the field


class FusionRounds(SolidRounds):
    """A run from a coarse scan, whose blocks every field keeps as far as it can.

    It begins on the level whose voxels are the scan's, or on the coarsest that the pictures have.
    No steps are taken on the two-point function: beside the scan they draw fringes. The weights of
    the soft histogram matching change nothing here, the exact one is enough.
    """

    def __init__(self, model: SolidModel, request: Request, scan: CoarseScan) -> None:
        super().__init__(model, request)
        self.scan = scan
        self.used = min(self.used, int(np.log2(min(scan.sides))) + 1)
        del self.regions[self.used :]

    def targets(self, level: SolidLevel) -> tuple[Histogram, ...]:
        """Return the pictures' histograms, with the fraction that the scan has."""
        content, phi = self.model.content, self.scan.material.fraction
        assert isinstance(content, Labels)
        return content.reweight(level.histograms, content.fractions, np.array([1 - phi, phi]))

    def enter(self, stage: SolidStage, place: int, before: Workspace) -> None:
        """Start from the scan and random patches, or double the field."""
        if place:
            super().enter(stage, place, before)
            return
        self.open_level(stage)
        shape = tuple(-(-side // 2**stage.index) for side in self.request.shape)
        start = self.scan.start(shape, stage.index)
        field = fit_to(quantise(start, clip=self.config.clip), stage.views.region.shape)
        self.start_matches(stage)
        self.work.adopt("votes", votes_of(field))
        self.work.adopt("field", field)

    def vote(self, stage: SolidStage, number: int | None) -> None:
        """Make the field that the matches vote for, moved to where the scan's blocks are right."""
        super().vote(stage, number)
        if not self.scan.divides(stage.index):
            return
        bounds = self.scan.bounds(stage.index)
        work = self.work
        work.release("votes")
        votes = work.adopt("votes", votes_of(work["field"]))
        back_project(votes[0], bounds, rounds=_ROUNDS, margin=_MARGIN)
        field = work["field"]
        for_slabs(lambda a, b: np.copyto(field[:, a:b], round_votes(votes[:, a:b])), field.shape[1])

    def correct(self, stage: SolidStage, number: int) -> None:
        """Take no steps on the two-point function."""
