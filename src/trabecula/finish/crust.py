"""Crust: a closed wall of the solid just below the surface of a form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.finish.forms import as_form, depth_in_form, fills_form, form_recipe
from trabecula.finish.labels import background_of, check_present, relabel, with_step
from trabecula.finish.periodic import periodic_setting
from trabecula.measure.phases import as_periodic, indicator


def add_crust(
    image: Image | ArrayLike,
    *,
    thickness: float,
    phase: str | int | None = None,
    mask: Image | ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> Image:
    """Add a closed wall below the surface of a form, on which its struts end.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    thickness : float
        Of the wall, in the image's unit: at least one voxel along every axis, and less than the
        form's greatest depth. The wall is rounded to whole voxels, by half the smallest edge.
    phase : str or int, optional
        Default: "solid", which is every phase but "void" taken together.
    mask : Image of labels or (Z, Y, X) bool array, optional
        The form that the image fills (as `Request.mask`). Default: the whole image, whose faces are
        the surface then.
    periodic : bool or one per axis
        The form continues at the opposite face: there it has no surface.

    Returns
    -------
    image : Image
        Only void of the form is replaced. New voxels take the nearest label. The void inside is
        closed: it meets the outside across no face and no edge of a voxel. The recipe's step holds
        a `report`: `added`, `wall` (voxels that are new, and of the wall), `share` (of the wall in
        the form, 0..1).

    Raises
    ------
    InputError
        The phase is empty; a form without void, without a surface, or nowhere deeper than the wall;
        a thickness below a voxel; a mask of another shape, or none where the recipe names one.

    Examples
    --------
    >>> struts = np.zeros((20, 20), int); struts[:, 10] = 1
    >>> part = add_crust(struts, thickness=2)
    >>> part.values[5, :4].tolist(), part.recipe.steps[-1]["report"]["wall"]
    ([1, 1, 0, 0], 144)
    """
    background = background_of(as_image(image), phase)
    image, inside = indicator(image, phase)
    wraps = as_periodic(periodic, image.ndim)
    form = as_form(mask, image.shape)
    if form is None:
        if fills_form(image.recipe):
            raise InputError(
                "the image fills a form: give it (mask, --mask), so that the crust follows its "
                "surface and not the faces of its box"
            )
        form = np.ones(image.shape, bool)
    thickness = _as_thickness(thickness, image)
    check_present(bool(inside.any()), phase, "to make a crust of")
    void = form & (image.values == background)
    if not void.any():
        raise InputError("the form holds no void: it needs no crust")
    depth = depth_in_form(form, image.spacing, wraps)
    wall = form & (depth < thickness)
    _check_room(form, wall, depth, thickness, image)
    values = relabel(image, inside, inside | (void & wall), background, wraps)
    share = np.count_nonzero(wall) / np.count_nonzero(form)
    report = {
        "added": np.count_nonzero(void & wall),
        "wall": np.count_nonzero(wall),
        "share": round(share, 6),
    }
    settings = {"thickness": thickness, "phase": phase, "periodic": periodic_setting(wraps)}
    return with_step(image, values, "add_crust", settings, report, **form_recipe(mask))


def _as_thickness(thickness: float, image: Image) -> float:
    """Return the thickness of a wall that the image's voxels can show."""
    extent = max(side * edge for side, edge in zip(image.shape, image.spacing, strict=True))
    thickness = as_number(thickness, name="thickness", low=0, high=extent)
    if thickness < max(image.spacing) * (1 - 1e-9):  # an edge such as 0.1 has a rounding error
        raise InputError(
            f"a crust of {thickness:g} is thinner than a voxel of {max(image.spacing):g} "
            f"{image.unit}: it would be open; give at least the longest edge of a voxel"
        )
    return thickness


def _check_room(
    form: np.ndarray, wall: np.ndarray, depth: np.ndarray, thickness: float, image: Image
) -> None:
    """Raise where the wall is nothing of the form, or all of it."""
    if not wall.any():
        raise InputError(
            "the form has no surface: it fills the image, which is periodic along all axes; name "
            "the axes that are"
        )
    if not (form & ~wall).any():
        raise InputError(
            f"no voxel of the form is deeper than a crust of {thickness:g}, the deepest is "
            f"{depth.max():g} {image.unit} below the surface: take a thinner crust, or a larger "
            "form"
        )
