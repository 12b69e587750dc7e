"""Rotations and mirrors of the exemplar (section 5.1): more neighbourhoods to choose from.

A symmetry of the voxel grid permutes its axes and reverses some of them. With voxels of unequal
edges only those are used that map every edge onto one of the same length.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from trabecula.core.checks import as_spacing, check_name

SETS = ("none", "mirrors", "upright", "all")


@dataclass(frozen=True)
class Symmetry:
    """Axis i of the result is axis `axes[i]` of the exemplar, reversed where `reversed[i]`."""

    axes: tuple[int, ...]
    reversed: tuple[bool, ...]

    @property
    def mirrors(self) -> bool:
        """Return whether it turns a left hand into a right one."""
        order = sum(a > b for i, a in enumerate(self.axes) for b in self.axes[i + 1 :])
        return (order + sum(self.reversed)) % 2 == 1


def symmetries(
    which: str, *, ndim: int = 3, spacing: float | tuple[float, ...] | None = None
) -> tuple[Symmetry, ...]:
    """List the symmetries of a set, the identity first.

    Parameters
    ----------
    which : {"none", "mirrors", "upright", "all"}
        The identity; the 8 that reverse axes; the 16 that keep the first axis, reversed or not; all
        48 (3-D: fewer in 2-D). "upright" suits materials that grew or settled along z.
    ndim : int
        2 or 3.
    spacing : float or sequence of float, optional
        Voxel edges along every axis; default all equal.

    Raises
    ------
    UnknownNameError
        No such set.
    InputError
        A bad spacing.

    Examples
    --------
    >>> [len(symmetries(which)) for which in SETS]
    [1, 8, 16, 48]
    >>> len(symmetries("all", spacing=(2, 1, 1)))
    16
    """
    check_name(which, SETS, name="set of symmetries")
    edges = as_spacing(spacing, ndim=ndim)
    identity = tuple(range(ndim))
    orders = {
        "none": [identity],
        "mirrors": [identity],
        "upright": [(0, *rest) for rest in permutations(identity[1:])],
        "all": list(permutations(identity)),
    }[which]
    fitting = [
        axes for axes in orders if all(_same(edges[a], edges[i]) for i, a in enumerate(axes))
    ]
    flips = [(False,) * ndim] if which == "none" else list(product((False, True), repeat=ndim))
    return tuple(Symmetry(axes, flip) for axes in fitting for flip in flips)


def apply_symmetry(field: np.ndarray, symmetry: Symmetry) -> np.ndarray:
    """Return the field (C, z, y, x) or (C, y, x) under a symmetry, as a new contiguous array.

    Its values stay as they are: they must not have a direction, as a distance or a grey value has
    none.
    """
    turned = field.transpose(0, *(1 + axis for axis in symmetry.axes))
    steps = tuple(slice(None, None, -1 if back else 1) for back in symmetry.reversed)
    return np.array(turned[(slice(None), *steps)], order="C")


def _same(a: float, b: float) -> bool:
    return abs(a - b) <= 1e-6 * max(a, b)
