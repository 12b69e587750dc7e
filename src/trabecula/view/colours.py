"""Colour volumes: where their material is, and the few colours that the quick still draws."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.measure.labelling import label_components
from trabecula.view.colouring import FieldColours

STEPS = 6
"""Colours along each channel of the quick still; each is the mean of what falls into it."""


def form_of(image: Image, form: Image | ArrayLike | None) -> np.ndarray:
    """Return (Z, Y, X) uint8, 1 where a colour volume is material.

    Parameters
    ----------
    image : Image of kind colour
    form : Image of labels or bool array, (Z, Y, X), optional
        Given, it says. Without one the material is everywhere, but in a volume that was made in a
        mask, as its recipe says: there what is black and joined to a face of the volume is outside.

    Raises
    ------
    InputError
        A form of another shape or kind, or one that is empty.
    """
    if form is not None:
        values = np.asarray(form.values if isinstance(form, Image) else form)
        if values.shape != image.shape:
            raise InputError(
                f"form has shape {values.shape}, the volume {image.shape}: give True where there "
                "is material, voxel by voxel"
            )
        inside = (values > 0).view(np.uint8)
    elif _has_mask(image):
        black = ~image.values.any(axis=-1)
        labels, _ = label_components(black)
        faces = [np.take(labels, [0, -1], axis=axis).ravel() for axis in range(3)]
        outside = np.zeros(labels.max() + 1, bool)
        outside[np.concatenate(faces)] = True
        outside[0] = False
        inside = (~outside[labels]).view(np.uint8)
    else:
        return np.ones(image.shape, np.uint8)
    if not inside.any():
        raise InputError("the form of the colour volume is empty: no voxel of it is material")
    return inside


def _has_mask(image: Image) -> bool:
    """Return whether the image was made in a mask."""
    return any(
        step.get("verb") == "generate" and (step.get("request") or {}).get("mask")
        for step in image.recipe.to_json()
    )


def few_colours(image: Image, inside: np.ndarray) -> FieldColours:
    """Return a colour volume as bands of at most STEPS^3 colours, 0 where it is no material."""
    labels = np.zeros(image.shape, np.uint8)
    count, total = np.zeros(STEPS**3), np.zeros((3, STEPS**3))
    for values, kept, out in zip(image.values, inside > 0, labels, strict=True):
        steps = values.astype(np.uint16) * STEPS // 256
        found = ((steps[..., 0] * STEPS + steps[..., 1]) * STEPS + steps[..., 2])[kept]
        out[kept] = found + 1
        count += np.bincount(found, minlength=STEPS**3)
        for c in range(3):
            total[c] += np.bincount(found, weights=values[..., c][kept], minlength=STEPS**3)
    means = np.rint(total / np.maximum(count, 1)).T
    return FieldColours(labels, np.concatenate([[(0, 0, 0)], means]).astype(np.uint8), None)
