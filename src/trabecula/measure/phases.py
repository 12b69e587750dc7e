"""The voxels of a phase: the one place where "solid" and "void" get their meaning.

Without a phase, "void" is the phase of that name and "solid" is everything else: with two phases
the phase named solid, with more of them their union. A phase that is given, by name or number, is
that phase alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import quote
from trabecula.core.errors import InputError, UnnamedVoidError
from trabecula.core.image import Image, as_image, check_labels, phase_index


def indicator(
    image: Image | ArrayLike, phase: str | int | None, *, default: str = "solid"
) -> tuple[Image, np.ndarray]:
    """Return the image, and a boolean array that is True in the phase.

    Parameters
    ----------
    image : Image or array, (Z, Y, X) or (Y, X)
        Labels.
    phase : str or int, optional
        Default: `default`.
    default : {"solid", "void"}

    Raises
    ------
    InputError
        Not labels, no such phase, or no phase given where none is named "void".
    """
    image = as_image(image)
    label, without = _label_and_sense(image, phase, default)
    return image, image.values != label if without else image.values == label


def members(image: Image, phase: str | int | None, *, default: str = "solid") -> np.ndarray:
    """Return whether voxels of a label belong to the phase, (256,) bool: as `indicator`, without an
    array of the image's size.
    """
    label, without = _label_and_sense(image, phase, default)
    return (np.arange(256) != label) if without else (np.arange(256) == label)


def _label_and_sense(image: Image, phase: str | int | None, default: str) -> tuple[int, bool]:
    """Return a label, and whether the phase is everything but that."""
    check_labels(image)
    if phase is None and "void" not in image.phases:
        raise UnnamedVoidError(image.phases)
    if phase is None and default == "solid":
        return phase_index(image, None, default="void"), True
    return phase_index(image, phase, default=default), False


def as_periodic(value: bool | Sequence[bool], ndim: int) -> tuple[bool, ...]:
    """Return whether the image repeats beyond its faces, for every axis; one bool means all of
    them.
    """
    wraps = (value,) * ndim if isinstance(value, (bool, np.bool_)) else value
    if (
        not isinstance(wraps, (Sequence, np.ndarray))
        or np.ndim(wraps) != 1
        or not all(
            isinstance(wrap, (int, float, np.bool_, np.number)) and wrap in (False, True)
            for wrap in wraps
        )
    ):
        raise InputError(
            f"periodic is {quote(value)}: give True or False, or one of them for each of the "
            f"{ndim} axes"
        )
    if len(wraps) != ndim:
        raise InputError(
            f"periodic has {len(wraps)} values: give one, or one for each of the {ndim} axes"
        )
    return tuple(bool(wrap) for wrap in wraps)


def as_axis(axis: int, ndim: int) -> int:
    """Return an axis counted from 0; negative ones count from the last."""
    if (
        isinstance(axis, bool)
        or not isinstance(axis, (int, np.integer))
        or not -ndim <= axis < ndim
    ):
        names = "0 (y) or 1 (x)" if ndim == 2 else "0 (z), 1 (y) or 2 (x)"
        raise InputError(
            f"axis {quote(axis)} does not exist: the image has {ndim} axes, give {names}"
        )
    return int(axis) % ndim


def as_connectivity(connectivity: int | None, ndim: int) -> int:
    """Return a number of neighbours that voxels can have; by default those that share a face."""
    allowed = (4, 8) if ndim == 2 else (6, 18, 26)
    if connectivity is None:
        return allowed[0]
    if not isinstance(connectivity, (int, np.integer)) or connectivity not in allowed:
        raise InputError(
            f"connectivity {quote(connectivity)} does not exist in {ndim}-D: give "
            f"{', '.join(map(str, allowed))}"
        )
    return connectivity


def check_sides(shape: tuple[int, ...], *, least: int = 2, what: str) -> None:
    """Raise where a side is shorter than `what` needs."""
    if min(shape) < least:
        slice_of = (
            "; give a single slice as a 2-D image (values[0])"
            if len(shape) == 3 and min(shape) == 1
            else ""
        )
        raise InputError(
            f"an image of shape {shape} {what}: at least {least} voxels along every axis are "
            f"needed{slice_of}"
        )


def check_mask(mask: np.ndarray, shape: tuple[int, ...]) -> None:
    """Raise where a mask is not a boolean array of `shape`, or holds no voxel."""
    if mask.dtype != bool or mask.shape != shape:
        raise InputError(
            f"the mask is {mask.dtype} of shape {mask.shape}: a boolean array of shape {shape} is "
            "needed"
        )
    if not mask.any():
        raise InputError("the mask holds no voxel: mark with True what counts")


def as_mask(mask: ArrayLike | None, shape: tuple[int, ...]) -> np.ndarray | None:
    """Return the region that counts as a boolean array of `shape`; `None` stands for the whole
    image.
    """
    if mask is None:
        return None
    array = np.asarray(mask)
    check_mask(array, shape)
    return array


def indicator_in_mask(
    image: Image | ArrayLike,
    phase: str | int | None,
    mask: ArrayLike | None,
    *,
    default: str = "solid",
) -> tuple[Image, np.ndarray, np.ndarray | None]:
    """Return the image, the phase as `indicator`, True only inside the mask, and the mask,
    checked.
    """
    image, inside = indicator(image, phase, default=default)
    region = as_mask(mask, image.shape)
    return image, inside if region is None else inside & region, region


def as_inside(inside: ArrayLike, *, name: str = "inside") -> np.ndarray:
    """Return a boolean array of 2 or 3 axes, C-contiguous, lifted to (Z, Y, X) (a 2-D array is one
    slice).
    """
    array = np.asarray(inside)
    if array.ndim not in (2, 3) or array.size == 0:
        raise InputError(f"{name} has 2 or 3 axes and is not empty: got shape {array.shape}")
    if array.dtype != bool:
        if array.dtype != np.uint8 or array.max() > 1:
            raise InputError(
                f"{name} is a boolean array, got {array.dtype}: compare with a label first "
                "(values == 1)"
            )
        array = array.view(bool) if array.flags.c_contiguous else array.astype(bool)
    return np.ascontiguousarray(array if array.ndim == 3 else array[None])
