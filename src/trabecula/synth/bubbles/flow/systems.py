"""Dynamical systems, the coordinates that they are written in, and a Runge-Kutta step in them: the
part of a streamline that a lattice can follow.

A flow is a planar system, a field of vectors, or nothing. x and y are coordinates in a slice, from
its centre; the system gives the velocity of a point along them (Strogatz 2001). Only its direction
is used: it does not decide how far bubbles grow.

The paper steps from a voxel by Runge-Kutta and continues with the neighbour nearest to the solution
(algorithm 2). A step here is one voxel's edge along the streamline, whatever the speed, so that the
solution lies among the neighbours and its *direction* chooses one. Half of it is taken upstream and
half downstream: the chord of a whole step downstream leaves a bend outwards, by an angle that grows
with the voxels, so that a coarse lattice would give another material.

Points are lengths from the corner of the request, in the slices' order of axes (along, tall, wide).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.checks import check_name
from trabecula.core.errors import InputError
from trabecula.core.expression import Expression, expressions
from trabecula.synth.bubbles.flow.given import Given, as_given, call_function

Vectors = tuple[np.ndarray, ...]
PointVelocity = Callable[[Vectors], Vectors]

STILL = 1e-9
"""A velocity below this is none: rounding, not a direction."""


def step_direction(velocity: PointVelocity, point: Vectors, step: float) -> Vectors:
    """Return the direction of a streamline at a point, by fourth-order Runge-Kutta.

    Parameters
    ----------
    velocity : callable
        Of points, each a tuple of arrays by axis: their velocities.
    point : tuple of arrays
        Middle of the step; the arrays broadcast.
    step : float
        Length, in the points' unit.

    Returns
    -------
    tuple of arrays
        The unit vector from where the step begins to where it ends; 0 where the point stands still
        or its velocity is no number.
    """
    here = unit(velocity(point))
    ahead = _slope(velocity, point, here, step / 2)
    behind = _slope(velocity, point, here, -step / 2)
    whole = unit(tuple(a + b for a, b in zip(ahead, behind, strict=True)))
    moves = sum(part * part for part in here) > 0
    return tuple(np.where(moves, part, 0.0) for part in whole)


def _slope(velocity: PointVelocity, point: Vectors, first: Vectors, step: float) -> Vectors:
    """Return six times the mean velocity over a step at unit speed; below 0 it goes upstream."""
    second = unit(velocity(_shift(point, first, step / 2)))
    third = unit(velocity(_shift(point, second, step / 2)))
    fourth = unit(velocity(_shift(point, third, step)))
    return tuple(
        a + 2 * b + 2 * c + d for a, b, c, d in zip(first, second, third, fourth, strict=True)
    )


def unit(vectors: Vectors) -> Vectors:
    """Return the vectors at length 1, or 0 where there is no direction."""
    with np.errstate(all="ignore"):
        length = np.sqrt(sum(part * part for part in vectors))
        moves = (length > STILL) & (length < np.inf)
        return tuple(np.where(moves, part / length, 0.0) for part in vectors)


def pack_int8(vector: np.ndarray) -> np.ndarray:
    """Return components of unit vectors, -1 .. 1, as int8 in units of 1/127."""
    return np.rint(vector * 127.0).astype(np.int8)


def _shift(point: Vectors, direction: Vectors, length: float) -> Vectors:
    """Return points moved by a length along a direction."""
    return tuple(place + length * part for place, part in zip(point, direction, strict=True))


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
    """Velocity of a point.

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
    """Return the system of a setting, by its name or formulas; None for "none".

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
    """Return the condition of a region: a formula of x, y, z and label, not 0 inside it."""
    return Expression(text, ("x", "y", "z", "label"))


def _of_formulas(text: str, *, named: bool) -> System:
    """Return the system of two or three formulas."""
    count = _parts(text)
    if count not in (2, 3):
        raise InputError(
            f"the flow {text!r} has {count} formulas: give two, of x' and y' in a slice, or "
            "three, of x', y' and z'"
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
    """Count the formulas, separated by commas outside brackets."""
    depth, count = 0, 1
    for letter in text.rstrip().rstrip(","):
        depth += (letter in "([") - (letter in ")]")
        count += letter == "," and depth == 0
    return count


def _of_function(given: Given, name: str) -> System:
    """Return the system of a user's function."""
    function = given.function
    assert function is not None

    def velocity(z: np.ndarray, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, ...]:
        z1, y1, x1 = call_function(function, *np.broadcast_arrays(z, y, x), name=name)
        return x1, y1, z1

    return System("volume", frozenset("xyz"), velocity)


