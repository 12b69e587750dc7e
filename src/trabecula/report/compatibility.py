"""Checks that an image can be compared with an exemplar at all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.exemplar.views import spacing_of
from trabecula.report.planes import find_views


def check_corresponds(exemplar: Image, image: Image, name: str) -> None:
    """Raise where an image is not of the exemplar's kind, phases, dimension and voxels."""
    check_same_kind(exemplar, image, name)
    if image.ndim != exemplar.ndim:
        raise InputError(
            f"{name} is {image.ndim}-D, the exemplar {exemplar.ndim}-D: compare images of equal "
            "dimension, or volumes with a picture"
        )
    if image.unit != exemplar.unit or not np.allclose(image.spacing, exemplar.spacing, rtol=1e-4):
        raise InputError(
            f"voxels do not correspond: {name} has {_voxel(image)}, the exemplar "
            f"{_voxel(exemplar)}; give both their spacing, or resample one"
        )


def check_same_kind(exemplar: Image, image: Image, name: str) -> None:
    """Raise where an image is not of the exemplar's kind and phases."""
    if image.kind != exemplar.kind:
        raise InputError(
            f"{name} is {image.kind}, the exemplar {exemplar.kind}: segment the one that is not "
            "labels (tb.segment, or --threshold), or give both as grey (--threshold none)"
        )
    if set(image.phases) != set(exemplar.phases):
        raise InputError(
            f"phases do not correspond: {name} has {', '.join(image.phases)}, the exemplar "
            f"{', '.join(exemplar.phases)}; give both the same names (tb.Image(..., phases=...))"
        )


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
    edges, unit = spacing_of(find_views(pictures, views)), pictures[0].unit
    if image.unit != unit or not np.allclose(image.spacing, edges, rtol=1e-4):
        voxel, pixel = (
            " x ".join(f"{edge:g}" for edge in sides) for sides in (image.spacing, edges)
        )
        raise InputError(
            f"voxels do not correspond: {name} has {voxel} {image.unit}, the pictures {pixel} "
            f"{unit}; give both their spacing, or resample one"
        )


def check_pictures(pictures: Sequence[Image]) -> None:
    """Raise where several exemplars are not pictures of one kind.

    Raises
    ------
    InputError
        A volume among several exemplars; kinds or phases that differ.
    """
    first = pictures[0]
    for picture in pictures:
        if picture.ndim != 2 and len(pictures) > 1:
            raise InputError(
                f"several exemplars are pictures, one is {picture.ndim}-D: give one volume, or "
                "pictures"
            )
        if picture.kind != first.kind or set(picture.phases) != set(first.phases):
            raise InputError(
                f"pictures of one material agree in kind and phases: got {first.kind} "
                f"{'/'.join(first.phases)} and {picture.kind} {'/'.join(picture.phases)}; segment "
                "or name them alike"
            )


def _voxel(image: Image) -> str:
    return f"{' x '.join(f'{edge:g}' for edge in image.spacing)} {image.unit}"
