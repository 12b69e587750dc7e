"""Small checks that raise and return nothing, and conversions that return. Every message ends with
what to do.
"""

from __future__ import annotations

import difflib
import math
import os
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from trabecula.core.errors import InputError, UnknownNameError

MOST_VOXELS = 2**48
"""So that voxels times bytes stay inside 64 bits in every forecast."""

WIDEST = 1e20
MOST_ANISOTROPIC = 1e15
"""Of a voxel's edges: far beyond any scan, and squares of their ratio still fit into float32."""


def quote(value: Any) -> str:
    """Return a value as a message shows it: its `repr` in one line, cut where it is long."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 100 else f"{text[:97]}..."


def as_path_text(path: Any) -> str:
    """Return a path as text; InputError where it is none."""
    try:
        text = os.fspath(path)
    except TypeError:
        text = None
    if not isinstance(text, str) or "\0" in text:
        raise InputError(f"{quote(path)} is no path: give a string or a Path")
    return text


def check_type(value: Any, kind: type, *, name: str, advice: str) -> None:
    """Raise where a value is not of a class, with what gives one."""
    if not isinstance(value, kind):
        raise InputError(f"{name} is {type(value).__name__}, {kind.__name__} is needed: {advice}")


def check_name(value: str, known: Iterable[str], *, name: str) -> None:
    """Raise `UnknownNameError` where `value` is not in `known`, suggesting the nearest that is."""
    known = sorted(known)
    if isinstance(value, str) and value in known:
        return
    near = difflib.get_close_matches(str(value), known, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]!r}? " if near else ""
    raise UnknownNameError(
        f"unknown {name} {quote(value)}: {hint}known are {', '.join(known) or 'none'}"
    )


def check_finite(values: np.ndarray, *, name: str) -> None:
    """Raise where a floating array holds NaN or infinity."""
    if np.issubdtype(values.dtype, np.complexfloating):
        raise InputError(f"{name} is complex ({values.dtype}): give real values")
    if not np.issubdtype(values.dtype, np.floating):
        return
    bad = values.size - int(np.count_nonzero(np.isfinite(values)))
    if bad:
        raise InputError(
            f"{name} holds {bad} NaN or infinite values of {values.size}: fill or crop them first "
            "(np.nan_to_num, a crop)"
        )


def as_shape(value: int | Sequence[int], *, ndim: int = 3, name: str = "shape") -> tuple[int, ...]:
    """Return a shape of `ndim` positive integers; one integer means a cube (a square)."""
    try:
        raw = [value] if isinstance(value, (int, np.integer, float)) else list(value)
        sides = [int(side) for side in raw]
    except (TypeError, ValueError, OverflowError):
        raise InputError(
            f"{name} {quote(value)} is not made of integers: give one number or {ndim}"
        ) from None
    if any(side != given for side, given in zip(sides, raw, strict=True)):
        raise InputError(f"{name} {quote(value)} is not made of whole numbers")
    if len(sides) == 1:
        sides = sides * ndim
    if len(sides) != ndim:
        raise InputError(
            f"{name} {tuple(raw)} has {len(raw)} numbers: give one (a cube) or {ndim}, slowest "
            "axis first"
        )
    if min(sides) < 1:
        raise InputError(f"{name} {tuple(sides)} must be positive along every axis")
    if math.prod(sides) > MOST_VOXELS:
        raise InputError(
            f"{name} {tuple(sides)} is more than 2**48 voxels, which no run can hold: ask for less"
        )
    return tuple(sides)


def as_corner(value: Sequence[int]) -> tuple[int, ...]:
    """Return the whole numbers of a place in voxels; where it may be is for the caller to check."""
    try:
        return tuple(int(start) for start in value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"corner {quote(value)} is not made of integers, one per axis") from None


def as_spacing(value: float | Sequence[float] | None, *, ndim: int) -> tuple[float, ...]:
    """Return voxel edges, one per axis, positive and finite; `None` means 1 along every axis."""
    if value is None:
        return (1.0,) * ndim
    try:
        raw: list[Any] = (
            [value] if isinstance(value, (int, float, np.integer, np.floating)) else list(value)
        )
        edges = [float(edge) for edge in raw]
    except (TypeError, ValueError, OverflowError):
        raise InputError(
            f"spacing {quote(value)} is not made of numbers: give one or {ndim}"
        ) from None
    if len(edges) == 1:
        edges = edges * ndim
    if len(edges) != ndim:
        raise InputError(
            f"spacing {tuple(raw)} has {len(raw)} numbers: give one or {ndim}, slowest axis first"
        )
    if not all(math.isfinite(edge) and edge > 0 for edge in edges):
        raise InputError(f"spacing {tuple(edges)} must be positive and finite along every axis")
    if min(edges) < 1 / WIDEST or max(edges) > WIDEST or max(edges) > MOST_ANISOTROPIC * min(edges):
        raise InputError(
            f"spacing {tuple(edges)} is outside {1 / WIDEST:g} .. {WIDEST:g}, or differs between "
            f"axes by more than {MOST_ANISOTROPIC:g} times: check its numbers, or choose another "
            "unit"
        )
    return tuple(edges)


def as_seed(value: int) -> int:
    """Return a seed: an integer from 0 to 2**63 - 1."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise InputError(f"seed {quote(value)} is not an integer")
    if not 0 <= int(value) < 2**63:
        raise InputError(f"seed {value} is outside 0 .. 2**63 - 1")
    return int(value)


def as_number(
    value: Any, *, name: str, low: float, high: float, whole: bool = False
) -> float | int:
    """Return a number from `low` to `high`, an int where `whole`; for the fields of a method's
    config.
    """
    kind = "a whole number" if whole else "a number"
    number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(
        value, bool
    )
    if not number or (whole and value != value // 1):
        raise InputError(f"{name}={quote(value)} should be {kind} from {low} to {high}")
    if not low <= value <= high:
        raise InputError(f"{name}={value} is outside {low} .. {high}")
    return int(value) if whole else float(value)
