"""Dynamical systems by name, and what a flow is made of: a planar system, a field of vectors, or
nothing.

x and y are coordinates in a slice, from its centre; the system says how fast a point moves along
them (Strogatz 2001). Only the direction is used: how far bubbles grow is not the flow's affair.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.checks import check_name
from trabecula.core.errors import InputError
from trabecula.core.expression import Expression, expressions
from trabecula.synth.bubbles.flow.given import Given, as_given, called

SYSTEMS: dict[str, str] = {
    "quadratic": "9*x*x - 9*y*y + 1, 18*x*y + 1",  # equation 3, over -3 .. 3 in x and y
    "concentric": "-y, x",
    "elliptic": "-2.25*y, x",
    "spiral": "-y + 0.25*x, x + 0.25*y",
    "roll": "-y + 0.08*x / sqrt(x*x + y*y), x + 0.08*y / sqrt(x*x + y*y)",
    "radial": "x, y",
    "saddle": "x, -y",
    "horizontal": "1, 0",
    "vertical": "0, 1",
    "axial": "0, 0, 1",
}
"""Right-hand sides of x' and y' by name; "roll" is an Archimedean spiral with windings half a unit
apart, "axial" has a third component, along the principal axis."""

NONE = "none"

Velocity = Callable[..., tuple[np.ndarray, ...]]


@dataclass(frozen=True)
class System:
    """Where a point moves.

    Attributes
    ----------
    frame : {"slice", "volume", "array"}
        What its coordinates are: x and y in a slice from the slice's centre, and z along the
        principal axis; x, y and z of the volume from its centre; or shares 0 .. 1 of the volume's
        sides.
    names : frozenset of str
        Coordinates that it depends on.
    velocity : callable
        Takes z, y, x; returns the velocities along x, y and, of a volume or where there is one, z:
        each an array that broadcasts with them.
    """

    frame: str
    names: frozenset[str]
    velocity: Velocity


def system_of(flow: Any, *, name: str = "flow") -> System | None:
    """The system that a setting names or spells out; None for "none".

    Raises
    ------
    InputError
        Neither two nor three formulas; an array of another shape than (Z, Y, X, 3) or (Y, X, 2).
    UnknownNameError
        No such system, or a formula with a name that is not x, y, z or a known function.
    """
    given = as_given(flow, name=name)
    if given is not None:
        return _of_array(given, name) if given.array is not None else _of_function(given, name)
    if flow == NONE:
        return None
    if "," not in flow:
        check_name(
            flow,
            (NONE, *SYSTEMS),
            name=f"{name} (or write it as formulas of x, y and z, separated by commas)",
        )
    return _of_formulas(SYSTEMS.get(flow, flow), named=flow in SYSTEMS)


def condition_of(text: str) -> Expression:
    """When a region holds: a formula of x, y, z and label that is not 0 inside it."""
    return Expression(text, ("x", "y", "z", "label"))


def _of_formulas(text: str, *, named: bool) -> System:
    count = _parts(text)
    if count not in (2, 3):
        raise InputError(
            f"the flow {text!r} has {count} formulas: give two, of x' and y' in a slice, or three, of x', y' and z'"
        )
    formulas = expressions(text, ("x", "y", "z"), count=count)
    used = frozenset().union(*(formula.names for formula in formulas))
    # The named system along the principal axis is one of the slice; three formulas of a user are of
    # the volume.
    frame = "slice" if count == 2 or named else "volume"

    def velocity(z: np.ndarray, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, ...]:
        at = {"z": z, "y": y, "x": x}
        return tuple(formula(**{name: at[name] for name in formula.names}) for formula in formulas)

    return System(frame, used, velocity)


def _parts(text: str) -> int:
    """Formulas, separated by commas outside brackets."""
    depth, count = 0, 1
    for letter in text.rstrip().rstrip(","):
        depth += (letter in "([") - (letter in ")]")
        count += letter == "," and depth == 0
    return count


def _of_function(given: Given, name: str) -> System:
    function = given.function
    assert function is not None

    def velocity(z: np.ndarray, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, ...]:
        z1, y1, x1 = called(function, *np.broadcast_arrays(z, y, x), name=name)
        return x1, y1, z1

    return System("volume", frozenset("xyz"), velocity)


def _of_array(given: Given, name: str) -> System:
    """A field of vectors that spans the request: trilinear between its voxels' centres, the last
    goes on beyond them.
    """
    array = given.array
    assert array is not None
    if array.ndim == 3 and array.shape[-1] == 2:
        flat = np.zeros((1, *array.shape[:2], 3), np.float64)
        flat[0, ..., 1:] = array
        array = flat
    if array.ndim != 4 or array.shape[-1] != 3:
        raise InputError(
            f"{name} is an array of shape {array.shape}: give (Z, Y, X, 3), vectors along z, y, x, or (Y, X, 2) for a picture"
        )
    # Whatever its unit, what is slow is told from what stands still by the fastest.
    vectors = np.ascontiguousarray(array, np.float64)
    vectors = vectors / max(float(np.abs(vectors).max()), 1e-300)

    def velocity(z: np.ndarray, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, ...]:
        found = _between(vectors, tuple(np.broadcast_arrays(z, y, x)))
        return found[..., 2], found[..., 1], found[..., 0]

    return System("array", frozenset("xyz"), velocity)


def _between(vectors: np.ndarray, parts: tuple[np.ndarray, ...]) -> np.ndarray:
    """Trilinear values at places told as shares 0 .. 1 of the array's sides."""
    low, share = [], []
    for part, side in zip(parts, vectors.shape, strict=False):
        place = np.clip(part * side - 0.5, 0, side - 1)
        first = np.minimum(np.floor(place).astype(np.int64), max(side - 2, 0))
        low.append(first)
        share.append(place - first)
    total = np.zeros((*parts[0].shape, 3))
    for corner in np.ndindex(2, 2, 2):
        index = tuple(
            np.minimum(a + b, side - 1)
            for a, b, side in zip(low, corner, vectors.shape, strict=False)
        )
        weight = np.ones(parts[0].shape)
        for part, far in zip(share, corner, strict=True):
            weight = weight * (part if far else 1 - part)
        total += weight[..., None] * vectors[index]
    return total
