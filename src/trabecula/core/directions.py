"""Fields of directions: unit vectors whose sign does not matter, and where they have none."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from trabecula.core.brief import brief
from trabecula.core.checks import quote
from trabecula.core.errors import InputError
from trabecula.core.recipe import Recipe

_SHORT = 1e-6  # of a vector that has no direction, beside the longest of its field
_LISTED = 3  # places that an error names


@dataclass(frozen=True, eq=False)
class Directions:
    """A field of directions, with the recipe of how it came to be.

    Parameters
    ----------
    values : (Z, Y, X, 3) array
        Vectors z, y, x of any length; kept as unit vectors of float32, 0 where there is no
        direction. v and -v mean the same.
    recipe : Recipe, optional

    Raises
    ------
    InputError
        Another shape, no numbers, NaN.
    """

    values: np.ndarray
    recipe: Recipe = field(default_factory=Recipe)

    __repr__ = brief

    def __post_init__(self) -> None:
        values = as_directions(self.values, None, name="directions")
        object.__setattr__(self, "values", values)

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the voxels along z, y, x."""
        return self.values.shape[:-1]


def as_directions(given: Any, shape: tuple[int, ...] | None, *, name: str) -> np.ndarray:
    """Return unit vectors, float32: (3,) for one direction everywhere, or (Z, Y, X, 3).

    Parameters
    ----------
    given : array
        Vectors of any length, components z, y, x last.
    shape : three ints, optional
        That a field has to have; one vector is then allowed as well.
    name : str

    Raises
    ------
    InputError
        No numbers, another shape, NaN, one vector of length 0.
    """
    try:
        field = np.asarray(given)
    except ValueError:
        field = np.empty(0, object)
    if field.dtype.kind not in "iuf":
        raise InputError(f"{name}: {quote(given)} is no field of vectors: give z y x, or an array")
    if field.ndim == 1 and shape is not None:
        if field.shape != (len(shape),):
            raise InputError(f"{name} has {len(field)} numbers: give {len(shape)}, along z y x")
    elif field.ndim != 4 or field.shape[-1] != 3 or (shape and field.shape[:-1] != shape):
        wanted = "(Z, Y, X, 3)" if shape is None else f"{(*shape, len(shape))}"
        raise InputError(
            f"{name} has shape {field.shape}: give vectors (z, y, x) of shape {wanted}, the "
            "components last"
        )
    wrong = np.asarray(~np.isfinite(field).all(axis=-1))
    if wrong.any():
        raise InputError(
            f"{name} is NaN or infinite at {np.count_nonzero(wrong)} of {wrong.size} places"
            f"{list_places(wrong)}: give numbers (0 0 0 where there is no direction)"
        )
    lengths = np.sqrt(np.square(field, dtype=np.float64).sum(axis=-1, keepdims=True))
    none = lengths <= _SHORT * lengths.max(initial=0.0)
    if field.ndim == 1 and none.all():
        raise InputError(f"{name} is 0 along every axis: give a direction, such as 0 0 1")
    # unit vectors stay as they are to the last bit, so that a field read again is the same
    factor = np.where(np.abs(lengths - 1) < 1e-6, 1.0, np.where(none, 1.0, lengths))
    return np.where(none, 0.0, field / factor).astype(np.float32)


def check_poles(directions: np.ndarray, mask: np.ndarray | None, *, name: str) -> None:
    """Raise where a field (Z, Y, X, 3) has no direction at a voxel that is to be filled.

    Raises
    ------
    InputError
        With the number of such voxels, and the first of them.
    """
    if directions.ndim == 1:
        return
    poles = np.asarray(~directions.any(axis=-1))
    if mask is not None:
        poles &= mask
    if poles.any():
        raise InputError(
            f"{name} has poles: no direction at {np.count_nonzero(poles)} of "
            f"{poles.size if mask is None else np.count_nonzero(mask)} voxels"
            f"{list_places(poles)}; continue the field there (tb.fields.continue_directions)"
        )


def find_jumps(directions: np.ndarray, mask: np.ndarray | None, *, degrees: float) -> np.ndarray:
    """Return where the direction turns by more than `degrees` to the next voxel along an axis.

    Parameters
    ----------
    directions : (Z, Y, X, 3) array
        Unit vectors; 0 turns nowhere.
    mask : (Z, Y, X) bool array, optional
    degrees : float

    Returns
    -------
    jumps : (Z, Y, X) bool array
    """
    jumps = np.zeros(directions.shape[:-1], bool)
    least = np.cos(np.deg2rad(degrees))
    for axis in range(3):
        here, there = (
            tuple(slice(*ends) if k == axis else slice(None) for k in range(3))
            for ends in ((None, -1), (1, None))
        )
        known = directions[here].any(axis=-1) & directions[there].any(axis=-1)
        if mask is not None:
            known &= mask[here] & mask[there]
        cosine = np.abs(np.einsum("...i,...i->...", directions[here], directions[there]))
        jumps[here] |= known & (cosine < least)
    return jumps


def list_places(marked: np.ndarray) -> str:
    """Return the first places of a mask as text: " (first at z y x 0 4 7, 0 5 7)"."""
    if marked.ndim != 3:
        return ""
    first = np.flatnonzero(marked)[:_LISTED]
    places = zip(*np.unravel_index(first, marked.shape), strict=True)
    return " (first at z y x " + ", ".join(" ".join(map(str, place)) for place in places) + ")"
