"""The centred box of an image that a solver takes, and the check of its memory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.core.checks import as_shape
from trabecula.engine.memory import Plan, check_budget


def box_sides(box: int | Sequence[int] | None, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the sides of a box given as one edge or one per axis, no longer than the image's;
    `None` is the whole image.
    """
    if box is None:
        return shape
    asked = as_shape(box, ndim=len(shape), name="box")
    return tuple(min(side, length) for side, length in zip(asked, shape, strict=True))


def centre(values: np.ndarray, sides: Sequence[int]) -> np.ndarray:
    """Return the centred box of an array; no side may be longer than the array's."""
    starts = [(length - side) // 2 for length, side in zip(values.shape, sides, strict=True)]
    return values[
        tuple(slice(first, first + side) for first, side in zip(starts, sides, strict=True))
    ]


def centre_box(values: np.ndarray, side: int) -> np.ndarray:
    """Return the centred box of an array of at most `side` voxels along every axis."""
    return centre(values, box_sides(side, values.shape))


def check_memory(need: int) -> None:
    """Raise `MemoryBudgetError` where a solver would need more bytes than there are."""
    check_budget(Plan({"solver": need}), advice="solve a smaller centre box (box=, or --box)")
