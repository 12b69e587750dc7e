"""Labels that end with flips: to phases and back, with what a request keeps."""

from __future__ import annotations

from typing import Any

import numpy as np

from trabecula.core.request import Request
from trabecula.synth.shared.content.fields import FULL, UNIT
from trabecula.synth.shared.content.kinds import Labels, complete
from trabecula.synth.shared.content.phase_fractions import labels_of_phases, phases_of
from trabecula.synth.shared.patterns.counts import Patterns
from trabecula.synth.shared.patterns.densities import PatternDensities
from trabecula.synth.shared.patterns.flips import FlipRegion, flip_voxels
from trabecula.synth.shared.patterns.planes import PlanePatterns, with_euler
from trabecula.synth.shared.patterns.sections import SectionEuler


def shares_of(patterns: PatternDensities | PlanePatterns | None) -> tuple[float, float]:
    """Return the parts of a run's time that go to its rounds and to what follows, flips towards
    patterns where there are any: balls take as long as all others.
    """
    if patterns is None:
        return 1.0, 0.0
    balls = isinstance(patterns, PatternDensities) and patterns.bins.with_balls
    return (0.65, 0.35) if balls else (0.83, 0.17)


def match_patterns(
    values: np.ndarray,
    votes: np.ndarray,
    content: Labels,
    request: Request,
    patterns: PatternDensities | PlanePatterns,
    place: FlipRegion,
    *,
    rounds: int,
    clip: float,
    sections: SectionEuler | None = None,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Return labels (Z, Y, X) with other patterns, and the report of `flip_voxels`.

    Parameters
    ----------
    values : (Z, Y, X) uint8
        Labels of a content, made for a request; they may be changed.
    votes : (C, Z, Y, X) int16
        Fields that they were made of.
    patterns, place, rounds :
        As `flip_voxels` takes them; of pictures those nearest to the patterns of the labels.
    clip : float
        Voxels at which the fields saturate.
    sections : SectionEuler, optional
        Which say how the material of pictures is joined. Default: as the labels are.
    """
    phases = phases_of(values, content.present)
    if isinstance(patterns, PlanePatterns):
        count = len(content.present)
        made = Patterns.of(phases, count, wraps=place.wraps, valid=place.valid)
        given = PatternDensities(made.bins, made.densities)
        if sections is not None:
            given = with_euler(given, sections.wanted(phases, given.euler, place.valid))
        patterns = patterns.nearest_to(given)
    phases, report = flip_voxels(
        phases,
        votes,
        patterns,
        place,
        seed=request.seed,
        rounds=rounds,
        unit=FULL / clip * UNIT,
    )
    labels = labels_of_phases(phases, content.present)
    return complete(labels, request, empty=content.empty), report
