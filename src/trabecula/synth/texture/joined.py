"""Connectivity as a constraint of the rounds: after a vote the components of the solid are joined
where the signed distance makes it cheapest, and crumbs are taken away, in the field itself; the
next search and vote make struts of the exemplar of what was joined.

1. Components narrower than a strut along every axis, about, are crumbs: the field there becomes
   background.
2. The others are joined along a minimum spanning tree (`measure.joins`); a voxel costs the more,
   the farther the field says it is from the solid.
3. Along every path the field is raised to that of a round strut of the exemplar's thickness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import kernel
from trabecula.engine.memory import Array, Stage
from trabecula.engine.parallel import for_slabs, in_order
from trabecula.measure.joins import cheapest_joins
from trabecula.measure.labelling import joined_across
from trabecula.measure.runs import INSIDE, Runs, run_bytes, runs_of
from trabecula.synth.shared.content.fields import FULL
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Stack

WHOLE = 0.9
"""Share of the exemplars' phase in one component from which on it is to be one in the result."""

_ROUND = 1.5  # half thicknesses of plates (V / S), as the radius: between plates and rods
_LEAST = 0.75  # voxels, radius of a strut
_COST = 3  # bits of the field that the cost of a voxel leaves out
_AWAY = 32  # field of what was a crumb, beyond the interface: a voxel
_FACES = 6


@dataclass(frozen=True)
class StrutField:
    """The solid of one level, as far as joins need it.

    Attributes
    ----------
    upper : bool
        Whether the solid is where the field is positive.
    radius : float
        Of a strut, voxels of the level.
    unit : float
        Steps of the field in a voxel.
    """

    upper: bool
    radius: float
    unit: float

    @property
    def crumb(self) -> int:
        """Return the voxels up to which a component is a crumb: those of a ball of a strut's
        thickness.
        """
        return max(4, round(4.2 * self.radius**3))


def strut_field(
    stack: Stack, *, upper: bool, clip: float, whole: float = WHOLE
) -> StrutField | None:
    """Measure the solid of a level; None where less than a share of it is one component.

    Parameters
    ----------
    stack : Stack
    upper : bool
        Whether the solid is where the field is positive.
    clip : float
        Voxels at which the field saturates.
    whole : float
        That share.
    """
    largest = solid = faces = 0
    for start, (z, y, x) in zip(stack.starts, stack.sides, strict=True):
        part = stack.field[0, start : start + z, :y, :x]
        inside = np.ascontiguousarray(part > 0 if upper else part <= 0)
        runs = runs_of(inside.view(np.uint8), INSIDE, _FACES)
        largest += int(runs.sizes.max(initial=0))
        solid += int(runs.sizes.sum())
        faces += sum(np.count_nonzero(np.diff(inside, axis=axis)) for axis in range(3))
    if not solid or largest < whole * solid:
        return None
    # the area of an isotropic surface is two thirds of its voxels' faces
    radius = max(_LEAST, _ROUND * solid / max(1.0, faces / 1.5))
    return StrutField(upper, radius, FULL / clip)


def join_stages(shape: Sequence[int]) -> tuple[Stage, ...]:
    """Declare the arrays of `join_components`, beside the field."""
    voxels = int(np.prod(shape))
    held = {"inside": Array(shape, np.uint8), "cost": Array(shape, np.uint8)}
    # the nearest component of every voxel, its distance, what is open, and the runs
    return (Stage("join components", held, 7 * voxels + run_bytes(shape)),)


def join_components(field: np.ndarray, region: Region, struts: StrutField) -> int:
    """Join the components of the solid in a field (1, Z, Y, X) int8, in place; return the number of
    joins.

    Known voxels stay as they are, and paths run through free ones alone.
    """
    inside = solid_of(field[0], region, upper=struts.upper)
    runs = components_of(inside, region.wraps)
    if len(runs.sizes) < 2:
        return 0
    worth = runs.sizes > struts.crumb
    worth[np.argmax(runs.sizes)] = True
    cost = memmap.empty(inside.shape, np.uint8)

    def price(start: int, stop: int) -> None:
        cost[start:stop] = 1 + (np.abs(field[0, start:stop].astype(np.int16)) >> _COST)

    for_slabs(price, len(cost))
    paths = cheapest_joins(inside, runs, worth, 0, region.free, region.wraps, cost)
    sign = 1 if struts.upper else -1
    if not worth.all():
        _clear_crumbs(field[0], inside, runs, worth, sign)
    around = np.array(region.wraps)
    for path in paths:
        _raise_along(field[0], path, struts.radius, struts.unit, sign, around)
    region.clip_to_bounds(field)
    return len(paths)


def solid_of(field: np.ndarray, region: Region, *, upper: bool) -> np.ndarray:
    """Mark the solid of a field (Z, Y, X) in its free and known voxels, uint8 0 and 1."""
    inside = memmap.empty(field.shape, np.uint8)
    free, low, high = region.free, region.low, region.high

    def mark(start: int, stop: int) -> None:
        part = field[start:stop] > 0 if upper else field[start:stop] <= 0
        if free is not None:
            there = free[start:stop]
            if low is not None and high is not None:
                # others that are not free are outside of a form
                there = there | (low[0, start:stop] > 0) | (high[0, start:stop] <= 0)
            part = part & there
        inside[start:stop] = part

    for_slabs(mark, len(field))
    return inside


def components_of(inside: np.ndarray, wraps: tuple[bool, ...]) -> Runs:
    """Find the components of what is marked, (Z, Y, X) uint8, by faces of voxels."""
    return joined_across(runs_of(inside, INSIDE, _FACES), _FACES, wraps)


def _clear_crumbs(
    field: np.ndarray, inside: np.ndarray, runs: Runs, worth: np.ndarray, sign: int
) -> None:
    """Make the components that are not worth a join background, in field (Z, Y, X) and marks."""
    runs.write(inside, ~worth, 2)

    def clear(start: int, stop: int) -> None:
        part, crumbs = field[start:stop], inside[start:stop] == 2
        part[crumbs] = -sign * _AWAY
        inside[start:stop][crumbs] = 0

    in_order(clear, len(field))


@kernel
def _raise_along(field, path, radius, unit, sign, wraps):
    """Raise the field (Z, Y, X) to the signed distance of a strut around a path (n, 3)."""
    reach = int(np.ceil(radius)) + 1
    depth, height, width = field.shape
    for n in range(len(path)):
        for dz in range(-reach, reach + 1):
            z = path[n, 0] + dz
            if not (wraps[0] or 0 <= z < depth):
                continue
            for dy in range(-reach, reach + 1):
                y = path[n, 1] + dy
                if not (wraps[1] or 0 <= y < height):
                    continue
                for dx in range(-reach, reach + 1):
                    x = path[n, 2] + dx
                    if not (wraps[2] or 0 <= x < width):
                        continue
                    far = np.sqrt(np.float64(dz * dz + dy * dy + dx * dx))
                    value = min(np.int64(np.rint(unit * (radius - far))), 127)
                    at = (z % depth, y % height, x % width)
                    if sign * np.int64(field[at]) < value:
                        field[at] = sign * value
