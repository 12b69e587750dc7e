"""Settings of `lattice`: the only home of its defaults."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import Any

from trabecula.core.checks import as_number, check_name
from trabecula.core.errors import InputError
from trabecula.core.expression import Expression

_HALVES = tuple(p for p in product((0.0, 0.5), repeat=3) if sum(p) in (0, 1))  # face-centred

# Terms in the sines s and cosines c of 2 pi times the cell coordinates, S and C of twice that,
# summed over the cyclic permutations i, j, k of the axes.
SURFACES: dict[str, Callable[..., Any]] = {
    "gyroid": lambda s, c, S, C, i, j, k: s[i] * c[j],
    "schwarz_p": lambda s, c, S, C, i, j, k: c[i],
    "schwarz_d": lambda s, c, S, C, i, j, k: (c[i] * c[j] * c[k] - s[i] * s[j] * s[k]) / 3,
    "iwp": lambda s, c, S, C, i, j, k: 2 * c[i] * c[j] - C[i],
    "neovius": lambda s, c, S, C, i, j, k: 3 * c[i] + 4 / 3 * c[i] * c[j] * c[k],
    "fischer_koch_s": lambda s, c, S, C, i, j, k: C[i] * s[j] * c[k],
    "frd": lambda s, c, S, C, i, j, k: 4 / 3 * c[i] * c[j] * c[k] - C[i] * C[j],
}
"""Functions whose zeros are, to a few per mille, the minimal surfaces."""

STRUTS: dict[str, Sequence[tuple[float, ...]]] = {
    "simple_cubic": ((0, 0, 0),),
    "bcc": ((0, 0, 0), (0.5, 0.5, 0.5)),
    "fcc": _HALVES,
    "octet": _HALVES,
    "kelvin": sorted({p for side in (0.25, 0.75) for p in permutations((0, side, 0.5))}),
    "diamond": [tuple(c + d for c in p) for p in _HALVES for d in (0, 0.25)],
}
"""Nodes of a cell; struts join the nearest of them, of "fcc" only those at corners to others."""

NAMES = ("z", "y", "x", "Z", "Y", "X")


@dataclass(frozen=True)
class LatticeConfig:
    """Settings of `lattice`."""

    cell: str = "gyroid"
    """Minimal surface: "gyroid", "schwarz_p", "schwarz_d", "iwp", "neovius", "fischer_koch_s",
    "frd"; or struts: "simple_cubic", "bcc", "fcc", "octet", "kelvin", "diamond"."""

    phase: str = "sheet"
    """Solid of a surface: "sheet", a wall along it, or "network", one of its two sides. Struts are
    round either way."""

    porosity: float = 0.7
    """Volume fraction of the void, above 0 and below 1, where the request has no target."""

    cell_size: float | tuple[float, ...] | None = None
    """Edge of a cell in the image's unit, one number or three (z, y, x), at least 4 voxels. None:
    16 voxels. Along a periodic axis it is rounded so that whole cells fit."""

    direction: tuple[float, ...] = (1.0, 0.0, 0.0)
    """Direction (z, y, x) of the cell's z axis; it is turned there the shortest way."""

    coordinates: tuple[str, ...] | None = None
    """Formulas of the cell coordinates along z, y, x, which grow by 1 from cell to cell, in the
    position z, y, x and the sides Z, Y, X of the whole, in the image's unit: cells whose size and
    orientation change from place to place. Instead of cell_size and direction."""

    def __post_init__(self) -> None:
        check_name(self.cell, (*SURFACES, *STRUTS), name="cell")
        check_name(self.phase, ("sheet", "network"), name="phase of a lattice")
        porosity = as_number(self.porosity, name="porosity", low=0, high=1)
        if porosity in (0, 1):
            raise InputError(
                f"porosity={porosity:g} leaves one phase: give more than 0, less than 1"
            )
        object.__setattr__(self, "porosity", float(porosity))
        if self.cell_size is not None:
            object.__setattr__(self, "cell_size", _sizes(self.cell_size))
        direction = _three(self.direction, "direction")
        found = tuple(as_number(one, name="direction", low=-1e6, high=1e6) for one in direction)
        if not any(found):
            raise InputError("direction is 0 along every axis: give a vector, such as [1, 1, 1]")
        object.__setattr__(self, "direction", tuple(map(float, found)))
        if self.coordinates is not None:
            formulas = _three(self.coordinates, "coordinates")
            object.__setattr__(self, "coordinates", formulas)
            for text in formulas:
                Expression(text, NAMES)
            if self.cell_size is not None or found != (1, 0, 0):
                raise InputError("coordinates say size and direction: leave those out")


def _three(value: Any, name: str) -> tuple[Any, ...]:
    if not isinstance(value, (list, tuple)) or len(value) != 3:
        raise InputError(f"{name}={value!r} should be three, along z, y, x")
    return tuple(value)


def _sizes(value: Any) -> float | tuple[float, ...]:
    if isinstance(value, (list, tuple)):
        return tuple(
            float(as_number(one, name="cell_size", low=1e-20, high=1e20))
            for one in _three(value, "cell_size")
        )
    return float(as_number(value, name="cell_size", low=1e-20, high=1e20))
