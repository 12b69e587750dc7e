"""Labels of a finished image: the label of the background, of new voxels, and the recipe's step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trabecula.core.errors import InputError, UnnamedVoidError
from trabecula.core.image import Image, check_labels, phase_index, with_values
from trabecula.measure.distance import distance_transform


def background_of(image: Image, phase: str | int | None) -> int:
    """Return the label that joins run through and that removed components take.

    Raises
    ------
    UnnamedVoidError
        No phase is named void; of two phases the other one is meant where `phase` is given.
    """
    check_labels(image)
    if "void" not in image.phases:
        if phase is None or len(image.phases) > 2:
            raise UnnamedVoidError(image.phases, phase_helps=len(image.phases) == 2)
        return 1 - phase_index(image, phase, default="solid")
    void = phase_index(image, None, default="void")
    if phase is None or phase_index(image, phase, default="solid") != void:
        return void
    if len(image.phases) > 2:
        raise InputError(
            f"the void of an image of {len(image.phases)} phases cannot be connected: it is open "
            "which phase fills a removed pore; merge the others first"
        )
    return 1 - void


def check_present(present: bool, phase: str | int | None, purpose: str) -> None:
    """Raise where the phase has no voxel; `purpose` completes "nothing ...".

    Raises
    ------
    InputError
        The phase is empty.
    """
    if not present:
        name = "solid" if phase is None else phase
        raise InputError(f"the image holds nothing of phase {name!r}: nothing {purpose}")


def lift(array: np.ndarray) -> np.ndarray:
    """Return a view of an array (Z, Y, X) or (Y, X) with three axes."""
    return array.reshape((1,) * (3 - array.ndim) + array.shape)


def relabel(
    image: Image,
    before: np.ndarray,
    after: np.ndarray,
    background: int,
    wraps: Sequence[bool] | bool = False,
) -> np.ndarray:
    """Return the labels of `image` after a phase has changed from `before` to `after`.

    A voxel that leaves the phase becomes `background`. A new one takes the label of its nearest
    voxel of the phase, the lower of two labels at one distance.

    Parameters
    ----------
    image : Image
    before, after : bool array of the image's shape
    background : int
    wraps : bool or one per axis
        Distances wrap around the faces.
    """
    values = np.array(image.values, order="C")
    values[before & ~after] = background
    new = after & ~before
    present = np.flatnonzero(np.bincount(image.values[before], minlength=1))
    if len(present) == 1:
        values[new] = present[0]
    elif new.any():
        distances = [
            distance_transform(
                ~(before & (image.values == label)),
                spacing=image.spacing,
                periodic=wraps,
            )[new]
            for label in present
        ]
        values[new] = present[np.argmin(distances, axis=0)]
    return values


def with_step(
    image: Image,
    values: np.ndarray,
    operation: str,
    settings: Mapping[str, Any],
    report: Mapping[str, Any],
    **inputs: Any,
) -> Image:
    """Return the image with new labels, and the step in its recipe that gives them.

    Parameters
    ----------
    image : Image
    values : array of labels
    operation : str
        Name in `finish.operations`.
    settings, report : mapping
        Plain values.
    **inputs
        Recipes of other images that the operation takes: `exemplars`, `mask`.
    """
    recipe = image.recipe.then(
        "finish",
        values,
        operation=operation,
        settings=dict(settings),
        **inputs,
        report=dict(report),
    )
    return with_values(image, values, recipe=recipe)
