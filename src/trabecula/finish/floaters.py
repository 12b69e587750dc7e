"""Floaters: components of a phase besides the largest one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.image import Image, as_image
from trabecula.finish.labels import background_of, check_present, lift, with_step
from trabecula.finish.periodic import periodic_setting
from trabecula.measure.labelling import joined_across
from trabecula.measure.phases import as_connectivity, as_periodic, members
from trabecula.measure.runs import runs_of


def remove_floaters(
    image: Image | ArrayLike,
    *,
    smaller_than: int | None = None,
    phase: str | int | None = None,
    connectivity: int | None = None,
    periodic: bool | Sequence[bool] = False,
) -> Image:
    """Remove the components of a phase besides its largest one.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    smaller_than : int, optional
        Remove only components of fewer voxels than this. Default: all but the largest.
    phase : str or int, optional
        Default: "solid", which is every phase but "void" taken together.
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        Neighbours of a voxel. Default: those that share a face.
    periodic : bool or one per axis
        Components that meet across opposite faces are one.

    Returns
    -------
    image : Image
        Removed voxels become void. The recipe's step holds a `report`: `removed_parts`, `removed`
        (components and voxels), `left` (components).

    Raises
    ------
    InputError
        The phase is empty; a size below 1; another connectivity; the void of an image of several
        phases.

    Examples
    --------
    >>> part = remove_floaters(np.array([[1, 1, 0, 1], [1, 0, 0, 0]]))
    >>> part.values.tolist(), part.recipe.steps[-1]["report"]["removed_parts"]
    ([[1, 1, 0, 0], [1, 0, 0, 0]], 1)
    """
    image = as_image(image)
    values = np.array(image.values, order="C")
    settings: dict[str, Any] = {
        "smaller_than": smaller_than,
        "phase": phase,
        "connectivity": connectivity,
        "periodic": periodic_setting(as_periodic(periodic, image.ndim)),
    }
    report = remove_floaters_in_place(lift(values), image, **settings)
    return with_step(image, values, "remove_floaters", settings, report)


def remove_floaters_in_place(
    values: np.ndarray,
    image: Image,
    *,
    smaller_than: int | None,
    phase: str | int | None,
    connectivity: int | None,
    periodic: bool | Sequence[bool],
) -> dict[str, int]:
    """Remove the floaters of labels (Z, Y, X) in place; return the report.

    The settings are those of `remove_floaters`; `image` names the phases, its values are not read.
    """
    if smaller_than is not None:
        smaller_than = int(
            as_number(smaller_than, name="smaller_than", low=1, high=2**62, whole=True)
        )
    background, member = background_of(image, phase), members(image, phase)
    neighbours = as_connectivity(connectivity, image.ndim)
    wraps = (False,) * (3 - image.ndim) + as_periodic(periodic, image.ndim)
    runs = joined_across(runs_of(values, member, neighbours), neighbours, wraps)
    sizes = runs.sizes
    check_present(len(sizes) > 0, phase, "floats in it")
    floats = np.ones(len(sizes), bool) if smaller_than is None else sizes < smaller_than
    floats[np.argmax(sizes)] = False
    runs.write(values, floats, background)
    removed = int(np.count_nonzero(floats))
    return {
        "removed_parts": removed,
        "removed": int(sizes[floats].sum()),
        "left": len(sizes) - removed,
    }
