"""The form that an image fills: where a request had a mask, the outside of it is no pore."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import check_type
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.recipe import Recipe
from trabecula.finish.periodic import crop_margins
from trabecula.measure.distance import distance_transform


def as_form(mask: Image | ArrayLike | None, shape: Sequence[int]) -> np.ndarray | None:
    """Return the voxels of a form as a bool array of `shape`; None where there is none.

    Raises
    ------
    InputError
        Another shape, grey or colour, an array that is not boolean, no voxel at all.
    """
    if mask is None:
        return None
    if isinstance(mask, Image):
        if mask.kind != "labels":
            raise InputError(
                f"the mask is {mask.kind}: give labels (segment it first), or a boolean array"
            )
        inside = mask.values != (mask.phases.index("void") if "void" in mask.phases else 0)
    else:
        inside = np.asarray(mask)
        if inside.dtype != bool:
            raise InputError(
                f"the mask is {inside.dtype}: give a boolean array, such as volume > 0, or an Image"
            )
    if inside.shape != tuple(shape):
        raise InputError(
            f"the mask has shape {inside.shape}, the image {tuple(shape)}: give the mask that it "
            "was made with"
        )
    if not inside.any():
        raise InputError("the mask holds no voxel: mark with True what the form fills")
    return np.ascontiguousarray(inside)


def depth_in_form(
    form: np.ndarray, spacing: tuple[float, ...], wraps: Sequence[bool]
) -> np.ndarray:
    """Return the depth of the centres of voxels below the surface of a form, float32.

    The surface is half the smallest edge before the nearest voxel outside; the faces of the image
    belong to it where the axis is not periodic. Infinite where there is no surface.
    """
    margins = [int(not wrap) for wrap in wraps]
    around = np.pad(form, [(margin, margin) for margin in margins])
    depth = distance_transform(around, spacing=spacing, periodic=wraps)
    return crop_margins(depth, margins) - np.float32(min(spacing) / 2)


def form_recipe(mask: Image | ArrayLike | None) -> dict[str, Any]:
    """Return the entry of a recipe's step for a mask, its own recipe; empty where there is none."""
    if mask is None:
        return {}
    if isinstance(mask, Image):
        return {"mask": mask.recipe or Recipe().then("array", mask.values)}
    return {"mask": Recipe().then("array", np.asarray(mask).view(np.uint8))}


def fills_form(recipe: Recipe) -> bool:
    """Return whether the image of a recipe was generated to fill a form."""
    return mask_steps(recipe) is not None


def mask_steps(recipe: Recipe) -> list[dict[str, Any]] | None:
    """Return the recipe of the form that an image fills, as JSON; None where it fills none."""
    found = _request_of(recipe).get("mask")
    return found if isinstance(found, list) else None


def periodic_axes(recipe: Recipe) -> tuple[bool, ...]:
    """Return for each axis if the image was generated to repeat along it; empty where it was not
    generated.
    """
    return tuple(bool(wrap) for wrap in _request_of(recipe).get("periodic", ()))


def _request_of(recipe: Recipe) -> dict[str, Any]:
    """Return the request that the image of a recipe was generated for; empty where there is none,
    or where the image was cropped since: its form would have to be cropped as well.
    """
    check_type(recipe, Recipe, name="recipe", advice="an image has one (image.recipe)")
    for step in reversed(recipe.steps):
        if step["verb"] == "crop":
            break
        if step["verb"] == "generate":
            return dict(step.get("request") or {})
    return {}
