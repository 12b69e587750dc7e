"""Units of length: one table of names, spellings and factors for every format.

An Image's unit is one of the short names below, or "voxel" where no length is known.
"""

from __future__ import annotations

from trabecula.core.checks import check_name, quote
from trabecula.core.errors import InputError

# short name -> (metres, the long name that OME-Zarr writes, the symbol that OME-XML writes)
_LENGTHS: dict[str, tuple[float, str, str]] = {
    "pm": (1e-12, "picometer", "pm"),
    "angstrom": (1e-10, "angstrom", "Å"),
    "nm": (1e-9, "nanometer", "nm"),
    "um": (1e-6, "micrometer", "µm"),
    "mm": (1e-3, "millimeter", "mm"),
    "cm": (1e-2, "centimeter", "cm"),
    "m": (1.0, "meter", "m"),
    "inch": (0.0254, "inch", "in"),
    "km": (1e3, "kilometer", "km"),
}

NO_LENGTH = "voxel"

_SPELLINGS = {
    "µm": "um",  # the micro sign
    "μm": "um",  # the Greek letter
    "\\u00b5m": "um",  # as ImageJ escapes it
    "micron": "um",
    "microns": "um",
    "in": "inch",
    "inches": "inch",
    "å": "angstrom",
    "voxels": NO_LENGTH,
    "pixel": NO_LENGTH,
    "pixels": NO_LENGTH,
    "px": NO_LENGTH,
}
for _short, (_metres, _long, _symbol) in _LENGTHS.items():
    for _name in (_short, _long, _long.replace("meter", "metre")):
        _SPELLINGS[_name] = _SPELLINGS.setdefault(f"{_name}s", _short)
_SPELLINGS[NO_LENGTH] = NO_LENGTH


def canonical(unit: str) -> str:
    """Return the short name of a unit in any usual spelling ("micron", "µm", "millimetre"); an
    unknown one as it is.
    """
    return _SPELLINGS.get(unit.strip().lower(), unit.strip())


def check_unit(unit: str) -> None:
    """Raise `UnknownNameError` where a unit is not in the table."""
    if not isinstance(unit, str) or canonical(unit) not in (*_LENGTHS, NO_LENGTH):
        check_name(unit, (*_LENGTHS, NO_LENGTH), name="unit")


def has_length(unit: str) -> bool:
    """Return whether a unit is a length; "voxel" is not, nor is an unknown one."""
    return canonical(unit) in _LENGTHS


def to_metres(unit: str) -> float:
    """Return the metres in one `unit`.

    Raises
    ------
    InputError
        "voxel", "pixel" or an unknown unit, which have no length.
    """
    if not has_length(unit):
        raise InputError(
            f"unit {quote(unit)} has no length: give the image a spacing and one of "
            f"{', '.join(_LENGTHS)}"
        )
    return _LENGTHS[canonical(unit)][0]


def long_name(unit: str) -> str | None:
    """Return the name that OME-Zarr uses ("micrometer"), or None where there is no length."""
    return _LENGTHS[canonical(unit)][1] if has_length(unit) else None


def symbol(unit: str) -> str | None:
    """Return the symbol that OME-XML uses ("µm"), or None where there is no length."""
    return _LENGTHS[canonical(unit)][2] if has_length(unit) else None
