"""Which process a picture resembles, and a volume of it: slices of every one, at the picture's
fraction and scale, beside the picture.

Ten figures of a picture of two phases, all in correlation lengths: its covariance; of either phase
the lineal path, the depths of its pixels, the number of components and how far they reach; the
curvature of the interface. A figure's distance counts in what single slices of one process differ
by.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.exemplar.views import View, is_isotropic
from trabecula.measure.components import largest_fraction
from trabecula.measure.correlation import covariance_form, decay_length, lineal_path, two_point
from trabecula.measure.distance import distance_transform
from trabecula.measure.labelling import label_components
from trabecula.measure.smooth import gaussian, reach_of
from trabecula.synth.kopf.config import PROCESSES
from trabecula.synth.kopf.processes import process_field
from trabecula.synth.kopf.relative import is_isotropic as seen_alike

FARTHEST = 2.0
"""Distance from which on a picture resembles no process."""

_JOINED, _PIECES = 0.9, 0.2  # of a phase in its largest component: at least, and at most
_ROOM = 12  # correlation lengths along a side of a picture, at least
_LONGEST = 16.0  # of them, pixels: a volume to be learnt from holds eight along a side
_BODIES = 10  # mean distances along a side of the relative
_LEAST_VOXELS, _MOST_VOXELS = 64, 128  # of it
_SIDE, _LENGTH = 64, 10.0  # voxels of the fields of a trial, between their bodies
_SIDES = (64, 112)  # voxels of the fields that slices are taken from
_ACROSS = 8  # mean distances along a side of them
_SLICES = 8  # across each axis
_PICTURE = 400  # pixels of the picture that are looked at, its middle
_REACH = 3.0  # correlation lengths that curves go
_PLACES = 25  # on a curve
_SMOOTH = 0.35  # correlation lengths, before the curvature is taken
_APART = 2.0  # correlation lengths between two pixels that may lie in one component
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


@dataclass(frozen=True)
class ProcessRelative:
    """A volume of the process that a picture resembles.

    Attributes
    ----------
    relative : Image of labels, optional
        None where the planes alone are to make the volume.
    line : str
        What was found, for the user.
    report : mapping
        For the recipe: plain JSON.
    """

    relative: Image | None
    line: str
    report: dict[str, Any] = field(default_factory=dict)


def choose_process(views: Sequence[View], present: Sequence[int], asked: str) -> ProcessRelative:
    """Return a volume of the process "auto", or that of a name, for the picture of some views.

    Raises
    ------
    RequestError
        A process is named, and there is not one picture of two phases for all sides.
    """
    why = _unfit(views, present, judge=asked == "auto")
    if why and asked != "auto":
        raise RequestError(f"process={asked}: {why}; leave out process")
    if why:
        return ProcessRelative(None, f"{why}: its planes alone make the volume")
    picture = views[0].image
    inside = picture.values == present[1]
    fraction = float(inside.mean())
    if asked != "auto":
        length = decay_length(_covariance(inside, min(inside.shape) // 2))
        apart = _apart_for(asked, fraction, length)
        return ProcessRelative(
            _volume_of(asked, apart, fraction, present, picture.phases),
            f"in space as the process {asked}, which was asked for",
            {"process": asked, "length": apart},
        )
    ranked = rank_processes(inside)
    for one in ranked:
        if one.distance > FARTHEST:
            break
        relative = _volume_of(one.name, one.length, fraction, present, picture.phases)
        if _is_likely(relative, present):
            return _chosen(one, ranked, relative)
    told = ", ".join(f"{one.name} {one.distance:.2f}" for one in ranked[:3])
    return ProcessRelative(
        None,
        f"the picture resembles no process that holds together ({told}; {FARTHEST:g} is the "
        "most): its planes alone make the volume",
    )


def _chosen(
    nearest: Resemblance, ranked: Sequence[Resemblance], relative: Image
) -> ProcessRelative:
    others = ", ".join(f"{one.name} {one.distance:.2f}" for one in ranked[:3] if one != nearest)
    return ProcessRelative(
        relative,
        f"in space as the process {nearest.name}, whose slices the picture resembles "
        f"({nearest.distance:.2f}; beside {others}): a picture does not decide it",
        {
            "process": nearest.name,
            "length": nearest.length,
            "distances": {one.name: round(one.distance, 3) for one in ranked},
        },
    )


def _volume_of(
    name: str, apart: float, fraction: float, present: Sequence[int], phases: tuple[str, ...]
) -> Image:
    """Return a volume of a process with a fraction of the second phase."""
    side = min(_MOST_VOXELS, max(_LEAST_VOXELS, round(_BODIES * apart)))
    high = process_field(name, side, apart)
    inside = high > np.quantile(high, 1 - fraction)
    values = np.where(inside, np.uint8(present[1]), np.uint8(present[0]))
    return Image(values, "labels", phases=phases)


def _is_likely(relative: Image, present: Sequence[int]) -> bool:
    """Return whether a process may be a material, where slices say nothing of it: what is not void
    is in one piece, or it would fall apart; any phase is joined or in pieces, not on the threshold
    between them, where few materials are.
    """
    for label in present:
        largest = largest_fraction(relative, phase=label)
        holds = "void" in relative.phases and relative.phases[label] != "void"
        if largest < _JOINED and (holds or largest > _PIECES):
            return False
    return True


def _unfit(views: Sequence[View], present: Sequence[int], *, judge: bool) -> str:
    """Return why no process can give the third dimension, to `judge` also by what the picture
    shows; empty where one may.
    """
    if len(present) != 2:
        return "a process is for labels of two phases"
    if not seen_alike(views) or (judge and not is_isotropic(views[0].image)):
        return "a process is for one picture that is alike from all sides"
    inside = views[0].image.values == present[1]
    side = min(inside.shape)
    length = decay_length(_covariance(inside, side // 2))
    if not 1 <= length <= side / _ROOM:
        return (
            f"the picture is {side} pixels high or wide, its correlation length {length:.1f}: too "
            "few bodies to tell which process it is of"
        )
    if length > _LONGEST:
        return (
            f"the picture's correlation length is {length:.1f} pixels, {_LONGEST:g} is the most "
            "for a process: give it with fewer pixels"
        )
    return ""


def rank_processes(inside: np.ndarray) -> tuple[Resemblance, ...]:
    """Return how far a picture (Y, X) bool of both phases is from every process, nearest first."""
    middle = tuple(
        slice((side - min(side, _PICTURE)) // 2, (side + min(side, _PICTURE)) // 2)
        for side in inside.shape
    )
    picture = np.ascontiguousarray(inside[middle])
    fraction = float(picture.mean())
    length = decay_length(_covariance(picture, min(picture.shape) // 2))
    wanted = slice_figures(picture, length)
    found = []
    for name in track(PROCESSES, "comparing with processes"):
        apart = _apart_for(name, fraction, length)
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


def slice_figures(inside: np.ndarray, length: float) -> dict[str, np.ndarray]:
    """Return the figures of a picture (Y, X) bool, as arrays, by a correlation length in pixels."""
    places = np.linspace(0, _REACH, _PLACES) * length
    reach = min(int(places[-1]) + 1, min(inside.shape) // 2)
    found = {
        "covariance": _at(places, covariance_form(_covariance(inside, reach))),
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


def _covariance(inside: np.ndarray, reach: int) -> np.ndarray:
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


def _apart_for(name: str, fraction: float, length: float) -> float:
    """Return the distance between bodies that gives a correlation length at a fraction, pixels."""
    body = name.removeprefix("void_")
    trial = _trial_planes(body) if name == body else -_trial_planes(body)
    cut = trial > np.quantile(trial, 1 - fraction)
    curve = np.mean([_covariance(plane, _SIDE // 2) for plane in cut], axis=0)
    return _LENGTH * length / decay_length(curve)


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
