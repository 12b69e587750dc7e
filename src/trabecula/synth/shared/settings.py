"""Checks that methods' configs share; a config calls them on itself when it is made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trabecula.core.checks import as_number, check_name
from trabecula.core.errors import InputError
from trabecula.exemplar.views import as_planes, check_gap_alone


def keep_numbers(config: Any, ranges: Mapping[str, tuple[float, float]]) -> None:
    """Check that numbers are within their ranges (name -> least, most); whole where the field's
    default is. Where that is None a field may be None, and is a float else.
    """
    for name, (low, high) in ranges.items():
        default, given = getattr(type(config), name), getattr(config, name)
        if default is None and given is None:
            continue
        value = as_number(given, name=name, low=low, high=high, whole=isinstance(default, int))
        object.__setattr__(config, name, float(value) if default is None else value)


def keep_phase(config: Any, field: str) -> None:
    """Check that a field is the name of a phase, or None."""
    value = getattr(config, field)
    if value is not None and not isinstance(value, str):
        raise InputError(f"{field}={value!r} should be the name of a phase")


def keep_rounds(
    config: Any, name: str, *, low: int = 1, high: int = 200, advice: str | None = None
) -> None:
    """Check one whole number a level, finest first; a single number is for all. The `advice` for
    who gives none says what to give.
    """
    given = getattr(config, name)
    counts = given if isinstance(given, (list, tuple)) else (given,)
    if not counts:
        advice = advice or f"the {name} of the finest level first, such as [4, 6, 8]"
        raise InputError(f"{name} is empty: give {advice}")
    checked = tuple(as_number(count, name=name, low=low, high=high, whole=True) for count in counts)
    object.__setattr__(config, name, checked)


def keep_choices(config: Any, choices: Mapping[str, tuple[Any, ...]]) -> None:
    """Check that names are among those allowed; (True, False) for a switch."""
    for name, allowed in choices.items():
        value = getattr(config, name)
        if allowed == (True, False):
            if not isinstance(value, bool):
                raise InputError(f"{name}={value!r} should be true or false")
        else:
            check_name(value, allowed, name=name)


def keep_views(config: Any) -> None:
    """Check the planes of `views`, and keep them as a tuple."""
    object.__setattr__(config, "views", as_planes(config.views))


def keep_gap(config: Any) -> None:
    """Check a `gap` of parallel sections beside `views` and `interface_rounds`."""
    check_gap_alone(config.gap, config.views)
    if config.gap and not config.interface_rounds:
        raise InputError(
            "parallel sections say how single voxels are to flip, and interface_rounds=0 flips "
            "none: leave out the gap, or give rounds"
        )
