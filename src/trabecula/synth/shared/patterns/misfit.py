"""How many patterns some material has too many or too few of, and what that makes of each change of
a voxel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.measure.skeleton.simple import around
from trabecula.synth.shared.patterns.counts import Bins

EFFORT = 0.5
"""What a change costs of a voxel that the votes put a voxel away from the interface."""

_NEIGHBOURS = 0.3  # weight of their misfit beside that of chords and cubes
_BALLS = 100.0  # of that of balls, of which there is one for 64 voxels
_EULER = 20.0  # of that of Euler numbers


@dataclass
class Misfit:
    """Of material that is mended together: how many patterns (bins,) it is to have, and what is off
    of them; `size` voxels of it may change.
    """

    bins: Bins
    size: int
    target: np.ndarray
    off: np.ndarray

    def of_block(self, share: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the slopes of the energy with a share of the misfit, and the shares of Euler
        numbers in cubes, their misfit and their weights.
        """
        bins = self.bins
        weights = bins.units**2 / (self.target * bins.units * share + 1)
        weights[bins.neighbours : bins.balls] *= _NEIGHBOURS
        weights[bins.balls :] *= _BALLS
        slopes = np.stack([2 * share * self.off * weights, weights], axis=1)
        cubes = slice(bins.cubes, bins.cubes + bins.combinations)
        wanted = np.abs(bins.euler @ self.target[cubes])
        return (
            slopes,
            bins.euler,
            share * (bins.euler @ self.off[cubes]),
            _EULER / (share * wanted + 1),
        )


def steps_around(shape: tuple[int, ...]) -> np.ndarray:
    """Return the steps in a flat local array to the 26 neighbours of a voxel, faces first."""
    steps = around(shape)
    apart = np.abs(np.indices((3, 3, 3)) - 1).sum(axis=0).ravel()
    return steps[np.argsort(apart, kind="stable")[1:]]
