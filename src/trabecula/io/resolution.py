"""Resolution tags of pictures as voxel sizes: pixels per inch, centimetre or metre.

Most of them are habits of programs (72, 96, 300 dpi, 1 a unit) and tell how large to print. Those
are no voxel sizes; which were left aside, and why, is kept beside what was found.
"""

from __future__ import annotations

from typing import NamedTuple

from trabecula.io.units import canonical

PRINTED = 600.0
"""Pixels per inch up to which an inch is one of paper, or of a screen: specimens are not measured
in it.
"""

# fmt: off
_HABITS = (
    72, 75, 90, 96, 100, 120, 144, 150, 180, 192, 200, 220,
    240, 250, 300, 350, 360, 400, 600, 720, 1200,
)
# fmt: on
_SMALLEST, _LARGEST = 1e-10, 0.1  # metres a voxel
_INCHES = {"inch": 1.0, "cm": 2.54, "m": 0.0254}  # to pixels per inch
_METRES = {"inch": 0.0254, "cm": 0.01, "m": 1.0}


class Calibration(NamedTuple):
    """A spacing with where it comes from, or why there is none.

    Attributes
    ----------
    spacing : tuple of float, optional
        Edge of a voxel along (z, y, x).
    unit : str, optional
    origin : str
        Where the spacing comes from, as words: "OME metadata".
    ignored : str
        What was left aside and why; empty where nothing was.
    """

    spacing: tuple[float, ...] | None = None
    unit: str | None = None
    origin: str = ""
    ignored: str = ""


def from_resolution(y: float, x: float, unit: str, *, what: str, ndim: int = 2) -> Calibration:
    """Return the voxels of a picture of y and x pixels a unit, where that is plausible as a voxel
    size.

    Parameters
    ----------
    y, x : float
        Above 0.
    unit : {"inch", "cm", "m"}
    what : str
        The tags' name in messages.
    ndim : int
        Axes of the image; such tags say nothing of a third one.
    """
    per = {"inch": "dpi", "cm": "a cm", "m": "a metre"}[unit]
    stated = f"{x:g} {per}" if x == y else f"{y:g} x {x:g} {per} (y, x)"
    why = _unlikely(y, unit) or _unlikely(x, unit)
    if why:
        return Calibration(
            ignored=f"{what} say {stated}, {why}: ignored; give the spacing where it is known "
            "(--spacing, --unit)"
        )
    if ndim != 2:
        return Calibration(
            ignored=f"{what} say {stated} and nothing of z: ignored; give the spacing (--spacing, "
            "--unit)"
        )
    known, factor = {"inch": ("mm", 25.4), "cm": ("cm", 1.0), "m": ("um", 1e6)}[unit]
    return Calibration((factor / y, factor / x), known, f"{what} ({stated})")


def _unlikely(value: float, unit: str) -> str:
    """Return why a resolution is no voxel size; empty where it may be one."""
    dpi = value * _INCHES[unit]
    if value == 1:
        return "which programs write that know no size"
    for habit in _HABITS:
        rounded = 0.5 if unit == "cm" and value == round(value) and value < 121 else 0.0
        if abs(value - habit / _INCHES[unit]) <= max(rounded, 0.002 * habit / _INCHES[unit]):
            return f"the {habit} dpi of prints and screens, no voxel size"
    if unit != "cm" and dpi <= PRINTED:
        return "a resolution of prints and screens, no voxel size"
    if not _SMALLEST <= _METRES[unit] / value <= _LARGEST:
        return f"voxels of {_METRES[unit] / value:.3g} m, hardly those of a material"
    return ""


def plausible(found: Calibration) -> Calibration:
    """Return the calibration, none where it is a print's resolution taken over as inches."""
    if found.spacing is None or canonical(found.unit or "") != "inch":
        return found
    y, x = (1 / edge for edge in found.spacing[-2:])
    tags = from_resolution(y, x, "inch", what=f"{found.origin} in inches")
    return Calibration(ignored=tags.ignored) if tags.ignored else found
