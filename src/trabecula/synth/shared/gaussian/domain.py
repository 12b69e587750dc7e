"""Domain of a request in three axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.request import Request


@dataclass(frozen=True)
class Domain:
    """Shape, periods and seed of a request along z, y, x; a picture is one voxel thick.

    Attributes
    ----------
    shape : three ints
    periodic : three bools
    seed : int
    flat : bool
        Whether the request is a picture.
    """

    shape: tuple[int, ...]
    periodic: tuple[bool, ...]
    seed: int
    flat: bool


def domain_of(request: Request) -> Domain:
    """Return the domain of a request, 2-D or 3-D."""
    missing = 3 - len(request.shape)
    return Domain(
        (1,) * missing + request.shape,
        (False,) * missing + request.periodic,
        request.seed,
        flat=bool(missing),
    )


def lift_box(box: Sequence[tuple[int, int]]) -> tuple[tuple[int, int], ...]:
    """Return a box in three axes."""
    return ((0, 1),) * (3 - len(box)) + tuple(box)


Use = Callable[[tuple[slice, ...], int, np.ndarray], None]
"""Gets a piece of the result, a plane of it by its number, and what was found there."""
