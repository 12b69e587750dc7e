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
from trabecula.fields.grid import resample_array
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

_WHOLE = 0.9  # of the solid in its largest component, at least
_ROOM = 8  # correlation lengths along a side of a picture, at least
_BODIES = 10  # mean distances along a side of the relative
_LEAST_VOXELS, _MOST_VOXELS = 64, 128  # of it
_SIDE, _LENGTH = 80, 12.0  # voxels of the fields that slices are taken from, between their bodies
_SLICES = 8  # across each axis
_WIDE = 160  # pixels of a slice at the picture's scale, at most
_PICTURE = 400  # pixels of the picture that are looked at, its middle
_REACH = 3.0  # correlation lengths that curves go
_PLACES = 25  # on a curve
_SMOOTH = 0.35  # correlation lengths, before the curvature is taken
_APART = 2.0  # correlation lengths between two pixels that may lie in one component
_MOST = 6.0  # that one figure counts
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
        A process is named, and the picture does not show two phases that are alike from all sides.
    """
    why = _unfit(views, present)
    if why and asked != "auto":
        raise RequestError(f"process={asked}: {why}; leave out process")
    if why:
        return ProcessRelative(None, f"{why}: its planes alone make the volume")
    picture = views[0].image
    inside = picture.values == present[1]
    ranked = rank_processes(inside)
    if asked != "auto":
        ranked = tuple(sorted(ranked, key=lambda one: one.name != asked))
    for one in ranked:
        if asked == "auto" and one.distance > FARTHEST:
            break
        relative = _volume_of(one, float(inside.mean()), present, picture.phases)
        if asked == one.name or _holds_together(relative):
            return _chosen(one, ranked, relative)
    told = ", ".join(f"{one.name} {one.distance:.2f}" for one in ranked[:3])
    return ProcessRelative(
        None,
        f"the picture resembles no process whose solid is in one piece ({told}; {FARTHEST:g} is "
        "the most): its planes alone make the volume",
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
    one: Resemblance, fraction: float, present: Sequence[int], phases: tuple[str, ...]
) -> Image:
    """Return a volume of a process with a fraction of the second phase."""
    side = min(_MOST_VOXELS, max(_LEAST_VOXELS, round(_BODIES * one.length)))
    high = process_field(one.name, side, one.length)
    inside = high > np.quantile(high, 1 - fraction)
    values = np.where(inside, np.uint8(present[1]), np.uint8(present[0]))
    return Image(values, "labels", phases=phases)


def _holds_together(relative: Image) -> bool:
    """Return whether what is not void is in one piece, which slices do not tell and gravity does;
    yes where nothing is void.
    """
    return "void" not in relative.phases or largest_fraction(relative) >= _WHOLE


def _unfit(views: Sequence[View], present: Sequence[int]) -> str:
    """Return why no process can give the third dimension; empty where one may."""
    if len(present) != 2:
        return "a process is for labels of two phases"
    if not seen_alike(views) or not is_isotropic(views[0].image):
        return "a process is for one picture that is alike from all sides"
    inside = views[0].image.values == present[1]
    side = min(inside.shape)
    length = decay_length(_covariance(inside, side // 2))
    if not 1 <= length <= side / _ROOM:
        return (
            f"the picture is {side} pixels high or wide, its correlation length {length:.1f}: too "
            "few bodies to tell which process it is of"
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
    for name in track(tuple(PROCESSES), "comparing with processes"):
        body = name.removeprefix("void_")
        planes = _planes(body) if name == body else -_planes(body)
        slices, scale = _slices_at(planes, fraction, length)
        figures = [slice_figures(one, length) for one in slices]
        mean = {key: np.mean([one[key] for one in figures], axis=0) for key in wanted}
        spread = _mean_of([_differences(one, mean) for one in figures])
        found.append((name, scale, _differences(wanted, mean), spread))
    typical = {key: max(_LEAST, float(np.median([s[key] for *_, s in found]))) for key in wanted}
    ranked = [
        Resemblance(
            name,
            float(np.sqrt(np.mean([min(apart[k] / typical[k], _MOST) ** 2 for k in wanted]))),
            _LENGTH * scale,
        )
        for name, scale, apart, _ in found
    ]
    return tuple(sorted(ranked, key=lambda one: one.distance))


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
def _planes(name: str) -> np.ndarray:
    """Return planes (n, Y, X) across every axis of a process whose bodies are the second phase."""
    high, side = process_field(name, _SIDE, _LENGTH), _SIDE
    places = [(2 * n + 1) * side // (2 * _SLICES) for n in range(_SLICES)]
    return np.array([high.take(place, axis) for axis in range(3) for place in places])


def _slices_at(
    planes: np.ndarray, fraction: float, length: float
) -> tuple[list[np.ndarray], float]:
    """Return slices (Y, X) bool, cut at a fraction of all of them, with a correlation length in
    pixels, and the scale that gives it.
    """
    level, side = np.quantile(planes, 1 - fraction), planes.shape[1]
    curve = np.mean([_covariance(plane > level, side // 2) for plane in planes], axis=0)
    scale = length / decay_length(curve)
    width = min(side, int(_WIDE / scale))
    pixels = max(8, round(width * scale))
    slices = [resample_array(plane[:width, :width], (pixels, pixels)) > level for plane in planes]
    return slices, scale


def _differences(
    one: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray]
) -> dict[str, float]:
    return {key: float(np.sqrt(np.mean((one[key] - other[key]) ** 2))) for key in one}


def _mean_of(found: Sequence[Mapping[str, float]]) -> dict[str, float]:
    return {key: float(np.mean([one[key] for one in found])) for key in found[0]}
