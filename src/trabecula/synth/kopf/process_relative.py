"""A volume of the process that a picture resembles: the relative that gives its third dimension."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.exemplar.views import View, is_isotropic, is_seen_alike
from trabecula.measure.components import largest_fraction
from trabecula.synth.kopf.nearest_process import (
    Resemblance,
    distance_between_bodies,
    length_of,
    rank_processes,
)
from trabecula.synth.kopf.processes import process_field

FARTHEST = 2.0
"""Distance from which on a picture resembles no process."""

_JOINED, _PIECES = 0.9, 0.2  # of a phase in its largest component: at least, and at most
_ROOM = 12  # correlation lengths along a side of a picture, at least
_SHORTEST, _LONGEST = 1.5, 16.0  # of them, pixels: a volume of a process holds eight along a side
_BODIES = 10  # mean distances along a side of the relative
_LEAST_VOXELS, _MOST_VOXELS = 48, 128  # of it


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
        length = length_of(inside)
        apart = distance_between_bodies(asked, fraction, length)
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
        must_hold = "void" in relative.phases and relative.phases[label] != "void"
        if largest < _JOINED and (must_hold or largest > _PIECES):
            return False
    return True


def _unfit(views: Sequence[View], present: Sequence[int], *, judge: bool) -> str:
    """Return why no process can give the third dimension, to `judge` also by what the picture
    shows; empty where one may.
    """
    if len(present) != 2:
        return "a process is for labels of two phases"
    if not is_seen_alike(views) or (judge and not is_isotropic(views[0].image)):
        return "a process is for one picture that is alike from all sides"
    inside = views[0].image.values == present[1]
    side = min(inside.shape)
    length = length_of(inside)
    if not _SHORTEST <= length <= side / _ROOM:
        return (
            f"the picture is {side} pixels high or wide, its correlation length {length:.1f}: "
            "bodies too few or too small to tell which process it is of"
        )
    if length > _LONGEST:
        return (
            f"the picture's correlation length is {length:.1f} pixels, {_LONGEST:g} is the most "
            "for a process: give it with fewer pixels"
        )
    return ""
