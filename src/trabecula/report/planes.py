"""What a volume is held against where the exemplar is a picture: its slices, plane by plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.progress import listen
from trabecula.exemplar.views import PLANES, View, as_axis, spacing_of, views_of

SLICES = 8
"""Slices of a plane that are measured."""


@dataclass(frozen=True)
class SlicePlane:
    """A picture, and the planes of a volume that are to look like it."""

    picture: Image
    planes: tuple[str, ...]
    suffix: str
    """Of the names of its figures; empty where it is the only picture."""


def slice_planes(pictures: Sequence[Image], views: Sequence[str] = ()) -> list[SlicePlane]:
    """Every picture with its planes; `views` as of a method that learns from pictures.

    Raises
    ------
    InputError
        Pictures and planes that do not fit each other (see `views_of`).
    """
    found = _views(pictures, views)
    numbers = [0] * len(views) if len(pictures) == 1 else list(range(len(views)))
    # A view's own picture is turned already; here slices are turned as the picture lies.
    named = (
        list(zip(views, numbers, strict=True))
        if views
        else [(view.plane, view.picture) for view in found]
    )
    faces = []
    for number, picture in enumerate(pictures):
        planes = tuple(plane for plane, of in named if of == number)
        faces.append(SlicePlane(picture, planes, "_".join(planes) if len(pictures) > 1 else ""))
    return faces


def _views(pictures: Sequence[Image], views: Sequence[str]) -> Sequence[View]:
    # that other views may suit a picture better is for methods to say
    with listen(lambda label, fraction: None):
        return views_of(pictures, views)


def check_volume(image: Image, pictures: Sequence[Image], views: Sequence[str], name: str) -> None:
    """Raise where a volume has other voxels than the pictures' pixels.

    Raises
    ------
    InputError
        Another spacing or unit; not a volume.
    """
    if image.ndim != 3:
        raise InputError(
            f"{name} is a picture as well: several pictures, or named views, are for a volume"
        )
    edges, unit = spacing_of(_views(pictures, views)), pictures[0].unit
    if image.unit != unit or not np.allclose(image.spacing, edges, rtol=1e-4):
        voxel, pixel = (
            " x ".join(f"{edge:g}" for edge in sides) for sides in (image.spacing, edges)
        )
        raise InputError(
            f"voxels do not correspond: {name} has {voxel} {image.unit}, the pictures {pixel} {unit}; give both their "
            "spacing, or resample one"
        )


def take_slices(volume: Image, plane: str, count: int = SLICES) -> list[Image]:
    """Slices of a volume in a plane, evenly spread, at most `count`; rows and columns as the
    plane's name says.
    """
    axis = as_axis(plane)
    side = volume.shape[axis]
    places = [(2 * n + 1) * side // (2 * min(count, side)) for n in range(min(count, side))]
    edges = [volume.spacing["zyx".index(letter)] for letter in plane]
    found = []
    for place in places:
        values = volume.values.take(place, axis)
        values = values if plane in PLANES else values.swapaxes(0, 1)
        found.append(
            Image(
                np.ascontiguousarray(values),
                volume.kind,
                tuple(edges),
                unit=volume.unit,
                phases=volume.phases,
            )
        )
    return found
