"""Printers with their limits, parts, and the findings about a part; lengths in millimetres.

The limits are the figures that makers and print services commonly publish for desktop and service
machines of the process, not those of one machine: give your own where you know them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from trabecula.core.checks import as_number, check_name, quote
from trabecula.core.errors import InputError


@dataclass(frozen=True)
class Printer:
    """Limits of a process, in millimetres; None where it has none. Each can be replaced.

    What an estimate of mass and time takes is typical as well: machines of one process differ by
    more than half.

    Parameters
    ----------
    process : str
        "sls" (powder sintered by a laser), "sla" (resin cured by light), "fdm" (molten filament),
        "slm" (metal powder melted by a laser; the density is that of Ti-6Al-4V).
    box : (z, y, x)
        Largest part; z is the direction of the layers.
    wall : float
        Least thickness of a strut or wall.
    gap : float
        Least width of a pore that stays open.
    layer : float
        Thickness of a layer.
    density : float
        Of the material, g/cm**3.
    pause : float
        Seconds of a layer that do not depend on what is in it.
    speed : float, optional
        Material that is laid down, mm**3/s; None where a layer is made at once.
    passage : float, optional
        Least width of the path on which powder or resin is cleared out.
    cup : float, optional
        Largest volume, mm**3, of resin that may be sealed off during the print.
    overhang : float, optional
        Largest angle from the vertical, degrees, of a surface without supports.
    bridge : float, optional
        Longest span between two supports.
    """

    process: str
    box: tuple[float, float, float]
    wall: float
    gap: float
    layer: float
    density: float
    pause: float
    speed: float | None = None
    passage: float | None = None
    cup: float | None = None
    overhang: float | None = None
    bridge: float | None = None


PRINTERS: Mapping[str, Printer] = {
    "sls": Printer(
        "sls",
        box=(300.0, 165.0, 165.0),
        wall=0.7,
        gap=0.5,
        layer=0.11,
        density=0.95,
        pause=20.0,
        passage=1.5,
    ),
    "sla": Printer(
        "sla",
        box=(185.0, 145.0, 145.0),
        wall=0.5,
        gap=0.5,
        layer=0.05,
        density=1.15,
        pause=8.0,
        passage=0.5,
        cup=100.0,
    ),
    "fdm": Printer(
        "fdm",
        box=(250.0, 220.0, 220.0),
        wall=0.8,
        gap=0.5,
        layer=0.2,
        density=1.24,
        pause=2.0,
        speed=5.0,
        overhang=45.0,
        bridge=10.0,
    ),
    "slm": Printer(
        "slm",
        box=(325.0, 250.0, 250.0),
        wall=0.3,
        gap=0.3,
        layer=0.03,
        density=4.43,
        pause=12.0,
        speed=3.0,
        passage=1.0,
        overhang=45.0,
        bridge=2.0,
    ),
}

_RANGES = {"overhang": (0.0, 90.0), "cup": (0.0, 1e9)}


def printer_of(process: str, limits: Mapping[str, Any]) -> Printer:
    """Return the printer of a process, with other limits than the typical ones.

    Raises
    ------
    UnknownNameError
        No such process, or no such limit of it.
    InputError
        A limit that is no number in its range.
    """
    check_name(process, PRINTERS, name="printer")
    typical = PRINTERS[process]
    known = [
        entry.name for entry in fields(Printer)[1:] if getattr(typical, entry.name) is not None
    ]
    for name in limits:
        check_name(name, known, name=f"limit of {process}")
    return replace(typical, **{name: _limit(name, value) for name, value in limits.items()})


def _limit(name: str, value: Any) -> Any:
    low, high = _RANGES.get(name, (1e-6, 1e6))
    if name != "box":
        return as_number(value, name=name, low=low, high=high)
    sides = list(value) if isinstance(value, (list, tuple)) else [value] * 3
    if len(sides) != 3:
        raise InputError(
            f"box={quote(value)} should be one number of millimetres, or three (z, y, x)"
        )
    return tuple(as_number(side, name=name, low=low, high=high) for side in sides)


@dataclass(frozen=True)
class Finding:
    """The result of one check of a part.

    Parameters
    ----------
    name : str
    verdict : {"pass", "warn", "refuse"}
    figures : dict
        Plain values; lengths in millimetres.
    says : str
        Its meaning, and a remedy where it is no pass.
    """

    name: str
    verdict: str
    figures: dict[str, Any]
    says: str


@dataclass(frozen=True)
class Part:
    """A part in millimetres; `room` is the part with a margin of void around it."""

    solid: np.ndarray
    room: np.ndarray
    spacing: tuple[float, ...]

    @property
    def voxel(self) -> float:
        """Return the volume of a voxel, mm**3."""
        return float(np.prod(self.spacing))