def _of_array(given: Given, name: str) -> System:
    """Return a field of vectors that spans the request.

    It is trilinear between its voxels' centres, and constant beyond the last ones.
    """
    array = given.array
    assert array is not None
    if array.ndim == 3 and array.shape[-1] == 2:
        flat = np.zeros((1, *array.shape[:2], 3), np.float64)
        flat[0, ..., 1:] = array
        array = flat
    if array.ndim != 4 or array.shape[-1] != 3:
        raise InputError(
            f"{name} is an array of shape {array.shape}: give (Z, Y, X, 3), vectors along z, y, "
            "x, or (Y, X, 2) for a picture"
        )
    # Scaled by the fastest vector, so that a slow one differs from 0 in any unit.
    vectors = np.ascontiguousarray(array, np.float64)
    vectors = vectors / max(float(np.abs(vectors).max()), 1e-300)

    def velocity(z: np.ndarray, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, ...]:
        found = _between(vectors, tuple(np.broadcast_arrays(z, y, x)))
        return found[..., 2], found[..., 1], found[..., 0]

    return System("array", frozenset("xyz"), velocity)


def _between(vectors: np.ndarray, parts: tuple[np.ndarray, ...]) -> np.ndarray:
    """Interpolate linearly at places given as shares 0 .. 1 of the array's sides."""
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


Centre = tuple[np.ndarray | float, np.ndarray | float]


class Frames:
    """The coordinates of one request.

    Parameters
    ----------
    shape, spacing : along z, y, x
    order : of the axes, along, tall and wide
    extent : float
        Coordinate at half the longest side; 0 for lengths.
    """

    def __init__(
        self, shape: Sequence[int], spacing: Sequence[float], order: Sequence[int], extent: float
    ) -> None:
        self.shape, self.spacing, self.order = tuple(shape), tuple(spacing), tuple(order)
        self.sides = tuple(count * edge for count, edge in zip(shape, spacing, strict=True))
        self.middle = tuple(side / 2 for side in self.sides)
        longest = max(self.sides)
        in_slice = max(self.sides[axis] for axis in order[1:])
        self._volume_scale = extent / (longest / 2) if extent else 1.0
        self._slice_scale = extent / (in_slice / 2) if extent else 1.0

    def points(self, place: int, tall: np.ndarray, wide: np.ndarray) -> Vectors:
        """Return the centres of voxels of a slice: three arrays that broadcast to (1, rows,
        columns).
        """
        edges = [self.spacing[axis] for axis in self.order]
        nodes = (np.array([place])[:, None, None], tall[None, :, None], wide[None, None, :])
        return tuple((node + 0.5) * edge for node, edge in zip(nodes, edges, strict=True))

    def of_volume(self, point: Vectors) -> Vectors:
        """Return z, y, x from the middle of the request."""
        return tuple(
            (part - middle) * self._volume_scale
            for part, middle in zip(self._by_axis(point), self.middle, strict=True)
        )

    def nearest(
        self, values: np.ndarray, place: int, tall: np.ndarray, wide: np.ndarray
    ) -> np.ndarray:
        """Return values of an array that spans the request, (1, rows, columns); 0 beyond it."""
        index: list[np.ndarray] = []
        inside: np.ndarray = np.ones((1, 1, 1), bool)
        for part, side, count in zip(
            self._by_axis(self.points(place, tall, wide)), self.sides, values.shape, strict=True
        ):
            index.append(np.clip(np.floor(part / side * count), 0, count - 1).astype(np.int64))
            inside = inside & (part >= 0) & (part < side)
        return np.where(inside, values[tuple(index)], 0)

    def velocity(self, system: System, centre: Centre) -> Callable[[Vectors], Vectors]:
        """Return a system as a function of points, its velocities in the slices' order."""
        return {"slice": self._in_slice, "volume": self._in_volume, "array": self._in_array}[
            system.frame
        ](system, centre)

    def _in_slice(self, system: System, centre: Centre) -> Callable[[Vectors], Vectors]:
        origin = (self.middle[self.order[0]], *centre)

        def velocity(point: Vectors) -> Vectors:
            z, y, x = (
                (part - zero) * self._slice_scale for part, zero in zip(point, origin, strict=True)
            )
            found = system.velocity(z, y, x)
            return (found[2] if len(found) == 3 else np.zeros(1), found[1], found[0])

        return velocity

    def _in_volume(self, system: System, centre: Centre) -> Callable[[Vectors], Vectors]:
        def velocity(point: Vectors) -> Vectors:
            x1, y1, z1 = system.velocity(*self.of_volume(point))
            return self._in_order((z1, y1, x1))

        return velocity

    def _in_array(self, system: System, centre: Centre) -> Callable[[Vectors], Vectors]:
        def velocity(point: Vectors) -> Vectors:
            shares = (
                part / side for part, side in zip(self._by_axis(point), self.sides, strict=True)
            )
            x1, y1, z1 = system.velocity(*shares)
            return self._in_order((z1, y1, x1))

        return velocity

    def _by_axis(self, point: Vectors) -> Vectors:
        """Reorder from the slices' order to z, y, x."""
        return tuple(point[self.order.index(axis)] for axis in range(3))

    def _in_order(self, vectors: Vectors) -> Vectors:
        """Reorder from z, y, x to the slices' order."""
        return tuple(vectors[axis] for axis in self.order)
