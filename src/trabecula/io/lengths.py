"""Spacing and unit of a volume whose file does not state them, or another size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeVar, cast

from trabecula.core.checks import as_number, as_spacing
from trabecula.core.image import Image, declare_fields
from trabecula.core.recipe import Recipe
from trabecula.engine.lazy_volume import Slabs
from trabecula.io.units import canonical, check_unit

Volume = TypeVar("Volume", Image, Slabs)


def with_lengths(
    image: Volume,
    *,
    spacing: float | Sequence[float] | None = None,
    unit: str | None = None,
    scale: float | None = None,
) -> Volume:
    """Return the same voxels with other lengths, recorded in a step "declare" of the recipe.

    Parameters
    ----------
    image : Image or Slabs
    spacing : float or sequence of float, optional
        Edge of a voxel, one number or one per axis (z, y, x). Default: the image's.
    unit : str, optional
        Of the spacing, in any usual spelling. Default: the image's.
    scale : float, optional
        Factor on the spacing, above 0: 10 makes the part ten times as large.

    Raises
    ------
    InputError
        A spacing that does not fit the axes or is not above 0, a scale out of range.
    UnknownNameError
        An unknown unit.
    """
    if unit is not None:
        check_unit(unit)
    edges = image.spacing if spacing is None else as_spacing(spacing, ndim=image.ndim)
    if scale is not None:
        factor = as_number(scale, name="scale", low=1e-12, high=1e12)
        edges = tuple(edge * factor for edge in edges)
    wanted: dict[str, Any] = {
        "spacing": edges,
        "unit": image.unit if unit is None else canonical(unit),
    }
    fields = {name: value for name, value in wanted.items() if value != getattr(image, name)}
    if not fields:
        return image
    if isinstance(image, Slabs):
        # Its voxels stay as they are, and their digest with them.
        digest = str(image.recipe.steps[-1].get("sha256", "")) if image.recipe else ""
        recipe = image.recipe.then_digest("declare", digest, fields=fields)
        return cast(Volume, replace(image, **fields, recipe=recipe))
    if not image.recipe:
        image = replace(image, recipe=Recipe().then("array", image.values))
    return declare_fields(image, **fields)
