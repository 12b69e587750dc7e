"""What to make: `Request`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from trabecula.core.checks import as_seed, as_shape
from trabecula.core.errors import InputError
from trabecula.core.image import Image


@dataclass(frozen=True, eq=False)
class Request:
    """What a model is asked for. Methods say which fields beyond `shape` and `seed` they honour.

    Parameters
    ----------
    shape : int or sequence of int
        Voxels along z, y, x; one number means a cube.
    seed : int
        0 .. 2**63 - 1. The same request gives the same voxels.
    periodic : bool or sequence of bool
        Axes along which the result repeats without a seam.
    mask : (Z, Y, X) bool array, optional
        The form to fill; outside it the result is void.
    target : mapping of str to (Z, Y, X) float array
        Descriptor fields to follow, by the descriptor's name.
    fixed : Image, optional
        Measured voxels that must come out unchanged.
    """

    shape: tuple[int, ...]
    seed: int = 0
    periodic: tuple[bool, ...] = (False, False, False)
    mask: np.ndarray | None = None
    target: Mapping[str, np.ndarray] = field(default_factory=dict)
    fixed: Image | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", as_shape(self.shape))
        object.__setattr__(self, "seed", as_seed(self.seed))
        object.__setattr__(self, "periodic", _as_periodic(self.periodic))

    def asks_for(self) -> frozenset[str]:
        """The optional parts of the request that are in use."""
        used = {"periodic": any(self.periodic), "mask": self.mask is not None}
        used |= {"target": bool(self.target), "fixed": self.fixed is not None}
        return frozenset(name for name, asked in used.items() if asked)


def _as_periodic(value: bool | Sequence[bool]) -> tuple[bool, ...]:
    axes = (bool(value),) * 3 if isinstance(value, (bool, np.bool_)) else tuple(bool(axis) for axis in value)
    if len(axes) != 3:
        raise InputError(f"periodic takes one truth value or three (z, y, x): got {value!r}")
    return axes
