"""How a material is joined in space, as parallel sections of it say: the Euler numbers that labels
from pictures are brought to.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.disector import density_between, layer_euler
from trabecula.synth.shared.content.phase_fractions import phases_of

_PAIRS = 64  # of slices of a volume along an axis, at most
_PIXEL = (1.0, 1.0)


@dataclass(frozen=True)
class SectionEuler:
    """What parallel sections say of the Euler numbers a voxel, by the disector
    (`measure.disector`).

    Attributes
    ----------
    gap : int
        Pixels from one section to the next.
    own : dict
        Phase, counted from 0 -> Euler number: of two the second, else every one.
    """

    gap: int
    own: Mapping[int, float]

    @classmethod
    def of(cls, sections: Sequence[Image], present: Sequence[int], gap: int) -> SectionEuler:
        """Measure two or more sections of labels, one above the other."""
        planes = phases_of(np.stack([each.values for each in sections]), tuple(present))
        kinds = range(1, 2) if len(present) == 2 else range(len(present))
        own = {one: density_between(planes == one, _PIXEL, height=gap) for one in kinds}
        return cls(gap, own)

    def wanted(
        self, phases: np.ndarray, euler: np.ndarray, valid: np.ndarray | None = None
    ) -> np.ndarray:
        """Return the Euler numbers a voxel that a volume is to have.

        Both miss what is thinner than the gap: so the volume's own change by what slices of it, as
        far apart as the sections, have too few. Where no slices are, they stay.

        Parameters
        ----------
        phases : (Z, Y, X) uint8
            Counted from 0.
        euler : (numbers,) float64
            The volume's, as `PatternDensities.euler` numbers them.
        valid : (Z, Y, X) bool, optional
            Voxels of the material.
        """
        short = []
        for phase, own in self.own.items():
            found = [self._along(phases, axis, phase, valid) for axis in range(3)]
            told = [one for one in found if np.isfinite(one)]
            short.append(own - float(np.mean(told)) if told else 0.0)
        return euler + np.repeat(short, len(euler) // len(short))

    def _along(self, phases: np.ndarray, axis: int, phase: int, valid: np.ndarray | None) -> float:
        """Return what pairs of slices across an axis say; NaN where there are none."""
        planes, last = np.moveaxis(phases, axis, 0), phases.shape[axis] - self.gap
        masks = None if valid is None else np.moveaxis(valid, axis, 0)
        found = []
        for first in np.unique(np.linspace(0, last - 1, max(0, min(last, _PAIRS))).astype(int)):
            lower, upper = planes[first] == phase, planes[first + self.gap] == phase
            mask = None if masks is None else masks[first] & masks[first + self.gap]
            found.append(layer_euler(lower, upper, _PIXEL, mask))
        told = [one for one in found if np.isfinite(one)]
        return float(np.mean(told)) / self.gap if told else np.nan
