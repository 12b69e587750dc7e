"""Floaters: parts of a phase that hang on nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, with_values
from trabecula.finish.connect import background_of
from trabecula.measure.phases import as_connectivity, members
from trabecula.measure.runs import runs_of


def remove_floaters(
    image: Image | ArrayLike,
    *,
    smaller_than: int | None = None,
    phase: str | int | None = None,
    connectivity: int | None = None,
) -> Image:
    """Remove the parts of a phase that are not joined to its largest component.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    smaller_than : int, optional
        Remove only parts of fewer voxels than this. Default: all but the largest.
    phase : str or int, optional
        Default: "solid", which is every phase but "void" taken together.
    connectivity : {6, 18, 26} in 3-D, {4, 8} in 2-D, optional
        What counts as joined. Default: voxels that share a face.

    Returns
    -------
    image : Image
        What is removed becomes void. The recipe's step holds a `report`: `removed_parts`, `removed`
        (voxels), `left` (parts).

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
    }
    report = remove_floaters_in_place(
        values.reshape((1,) * (3 - values.ndim) + values.shape), image, **settings
    )
    recipe = image.recipe.then(
        "finish", values, operation="remove_floaters", settings=settings, report=report
    )
    return with_values(image, values, recipe=recipe)


def remove_floaters_in_place(
    values: np.ndarray,
    image: Image,
    *,
    smaller_than: int | None,
    phase: str | int | None,
    connectivity: int | None,
) -> dict[str, int]:
    """As `remove_floaters`, of labels (Z, Y, X) that are written into; `image` tells what they
    mean. The report.
    """
    if smaller_than is not None:
        smaller_than = int(
            as_number(smaller_than, name="smaller_than", low=1, high=2**62, whole=True)
        )
    background, member = background_of(image, phase), members(image, phase)
    runs = runs_of(values, member, as_connectivity(connectivity, image.ndim))
    sizes = runs.sizes
    if not len(sizes):
        raise InputError(
            f"the image holds nothing of phase {'solid' if phase is None else phase!r}: nothing floats in it"
        )
    goes = np.ones(len(sizes), bool) if smaller_than is None else sizes < smaller_than
    goes[np.argmax(sizes)] = False
    runs.write(values, goes, background)
    removed = int(np.count_nonzero(goes))
    return {
        "removed_parts": removed,
        "removed": int(sizes[goes].sum()),
        "left": len(sizes) - removed,
    }
