"""Whether an image can be compared with an exemplar at all."""

from __future__ import annotations

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image


def check_corresponds(exemplar: Image, image: Image, name: str) -> None:
    """Raise where an image is not of the exemplar's kind, phases, dimension and voxels."""
    check_same_kind(exemplar, image, name)
    if image.ndim != exemplar.ndim:
        raise InputError(
            f"{name} is {image.ndim}-D, the exemplar {exemplar.ndim}-D: compare images of equal dimension, or volumes with a "
            "picture"
        )
    if image.unit != exemplar.unit or not np.allclose(image.spacing, exemplar.spacing, rtol=1e-4):
        raise InputError(
            f"voxels do not correspond: {name} has {_voxel(image)}, the exemplar {_voxel(exemplar)}; give both their "
            "spacing, or resample one"
        )


def check_same_kind(exemplar: Image, image: Image, name: str) -> None:
    """Raise where an image is not of the exemplar's kind and phases."""
    if image.kind != exemplar.kind:
        raise InputError(
            f"{name} is {image.kind}, the exemplar {exemplar.kind}: segment the one that is not labels (tb.segment, or "
            "--threshold), or give both as grey (--threshold none)"
        )
    if set(image.phases) != set(exemplar.phases):
        raise InputError(
            f"phases do not correspond: {name} has {', '.join(image.phases)}, the exemplar "
            f"{', '.join(exemplar.phases)}; give both the same names (tb.Image(..., phases=...))"
        )


def _voxel(image: Image) -> str:
    return f"{' x '.join(f'{edge:g}' for edge in image.spacing)} {image.unit}"
