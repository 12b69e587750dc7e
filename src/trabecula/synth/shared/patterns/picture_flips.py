"""The last step of labels from pictures: single voxels flip until chords and squares of pixels
occur in the planes as often as in the pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from trabecula.core.request import Request
from trabecula.engine.memory import Stage
from trabecula.exemplar.views import View
from trabecula.synth.shared.content.kinds import Content, Labels, free_voxels
from trabecula.synth.shared.patterns.flips import FlipRegion, pattern_stages
from trabecula.synth.shared.patterns.labels import match_patterns
from trabecula.synth.shared.patterns.planes import PlanePatterns, are_told


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
    """

    views: Sequence[View]
    content: Content
    orientations: str
    rounds: int
    clip: float

    def shown_for(self, request: Request) -> PlanePatterns | None:
        """Return what a result is brought to; None where nothing flips: the pictures are too small
        to tell their patterns, or a target or a coarse scan asks for other fractions.
        """
        if not self.rounds or not isinstance(self.content, Labels):
            return None
        other = bool(request.target) or request.coarse is not None
        told = are_told(self.views, len(self.content.present))
        return self._shown if told and not other else None

    @cached_property
    def _shown(self) -> PlanePatterns:
        assert isinstance(self.content, Labels)
        return PlanePatterns.of(self.views, self.content.present, self.orientations)

    def flip(
        self, values: np.ndarray, votes: np.ndarray, shown: PlanePatterns, request: Request
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return labels of a request with the patterns that are shown, and a report; values and
        votes as `match_patterns` takes them.
        """
        assert isinstance(self.content, Labels)
        return match_patterns(
            values,
            votes,
            self.content,
            request,
            shown,
            FlipRegion(request.periodic, free_voxels(request), request.mask),
            rounds=self.rounds,
            clip=self.clip,
        )

    def stages(self, request: Request, channels: int) -> tuple[Stage, ...]:
        """Declare the arrays of the flips of a request."""
        if self.shown_for(request) is None:
            return ()
        return pattern_stages(request.shape, channels, free=free_voxels(request) is not None)
