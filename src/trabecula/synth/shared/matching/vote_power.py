"""The power to which distances are raised before they are averaged, so that a vote leaves as many
loops as the exemplar has.

Far distances rule a mean of them: where some neighbourhoods hold a thin strut and others the depth
of a pore, the strut is outvoted. Raised to a power below 1 all count more alike, and thin joins
survive; above 1 they are smoothed away. Which is right depends on the material: its Euler numbers
tell. Histograms are matched after the vote, so the power changes neither fractions nor distances.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import prod

import numpy as np

from trabecula.engine.memory import Array, Stage
from trabecula.synth.shared.content.fields import FULL, UNIT
from trabecula.synth.shared.matching.grid import Grid
from trabecula.synth.shared.matching.rounds import cast_votes, match_votes
from trabecula.synth.shared.slabs import for_plane_groups, make_by_slabs
from trabecula.synth.shared.statistics.euler import euler_densities

_POWERS = tuple(2 ** (n / 2) for n in range(-3, 4))
_PLAIN = 3  # the place of the power 1
_ENOUGH, _LEAST = 1 << 20, 16  # voxels to try a power on, and planes at least


def raise_distances(field: np.ndarray, power: float) -> np.ndarray:
    """Return distances (..., Z, Y, X) int8 raised to a power, with their signs and their greatest
    value; the field itself where the power is 1.
    """
    if power == 1:
        return field
    steps = np.arange(-FULL - 1, FULL + 1)
    raised = np.sign(steps) * np.rint(FULL * (np.abs(steps) / FULL).clip(max=1) ** power)
    table = raised.astype(np.int8)
    return make_by_slabs(
        lambda a, b: table[field[..., a:b, :, :].astype(np.int16) + FULL + 1], field.shape, np.int8
    )


def lower_votes(votes: np.ndarray, power: float) -> np.ndarray:
    """Make votes int16 of raised distances those of distances, in place; return them."""
    if power == 1:
        return votes
    most = FULL * UNIT
    steps = np.arange(-(1 << 15), 1 << 15)
    lowered = np.sign(steps) * np.rint(most * (np.abs(steps) / most).clip(max=1) ** (1 / power))
    table = lowered.astype(np.int16)

    def lower(start: int, stop: int) -> None:
        part = votes[:, start:stop]
        part[...] = table[part.astype(np.int32) + (1 << 15)]

    for_plane_groups(lower, votes.shape[1:])
    return votes


def power_for(
    grid: Grid, match: np.ndarray, weights: np.ndarray, euler: np.ndarray, *, trim: int = 0
) -> float:
    """Return the power, .35 .. 2.8, that leaves Euler densities nearest to `euler` (2C,): from 1 on
    the next one is tried for as long as that is nearer.

    It is tried on some planes of the votes, on a torus as good as others; beside known voxels on as
    many as hold enough free ones, whose Euler densities count.
    """
    whole, targets = grid.region, grid.targets
    planes = _planes_to_try(whole.shape, whole.free)
    region = whole.first_planes(planes)
    apart: dict[int, float] = {}

    def try_power(place: int) -> float:
        if place not in apart:
            power = _POWERS[place]
            voting = raise_distances(grid.candidates.stack.field, power)
            votes = cast_votes(grid, match, weights, trim=trim, field=voting, planes=planes)
            if region.low is not None:
                lower_votes(votes, power)
            made = euler_densities([match_votes(region, votes, targets)], within=region.free)
            apart[place] = float(np.abs(made - euler).sum())
        return apart[place]

    best, beside = _PLAIN, -1
    while beside != best:
        beside = best
        near = range(max(beside - 1, 0), min(beside + 2, len(_POWERS)))
        best = min(near, key=lambda place: (try_power(place), abs(place - _PLAIN)))
    return _POWERS[best]


def power_stages(volume: Sequence[int], *, known: bool) -> tuple[Stage, ...]:
    """Declare the arrays of `power_for` for a field (C, Z, Y, X)."""
    channels, *shape = volume
    tried = (channels, shape[0] if known else _planes_to_try(shape), *shape[1:])
    arrays = {"tried": Array(tried, np.int16), "made of it": Array(tried, np.int8)}
    return (Stage("try powers", arrays, prod(tried[1:])),)


def _planes_to_try(shape: Sequence[int], free: np.ndarray | None = None) -> int:
    """Count the first planes that hold enough free voxels."""
    if free is None:
        return min(shape[0], max(_LEAST, -(-_ENOUGH // (shape[1] * shape[2]))))
    found = 0
    for number, plane in enumerate(free, 1):
        found += int(np.count_nonzero(plane))
        if found >= _ENOUGH and number >= _LEAST:
            return number
    return shape[0]
