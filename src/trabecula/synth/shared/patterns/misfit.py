"""How many patterns some material has too many or too few of, and what that makes of each change of
a voxel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from trabecula.measure.skeleton.simple import around
from trabecula.synth.shared.patterns.counts import Bins

EFFORT = 0.5
"""What a change costs of a voxel that the votes put a voxel away from the interface."""

_NEIGHBOURS = 0.3  # weight of their misfit beside that of chords and cubes
_BALLS = 100.0  # of that of balls, of which there is one for 64 voxels
_EULER = 20.0  # of that of Euler numbers


class BlockMisfit(NamedTuple):
    """A block's share of a misfit, as `flip_block` takes it, and changes it.

    Attributes
    ----------
    slopes : (bins, 2) float64
        Twice the misfit times its weight, and the weight.
    balls : int
        First bin of balls; the number of bins where none are counted.
    euler : (numbers, combinations) float64
        What every cube adds to the Euler numbers.
    euler_off, euler_weights : (numbers,) float64
        What is off of them, and what that weighs.
    """

    slopes: np.ndarray
    balls: int
    euler: np.ndarray
    euler_off: np.ndarray
    euler_weights: np.ndarray


class VotePrice(NamedTuple):
    """What it costs to change a voxel against its votes.

    Attributes
    ----------
    field : (C, z, y, x) int16
        Votes of the block.
    level : float
        Of the votes where the second of two phases begins.
    effort : float
        Of a change, for every unit by which votes lie on its phase's side of the level.
    """

    field: np.ndarray
    level: float
    effort: float


@dataclass
class Misfit:
    """Of material that is mended together: how many patterns (bins,) it is to have, and what is off
    of them; `size` voxels of it may change.
    """

    bins: Bins
    size: int
    target: np.ndarray
    off: np.ndarray

    def of_block(self, share: float) -> BlockMisfit:
        """Return a share of the misfit."""
        bins = self.bins
        weights = bins.units**2 / (self.target * bins.units * share + 1)
        weights[bins.neighbours : bins.balls] *= _NEIGHBOURS
        weights[bins.balls :] *= _BALLS
        slopes = np.stack([2 * share * self.off * weights, weights], axis=1)
        cubes = slice(bins.cubes, bins.cubes + bins.combinations)
        wanted = np.abs(bins.euler @ self.target[cubes])
        return BlockMisfit(
            slopes,
            bins.balls,
            bins.euler,
            share * (bins.euler @ self.off[cubes]),
            _EULER / (share * wanted + 1),
        )


def steps_around(shape: tuple[int, ...]) -> np.ndarray:
    """Return the steps in a flat local array to the 26 neighbours of a voxel, faces first."""
    steps = around(shape)
    apart = np.abs(np.indices((3, 3, 3)) - 1).sum(axis=0).ravel()
    return steps[np.argsort(apart, kind="stable")[1:]]
