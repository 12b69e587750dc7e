"""`Effective`: a transport coefficient along one axis, and how far it can be trusted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trabecula.core.brief import brief


@dataclass(frozen=True)
class Effective:
    """An effective coefficient of an image along one axis.

    Parameters
    ----------
    value : float
        The coefficient. 0.0 where the phase does not percolate along the axis (no component of
        voxels that share faces touches both end faces).
    converged : bool
        The flux through every section across the axis is the same to within the tolerance, and so
        are the power put in and the power dissipated. A small residual alone does not count.
    imbalance : float
        (max - min) / mean of the flux through all sections across the axis.
    iterations : int
        Steps of the solver; 0 where the phase does not percolate.
    fraction : float
        Share of the voxels that belong to the phase (that conduct), 0..1, in the box that was
        solved.
    halving : float, optional
        Relative change of the value when every voxel of a centre box is split into 2x2x2 (2x2).
        None where it was not requested, or where that box does not percolate.
    """

    value: float
    converged: bool
    imbalance: float
    iterations: int
    fraction: float
    halving: float | None = None

    __repr__ = brief

    @property
    def extrapolated(self) -> float | None:
        """Return the value for ever smaller voxels of the same stairs, value * (1 + 4 / 3 halving):
        Richardson's, for an error that falls with the square of the edge. None without `halving`.
        """
        return None if self.halving is None else self.value * (1.0 + 4.0 / 3.0 * self.halving)


def not_percolating(fraction: float) -> Effective:
    """Return the result of a phase that does not percolate."""
    return Effective(0.0, True, 0.0, 0, fraction)


def imbalance(flow: np.ndarray) -> float:
    """Return (max - min) / mean of the flow through sections; infinite where the mean is not
    positive.
    """
    mean = float(flow.mean())
    return float(flow.max() - flow.min()) / mean if mean > 0.0 else math.inf
