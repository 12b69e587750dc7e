"""How far bodies overlap, and how round the edges are where they meet: tried on small packings, the
figures of the scan (`shared.own_figures`) choosing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Generic, Protocol, TypeVar

import numpy as np

from trabecula.core.image import Image
from trabecula.engine.parallel import map_items
from trabecula.synth.shared.own_figures import Figure, OwnFigures
from trabecula.synth.shared.packed.depth import deepest_share

BOX = 96
"""Voxels of a trial and of the scan's centre along every axis, at most."""

SEPARATIONS = (1.2, 1.1, 1.0, 0.95, 0.9, 0.85, 0.8)
"""Of bodies that are tried: from apart to overlapping."""

_FILLETS = (0.0, 1.0, 2.0)
_FINER = (0.5, 3.0), (0.25, 1.5)  # steps of fillets, and times the best score that are followed
_MOST_FILLET = 3.0
_KEPT = 32  # arrangements, each for packings of several fillets
_FAR = 8.0  # spreads: a figure that is farther off counts as so much
_LEAST_SPREAD = 0.02
_SEEDS, _MORE_SEEDS = (0,), (1, 2)  # of trials, and of those that are tried again
_AGAIN = 4  # of the nearest settings


@dataclass(frozen=True)
class Packed:
    """What trials chose.

    Attributes
    ----------
    separation, fillet : float
    score : float or None
        Root mean square of what figures of its trials are off, in the scan's own spreads, and what
        bodies lack of their distance, in their radii; None where nothing was tried.
    """

    separation: float
    fillet: float
    score: float | None


class _Arranged(Protocol):
    @property
    def lacking(self) -> float: ...


A = TypeVar("A", bound=_Arranged)


@dataclass(frozen=True)
class SmallPackings(Generic[A]):
    """How small packings of a phase are made.

    Attributes
    ----------
    image : Image
        The scan, of two phases.
    label : int
        Of the bodies.
    figures : OwnFigures, optional
        Of the scan's centre box of `BOX`; None: nothing is tried.
    arrange : callable
        Of the sides of a box in edges, a separation and a seed: bodies, and what they lack.
    draw : callable
        Of these, a shape, the edges of a voxel and a fillet: the depth of voxels.
    """

    image: Image
    label: int
    figures: OwnFigures | None
    arrange: Callable[[np.ndarray, float, int], A]
    draw: Callable[[A, tuple[int, ...], np.ndarray, float], np.ndarray]


def choose(
    trial: SmallPackings[A],
    *,
    separation: float | None,
    fillet: float | None,
    separations: tuple[float, ...] = SEPARATIONS,
) -> Packed:
    """Choose separation and fillet, where they are not given; 1 where nothing is tried."""
    image, label, figures = trial.image, trial.label, trial.figures
    if figures is None or (separation is not None and fillet is not None):
        apart = 1.0 if separation is None else separation
        return Packed(apart, 1.0 if fillet is None else fillet, None)
    steps = np.array(image.spacing) / min(image.spacing)
    shape = tuple(min(side, BOX) for side in image.shape)
    other = next(int(one) for one in np.unique(image.values) if one != label)
    share = float(np.mean(image.values == label))

    @lru_cache(maxsize=_KEPT)
    def pack(apart: float, seed: int) -> A:
        return trial.arrange(np.asarray(shape * steps), apart, seed)

    def score(place: tuple[float, float, int]) -> float:
        apart, rounding, seed = place
        packed = pack(apart, seed)
        solid = deepest_share(trial.draw(packed, shape, steps, rounding), share)
        values = np.where(solid, label, other).astype(np.uint8)
        return score_of(figures.compare(image, values)) + packed.lacking

    return search(score, separations if separation is None else (separation,), fillet)


def score_of(figures: dict[str, Figure]) -> float:
    """Return the root mean square of what figures are off, in spreads."""
    off = [min(one.apart / max(one.spread, _LEAST_SPREAD), _FAR) for one in figures.values()]
    return float(np.sqrt(np.mean(np.square(off)))) if off else _FAR


def search(
    trial: Callable[[tuple[float, float, int]], float],
    apart: tuple[float, ...],
    fillet: float | None,
) -> Packed:
    """Try separations and fillets on a grid; of the separations that are not far behind the best,
    fillets between those of the grid, in ever smaller steps; and the best few again.

    Larger fillets make up for larger separations, so that the best lie along a narrow valley.
    """
    roundings = _FILLETS if fillet is None else (fillet,)
    scores: dict[tuple[float, float], list[float]] = {}

    def add(places: Iterable[tuple[float, float]], seeds: Iterable[int], label: str) -> None:
        items = [(*place, seed) for place in places for seed in seeds]
        for item, score in zip(items, map_items(trial, items, label), strict=True):
            scores.setdefault(item[:2], []).append(score)

    def mean(place: tuple[float, float]) -> tuple[float, tuple[float, float]]:
        return float(np.mean(scores[place])), place

    def best_at(own: float) -> tuple[float, float]:
        return min((one for one in scores if one[0] == own), key=mean)

    add(list(product(apart, roundings)), _SEEDS, "trying packings")
    for step, within in _FINER if fillet is None else ():
        most = within * min(mean(one)[0] for one in scores)
        tops = [best_at(own) for own in apart if mean(best_at(own))[0] <= most]
        near = [(own, at + sign * step) for own, at in tops for sign in (-1, 1)]
        add([one for one in near if 0 <= one[1] <= _MOST_FILLET], _SEEDS, "trying fillets")
    again = sorted(scores, key=mean)[:_AGAIN]
    add(again, _MORE_SEEDS, "trying the nearest again")
    found = min(again, key=mean)
    return Packed(*found, mean(found)[0])
