"""Target descriptors of a result: one number for all of it, or a field."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from trabecula.core.checks import check_finite, check_name, quote
from trabecula.core.directions import Directions, as_directions, list_places
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.recipe import Recipe

APPARENT = ("apparent_conductivity", "apparent_diffusivity", "apparent_stiffness")
"""Properties of windows by themselves, relative to those of what carries them; with an axis, as in
"apparent_stiffness:z", along it."""

RANGES = {
    "porosity": (0.0, 1.0),
    "volume_fraction": (0.0, 1.0),
    "surface": (0.0, np.inf),
    "perimeter": (0.0, np.inf),
    "mean_curvature": (-np.inf, np.inf),
    "euler": (-np.inf, np.inf),
    "orientation": (-np.inf, np.inf),
    "size": (0.25, 4.0),
    **dict.fromkeys(APPARENT, (0.0, 1.0)),
}
"""Descriptors that can be targets, each with its range. Lengths of a density are voxels."""

FRAME = ("orientation", "size")
"""Targets that turn and scale the material: a direction, and a factor on its lengths."""

OF_A_PHASE = "volume_fraction:"
"""Prefix of a phase's name: "volume_fraction:binder" is the share of the phase binder."""

TWO_POINT = "two_point:"
"""Prefix of a distance in voxels: "two_point:4" is the two-point function of the solid at it."""

Target = float | np.ndarray


def as_target(given: Mapping[str, Any], shape: tuple[int, ...]) -> dict[str, Target]:
    """Return targets by name: a float, or a float32 array of `shape`; of "orientation" a unit
    vector, or an array of them with the components last.

    Raises
    ------
    UnknownNameError
        No descriptor of that name can be a target.
    InputError
        Not numbers, NaN, out of range, another shape.
    """
    if not isinstance(given, Mapping):
        raise InputError(
            f"target is a {type(given).__name__}: give names with values, such as {{'porosity': "
            "0.3}"
        )
    found = {}
    for name, value in given.items():
        if not is_target(name):
            check_name(name, RANGES, name="target")
        found[name] = _as_value(value, shape, name=name)
    if {"porosity", "volume_fraction"} <= set(found):
        raise InputError(
            "the target has porosity and volume_fraction, which is 1 - porosity: give one of them"
        )
    _check_sum(found)
    return found


def _check_sum(found: Mapping[str, Target]) -> None:
    """Raise where the fractions of phases are more than all there is."""
    shares = {name: value for name, value in found.items() if name.startswith(OF_A_PHASE)}
    solid = {name: value for name, value in shares.items() if name != f"{OF_A_PHASE}void"}
    porosity, rest = porosity_of(found), "all there is"
    room: Target = 1.0
    if porosity is not None:
        shares, room, rest = solid, 1 - porosity, "what porosity or volume_fraction leaves"
    if not shares:
        return
    more = np.asarray(sum(np.asarray(value, np.float64) for value in shares.values()) - room)
    if more.max() > 1e-5:
        named = ", ".join(shares)
        at = "" if not more.ndim else list_places(more > 1e-5)
        raise InputError(
            f"the targets contradict each other: {named} together are {more.max():.4g} more than "
            f"{rest}{at}; lower one of them"
        )


def is_target(name: Any) -> bool:
    """Return whether a descriptor of this name can be a target."""
    if not isinstance(name, str):
        return False
    of_a_phase = name.startswith(OF_A_PHASE) and name != OF_A_PHASE
    return of_a_phase or name in RANGES or _is_two_point(name) or is_apparent(name)


def is_apparent(name: str) -> bool:
    """Return whether a name is that of an apparent property, with or without an axis."""
    head, colon, axis = name.partition(":")
    return head in APPARENT and (not colon or axis in ("z", "y", "x"))


def _is_two_point(name: str) -> bool:
    """Return whether a name is that of a two-point function at a distance."""
    lag = name[len(TWO_POINT) :]
    return name.startswith(TWO_POINT) and lag.isascii() and lag.isdigit() and int(lag) > 0


def densities_of(target: Mapping[str, Target]) -> dict[str, Target]:
    """Return the targets without those that turn and scale the material."""
    return {name: value for name, value in target.items() if name not in FRAME}


def frame_of(target: Mapping[str, Target]) -> dict[str, Target]:
    """Return the targets that turn and scale the material: "orientation" and "size"."""
    return {name: value for name, value in target.items() if name in FRAME}


def is_field(name: str, value: Target) -> bool:
    """Return whether a target varies from place to place; a direction is one by its axes."""
    return np.ndim(value) > (name == "orientation")


def porosity_of(target: Mapping[str, Target]) -> Target | None:
    """Return the target porosity, given by that name or as 1 - volume_fraction; None where there is
    none.
    """
    if "volume_fraction" in target:
        return 1 - target["volume_fraction"]
    return target.get("porosity")


def origins_of(given: Any) -> dict[str, Recipe]:
    """Return the recipes of the fields among the targets; a number needs none."""
    pairs = given.items() if isinstance(given, Mapping) else ()
    return {
        name: _origin(value)
        for name, value in pairs
        if isinstance(value, Image | Directions) or is_field(name, value)
    }


def _origin(value: Any) -> Recipe:
    if isinstance(value, Image | Directions):
        return value.recipe or Recipe().then("array", value.values)
    return Recipe().then("array", np.asarray(value))


def _as_value(value: Any, shape: tuple[int, ...], *, name: str) -> Target:
    if name == "orientation":
        given = value.values if isinstance(value, Directions) else value
        if isinstance(given, Image):
            raise InputError(
                "the target orientation is an image: give vectors (Z, Y, X, 3), or one direction, "
                "such as tb.measure.fabric(image).directions[0]"
            )
        return as_directions(given, shape, name="the target orientation")
    share = name.startswith((OF_A_PHASE, TWO_POINT))
    low, high = RANGES["volume_fraction" if share else name.partition(":")[0]]
    if isinstance(value, Image) and value.kind != "grey":
        raise InputError(
            f"the target {name} is an image of {value.kind}: give a field of numbers (kind='grey')"
        )
    field = np.asarray(value.values if isinstance(value, Image) else value)
    if field.dtype.kind not in "iuf":
        raise InputError(
            f"the target {name} is {quote(value)}: give a number{_between(low, high)}, or a field "
            "of them"
        )
    check_finite(field, name=f"the target {name}")
    if field.ndim and field.shape != shape:
        raise InputError(
            f"the target {name} has shape {field.shape}, the request {shape}: give one number, or "
            "a field of that shape"
        )
    least, most = float(field.min()), float(field.max())
    if not (low <= least and most <= high):
        raise InputError(
            f"the target {name} runs from {least:g} to {most:g}, outside {low:g} .. {high:g}: "
            "rescale it"
            if field.ndim
            else f"the target {name} is {least:g}, outside {low:g} .. {high:g}"
        )
    return field.astype(np.float32) if field.ndim else float(field)


def _between(low: float, high: float) -> str:
    """Return the range as words; empty where it has no end."""
    return f" from {low:g} to {high:g}" if np.isfinite([low, high]).all() else ""
