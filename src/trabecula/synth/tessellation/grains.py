"""Grains of given volumes: seeds, weights, and moves of the seeds.

Bourne, Kok, Roper, Spanjer 2020 (doi:10.1080/14786435.2020.1790053): the weights with which every
cell of a Laguerre diagram has its volume exist and are the maximum of a concave function; moving
seeds to the centroids of their cells makes cells rounder (their algorithm 2). Here the weights go
by damped steps on a grid of points: the derivative of a cell's volume V by its weight is about
2.4 V^(1/3) (half of the surface over the distance of seeds, of rounded cells).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil
from statistics import NormalDist

import numpy as np

from trabecula.core.seeds import generator
from trabecula.synth.tessellation.laguerre import FINE, Diagram

POINTS = 7.0
"""Points of the grid along the edge of a cube of a cell's mean volume."""

_DERIVATIVE = 2.4
_DAMPING = 0.8
_BETWEEN = 2  # corrections of the volumes after a move of the seeds
_MOST = 60  # corrections after the last move
_NEAR = 0.02  # root mean square of the volumes' errors, over the mean, that ends them
_TAIL = 2.0  # grains that grow are of bounded size: farther tails make a few giants
_STAGE = "tessellation"


def grow_grains(
    seed: int,
    sides: Sequence[float],
    density: float,
    *,
    spread: float,
    lloyd_steps: int,
    points: float = POINTS,
) -> tuple[Diagram, float]:
    """Return a diagram whose cells have lognormal volumes, and how far these are met.

    Parameters
    ----------
    seed : int
    sides : three floats
        Of the torus, voxels.
    density : float
        Cells per voxel.
    spread : float
        Standard deviation of the logarithm of volumes, before its tails are cut off at two of it.
    lloyd_steps : int
        Moves of the seeds.
    points : float
        Of the grid along the edge of a cube of a cell's mean volume.

    Returns
    -------
    diagram : Diagram
    error : float
        Root mean square of the volumes' errors over the mean volume.
    """
    torus: np.ndarray = np.asarray(sides, np.float64)
    count = max(1, round(float(np.prod(torus)) * density))
    random = generator(seed, _STAGE)
    places: np.ndarray = random.random((count, 3)) * torus
    volumes = np.exp(spread * _even_normal(count))[random.permutation(count)]
    volumes *= np.prod(torus) / volumes.sum()
    mean = float(volumes.mean())
    counts = [max(1, ceil(side / mean ** (1 / 3) * points)) for side in torus]
    weights = (3 * volumes / (4 * np.pi)) ** (2 / 3)  # of balls of these volumes
    diagram = Diagram(places, weights - weights.max(), torus)
    voxel = float(np.prod(torus)) / float(np.prod(counts))
    step = 1 / (_DERIVATIVE * np.cbrt(volumes))
    pace: np.ndarray = np.full(count, _DAMPING)
    before: np.ndarray = np.zeros(count)
    moves = lloyd_steps * (_BETWEEN + 1)
    error = 0.0
    for turn in range(moves + _MOST):
        moments = diagram.moments(counts)
        off = volumes - moments[:, 0] * voxel
        error = float(np.sqrt(np.mean(off**2)) / mean)
        places, weights = diagram.seeds, diagram.weights
        if turn < moves and turn % (_BETWEEN + 1) == _BETWEEN:
            shift = moments[:, 1:] / (np.maximum(moments[:, :1], 1) * FINE)
            places = np.asarray(np.mod(places + shift, torus))
        elif turn >= moves and error < _NEAR:
            break
        else:
            # the derivative is larger where seeds are near each other: whose error changes sign
            # goes on in smaller steps
            pace = np.asarray(np.clip(np.where(off * before < 0, 0.5, 1.2) * pace, 0.02, 1.5))
            weights = weights + pace * step * off
            before = off
        diagram = Diagram(places, weights - weights.max(), torus)
    return diagram, error


def _even_normal(count: int) -> np.ndarray:
    """Return the middles of `count` equal shares of a normal distribution within `_TAIL` standard
    deviations, rising.
    """
    normal = NormalDist()
    least = normal.cdf(-_TAIL)
    shares = least + (1 - 2 * least) * (np.arange(count) + 0.5) / count
    return np.array([normal.inv_cdf(share) for share in shares])
