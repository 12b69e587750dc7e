"""Figures of a picture of two phases in which processes differ, all in correlation
lengths: its covariance; of either phase the lineal path, the depths of its pixels, the number of
components and how far they reach; the curvature of the interface.
"""

from __future__ import annotations

import numpy as np

from trabecula.measure.correlation import covariance_form, lineal_path, two_point
from trabecula.measure.distance import distance_transform
from trabecula.measure.labelling import label_components
from trabecula.measure.smooth import gaussian, reach_of

_REACH = 3.0  # correlation lengths that curves go
_PLACES = 25  # on a curve
_SMOOTH = 0.35  # correlation lengths, before the curvature is taken
_APART = 2.0  # correlation lengths between two pixels that may lie in one component


def slice_figures(inside: np.ndarray, length: float) -> dict[str, np.ndarray]:
    """Return the figures of a picture (Y, X) bool, as arrays, by a correlation length in pixels."""
    places = np.linspace(0, _REACH, _PLACES) * length
    reach = min(int(places[-1]) + 1, min(inside.shape) // 2)
    found = {
        "covariance": _at(places, covariance_form(two_point_of(inside, reach))),
        "curvature": _curvatures(inside, length),
    }
    step = max(1, round(_APART * length))
    for phase, own in (("high", inside), ("low", ~inside)):
        path = lineal_path(own.view(np.uint8), r_max=reach, phase=1)
        found[f"path {phase}"] = _at(places, path / max(path[0], 1e-9))
        found[f"depth {phase}"] = _depths(own, places / 2)
        labels, sizes = label_components(own)
        number = np.count_nonzero(sizes) * length**2 / inside.size
        found[f"number {phase}"] = np.array([np.sqrt(number)])
        found[f"reach {phase}"] = np.array([_joined(labels, step)])
    return found


def two_point_of(inside: np.ndarray, reach: int) -> np.ndarray:
    """Return the radial two-point function of a picture (Y, X) bool."""
    return two_point(inside.view(np.uint8), r_max=reach, phase=1)


def _at(places: np.ndarray, curve: np.ndarray) -> np.ndarray:
    return np.interp(places, np.arange(len(curve)), curve)


def _depths(own: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the shares of a phase's pixels that are no deeper in it than each of some places."""
    depths = np.sort(distance_transform(own)[own])
    return np.searchsorted(depths, places, side="right") / max(1, len(depths))


def _joined(labels: np.ndarray, step: int) -> float:
    """Return the share of pairs of a phase's pixels `step` apart along rows or columns that lie in
    one component.
    """
    pairs = same = 0
    for lines in (labels, labels.T):
        here, there = lines[:, :-step], lines[:, step:]
        both = (here > 0) & (there > 0)
        pairs += np.count_nonzero(both)
        same += np.count_nonzero(both & (here == there))
    return same / max(1, pairs)


def _curvatures(inside: np.ndarray, length: float) -> np.ndarray:
    """Return the distribution function of the interface's curvature, in inverse correlation
    lengths.
    """
    sigma = max(1.0, _SMOOTH * length)
    smooth = gaussian(inside.astype(np.float32), sigma).astype(np.float64)
    y, x = np.gradient(smooth)
    (yy, yx), (_, xx) = np.gradient(y), np.gradient(x)
    square = np.maximum(x * x + y * y, 1e-12)
    curvature = -(xx * y * y - 2 * x * y * yx + yy * x * x) / square**1.5 * length
    edge = np.zeros(inside.shape, bool)
    edge[:, :-1] |= inside[:, 1:] != inside[:, :-1]
    edge[:-1] |= inside[1:] != inside[:-1]
    margin = reach_of(sigma)
    chosen = np.sort(
        curvature[margin:-margin, margin:-margin][edge[margin:-margin, margin:-margin]]
    )
    places = np.linspace(-3, 3, 40)
    return np.searchsorted(chosen, places) / max(1, len(chosen))
