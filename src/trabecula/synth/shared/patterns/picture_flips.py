"""The last step of labels from pictures: single voxels flip until chords and squares of pixels
occur in the planes as often as in the pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.core.progress import notify, part_of
from trabecula.core.request import Request
from trabecula.engine.memory import Stage
from trabecula.exemplar.views import View
from trabecula.synth.shared.content.kinds import Content, Labels, free_voxels
from trabecula.synth.shared.patterns.flips import FlipRegion, pattern_stages
from trabecula.synth.shared.patterns.labels import match_patterns, shares_of
from trabecula.synth.shared.patterns.planes import PlanePatterns, are_told
from trabecula.synth.shared.patterns.sections import SectionEuler


@dataclass(frozen=True)
class PictureFlips:
    """Flips towards what pictures show.

    Attributes
    ----------
    views : sequence of View
    content : Content
        Of the pictures; only labels have patterns.
    orientations : str
        Copies of a picture that a method learns from, as `symmetries` takes them.
    rounds : int
        Over all voxels of interfaces; 0: none flips.
    clip : float
        Voxels at which the fields saturate.
    sections : sequence of Image
        Parallel ones of the material of the pictures, which say how it is joined in space; none: it
        stays joined as it comes.
    gap : int
        Pixels from one to the next.
    """

    views: Sequence[View]
    content: Content
    orientations: str
    rounds: int
    clip: float
    sections: Sequence[Image] = ()
    gap: int = 0

    def shown_for(self, request: Request) -> PlanePatterns | None:
        """Return what a result is brought to; None where nothing flips: the pictures are too small
        to tell their patterns, or a target asks for a fraction that they do not tell of, or there
        is a coarse scan, which has a way of its own.
        """
        if request.coarse is not None or not self._are_told:
            return None
        if not request.target:
            return self._shown
        assert isinstance(self.content, Labels)
        asked = self.content.fractions_of_target(request)
        if asked is None or len(asked) != 2:
            return None
        return self.shown_at(float(asked[1]))

    @cached_property
    def _are_told(self) -> bool:
        """Return whether voxels are to flip, and pictures tell their patterns."""
        if not self.rounds or not isinstance(self.content, Labels):
            return False
        return are_told(self.views, len(self.content.present))

    @cached_property
    def _shown(self) -> PlanePatterns:
        assert isinstance(self.content, Labels)
        return PlanePatterns.of(self.views, self.content.present, self.orientations)

    @cached_property
    def joined(self) -> SectionEuler | None:
        """Return what the sections say; None where there are none."""
        if not self.sections:
            return None
        assert isinstance(self.content, Labels)
        return SectionEuler.of(self.sections, self.content.present, self.gap)

    @cached_property
    def _known(self) -> dict[float, PlanePatterns | None]:
        return {}

    def shown_at(self, fraction: float) -> PlanePatterns | None:
        """Return what the pictures show of a material of another fraction of the second of two
        phases, found once; None where nothing flips, or they do not tell of it.
        """
        if not self._are_told:
            return None
        assert isinstance(self.content, Labels)
        if fraction not in self._known:
            self._known[fraction] = PlanePatterns.at_fraction(
                self.views, self.content.present, fraction, self.orientations
            )
        return self._known[fraction]

    def part_of_run(self, request: Request, place: int) -> AbstractContextManager[None]:
        """Count what runs inside the block as the rounds of a run (0), or as what follows (1)."""
        return part_of(shares_of(self.shown_for(request)), place)

    def finish(
        self, votes: np.ndarray, request: Request
    ) -> np.ndarray | tuple[np.ndarray, dict[str, Any]]:
        """Return the values of a request from its last votes (C, Z, Y, X) int16; where voxels flip,
        a report as well.
        """
        values, shown = self.content.to_values(votes, request), self.shown_for(request)
        if self.sections and (shown is None or request.target):
            notify(
                "the sections' Euler number holds for labels of pictures that are large enough to "
                "tell their patterns, at the pictures' fractions: here it is not met"
            )
        if shown is None:
            return values
        assert isinstance(self.content, Labels)
        with self.part_of_run(request, 1):
            values, report = match_patterns(
                values,
                votes,
                self.content,
                request,
                shown,
                FlipRegion(request.periodic, free_voxels(request), request.mask),
                rounds=self.rounds,
                clip=self.clip,
                sections=None if request.target else self.joined,
            )
        return values, {"patterns": report}

    def stages(self, request: Request, channels: int) -> tuple[Stage, ...]:
        """Declare the arrays of the flips of a request."""
        if self.shown_for(request) is None:
            return ()
        return pattern_stages(request.shape, channels, free=free_voxels(request) is not None)
