"""Which process a picture resembles: slices of every one, at the picture's fraction and scale,
beside the picture, by the figures of `slice_figures`. A figure's distance counts in what single
slices of one process differ by.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from trabecula.core.progress import track
from trabecula.measure.centre_crop import centre_box
from trabecula.measure.correlation import decay_length
from trabecula.synth.kopf.config import PROCESSES
from trabecula.synth.kopf.processes import process_field
from trabecula.synth.kopf.slice_figures import slice_figures, two_point_of

_SIDE, _LENGTH = 64, 10.0  # voxels of the fields of a trial, between their bodies
_SIDES = (32, 112)  # voxels of the fields that slices are taken from
_ACROSS = 8  # mean distances along a side of them
_SLICES = 8  # across each axis
_PICTURE = 400  # pixels of the picture that are looked at, its middle
_MOST = 6.0  # that one figure counts
_SHARE = 0.25  # of what processes differ by in a figure, of which nothing is made
_LEAST = 1e-3  # spread of a figure, at least


@dataclass(frozen=True)
class Resemblance:
    """How far a picture is from slices of a process.

    Attributes
    ----------
    name : str
    distance : float
        Root mean square over the figures; about 1 for a slice of the process itself.
    length : float
        Mean distance between bodies that gives the picture's correlation length, pixels.
    """

    name: str
    distance: float
    length: float


def rank_processes(inside: np.ndarray) -> tuple[Resemblance, ...]:
    """Return how far a picture (Y, X) bool of both phases is from every process, nearest first."""
    picture = np.ascontiguousarray(centre_box(inside, _PICTURE))
    fraction = float(picture.mean())
    length = length_of(picture)
    wanted = slice_figures(picture, length)
    found = []
    for name in track(PROCESSES, "comparing with processes"):
        apart = distance_between_bodies(name, fraction, length)
        figures = [slice_figures(one, length) for one in _slices_of(name, fraction, apart)]
        mean = {key: np.mean([one[key] for one in figures], axis=0) for key in wanted}
        differences = [_differences(one, mean) for one in figures]
        spread = {key: float(np.mean([one[key] for one in differences])) for key in wanted}
        found.append((name, apart, mean, spread))
    units = [
        _units([mean for _, _, mean, _ in found], [s for *_, s in found], n)
        for n in range(len(found))
    ]
    ranked = [
        Resemblance(name, _distance(_differences(wanted, mean), unit), apart)
        for (name, apart, mean, _), unit in zip(found, units, strict=True)
    ]
    return tuple(sorted(ranked, key=lambda one: one.distance))


def _units(
    means: Sequence[Mapping[str, np.ndarray]],
    spreads: Sequence[Mapping[str, float]],
    number: int,
) -> dict[str, float]:
    """Return in what a distance from a process counts, by figure: what single slices differ by,
    its own and those of most, and a share of what processes differ by.
    """
    found = {}
    for key, own in spreads[number].items():
        typical = float(np.median([spread[key] for spread in spreads]))
        middle = np.mean([mean[key] for mean in means], axis=0)
        between = np.mean([_apart(mean[key], middle) for mean in means])
        found[key] = float(np.sqrt((own**2 + typical**2) / 2 + (_SHARE * between) ** 2 + _LEAST**2))
    return found


def _distance(apart: Mapping[str, float], units: Mapping[str, float]) -> float:
    """Return the root mean square over the figures."""
    return float(np.sqrt(np.mean([min(apart[key] / units[key], _MOST) ** 2 for key in apart])))


def length_of(inside: np.ndarray) -> float:
    """Return the correlation length of a picture (Y, X) bool, pixels."""
    return decay_length(two_point_of(inside, min(inside.shape) // 2))


@lru_cache(maxsize=len(PROCESSES))
def _trial_planes(body: str) -> np.ndarray:
    """Return planes (n, Y, X) of a small box of a process, which say how its correlation length
    goes with the distance between bodies.
    """
    return _across(process_field(body, _SIDE, _LENGTH))


def _across(field: np.ndarray) -> np.ndarray:
    """Return planes (n, Y, X) across every axis of a field."""
    side = len(field)
    places = [(2 * n + 1) * side // (2 * _SLICES) for n in range(_SLICES)]
    return np.array([field.take(place, axis) for axis in range(3) for place in places])


def distance_between_bodies(name: str, fraction: float, length: float) -> float:
    """Return the distance between bodies that gives a correlation length at a fraction, pixels."""
    body = name.removeprefix("void_")
    trial = _trial_planes(body) if name == body else -_trial_planes(body)
    cut = trial > np.quantile(trial, 1 - fraction)
    curve = np.mean([two_point_of(plane, _SIDE // 2) for plane in cut], axis=0)
    return _LENGTH * length / min(decay_length(curve), _SIDE / 2)


def _slices_of(name: str, fraction: float, apart: float) -> np.ndarray:
    """Return slices (n, Y, X) bool of a process with a fraction."""
    side = int(np.clip(round(_ACROSS * apart), *_SIDES))
    planes = _across(process_field(name, side, apart))
    return np.asarray(planes > np.quantile(planes, 1 - fraction))


def _differences(
    one: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray]
) -> dict[str, float]:
    return {key: _apart(one[key], other[key]) for key in one}


def _apart(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.sqrt(np.mean((one - other) ** 2)))
