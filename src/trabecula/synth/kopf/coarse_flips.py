"""The last step beside a coarse scan: single voxels flip until chords and squares of pixels occur
as often as in the picture, and every block stays as the scan says.

The squares are those that the picture has at the scan's fraction. No picture shows how often a
material is joined in space, and an unsharp mask joins what is near: the Euler numbers aimed at are
those from before it, or what parallel sections say.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from trabecula.synth.kopf.coarse_scan import CoarseScan
from trabecula.synth.shared.content.fields import FULL, UNIT
from trabecula.synth.shared.patterns.counts import Patterns
from trabecula.synth.shared.patterns.densities import PatternDensities
from trabecula.synth.shared.patterns.flips import FlipRegion, flip_voxels
from trabecula.synth.shared.patterns.planes import PlanePatterns, with_euler
from trabecula.synth.shared.patterns.sections import SectionEuler

_WITHIN = 1.0
"""Errors of a block's fraction, of grey values: flips go to the end of what they may."""


def match_picture(
    values: np.ndarray,
    plain: np.ndarray,
    votes: np.ndarray,
    scan: CoarseScan,
    shown: PlanePatterns,
    sections: SectionEuler | None,
    *,
    seed: int,
    rounds: int,
    clip: float,
) -> tuple[np.ndarray, dict[str, Any]]:
    """Return the second phase with other patterns, and the report of `flip_voxels`.

    Parameters
    ----------
    values, plain : (Z, Y, X) bool
        Sharpened, and before that.
    votes : (Z, Y, X) int16
        That they were made of.
    scan : CoarseScan
    shown : PlanePatterns
        Of the pictures, at the scan's fraction.
    sections : SectionEuler, optional
    seed, rounds :
        As of `flip_voxels`.
    clip : float
        Voxels at which the fields saturate.
    """
    euler = _densities(plain).euler
    if sections is not None:
        euler = sections.wanted(plain.view(np.uint8), euler)
    wanted = shown.nearest_to(with_euler(_densities(values), euler))
    place = FlipRegion(bounds=scan.bounds(0, _WITHIN))
    unit = FULL / clip * UNIT
    phases = values.view(np.uint8)
    phases, report = flip_voxels(
        phases, votes[None], wanted, place, seed=seed, rounds=rounds, unit=unit
    )
    return phases.view(bool), report


def _densities(values: np.ndarray) -> PatternDensities:
    found = Patterns.of(values.view(np.uint8), 2)
    return PatternDensities(found.bins, found.densities)
