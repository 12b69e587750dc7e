"""Compiled: how full of a phase balls are, and what one voxel that changes its phase changes of it.

Chords, cubes and neighbours are thin or small: bodies that are bumpy, or joined where they should
be apart, may have them all. So balls of `RADII` around every `STEP`-th voxel are counted by their
fraction of a phase, as the measurement cells of local porosity theory (Hilfer 1991,
doi:10.1103/PhysRevB.44.60) are. A ball counts for the two nearest of `FRACTIONS`, in parts of
`UNIT` that add up to it: so what one voxel changes is never nothing.

On a local array as in `kernels`. No ball that holds a voxel of the block leaves it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from trabecula.engine.compile import inline, kernel

RADII = (4, 8)

STEP = 4
"""Voxels between the centres of balls along an axis."""

_UNIT_BITS = 12
UNIT = 1 << _UNIT_BITS

_NEARLY_EMPTY = (0, 0.01, 0.03, 0.07, 0.13, 0.21, 0.3, 0.4)
FRACTIONS = np.array([*_NEARLY_EMPTY, 0.5, *(1 - one for one in _NEARLY_EMPTY[::-1])])
"""Fractions that balls count for, closest where a ball nearly fits into a phase."""

BALL_BINS = 2 * len(RADII) * len(FRACTIONS)
"""Bins of balls that one voxel changes at most."""

OUTSIDE = 255

_LEAD = RADII[-1] // STEP  # balls before the first whose centre is in the block
_FRACTIONS = len(FRACTIONS)


def _voxels_of_ball(radius: int) -> int:
    """Return the number of voxels of a ball around a voxel."""
    squares = np.square(np.arange(-radius, radius + 1))
    return int(np.count_nonzero(np.add.outer(np.add.outer(squares, squares), squares) <= radius**2))


def _shares() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where the balls of each radius begin in the other two; for a ball with so many voxels
    of a phase the lower of its two fractions, and the parts that count for the upper one.
    """
    begins, lower, parts = [0], [], []
    for radius in RADII:
        voxels = _voxels_of_ball(radius)
        knots = np.rint(FRACTIONS * voxels).astype(np.int64)
        full = np.arange(voxels + 1)
        below = np.minimum(np.searchsorted(knots, full, side="right") - 1, len(knots) - 2)
        share = (full - knots[below]) / (knots[below + 1] - knots[below])
        lower.append(below.astype(np.uint8))
        parts.append(np.rint(UNIT * share).astype(np.int16))
        begins.append(begins[-1] + len(full))
    return np.array(begins), np.concatenate(lower), np.concatenate(parts)


_begins, _lower, _parts = _shares()
# parts that leave the lower fraction for the upper one where a ball gets one more, and before their
# bits the lower one; from one ball to the next radius nothing steps
_moved = np.where(_lower[1:] == _lower[:-1], _parts[1:], UNIT).astype(np.int32) - _parts[:-1]
_steps = _moved + (_lower[:-1].astype(np.int32) << _UNIT_BITS)
_half_rows = np.array(
    [
        [int(np.sqrt(max(radius**2 - far, 0))) for far in range(RADII[-1] ** 2 + 1)]
        for radius in RADII
    ]
)  # half of the row of a ball whose distance from its centre has this square


def _balls_of_places() -> tuple[np.ndarray, np.ndarray]:
    """Return the balls that hold a voxel, (n, 3), counted from the one before it along each axis:
    by their radius, and by where among `STEP`^3 voxels the voxel is; and where those of each begin,
    (radii, places + 1).
    """
    ahead = np.arange(-_LEAD, _LEAD + 1)
    balls = np.stack(np.meshgrid(ahead, ahead, ahead, indexing="ij"), axis=-1).reshape(-1, 3)
    places = np.stack(np.unravel_index(np.arange(STEP**3), (STEP,) * 3), axis=-1)
    far = np.square(STEP * balls - places[:, None]).sum(axis=-1)
    held = [far <= radius**2 for radius in RADII]
    counts = np.concatenate([[0], *(one.sum(axis=1) for one in held)]).cumsum()
    firsts = [counts[n * STEP**3 :][: STEP**3 + 1] for n in range(len(RADII))]
    return np.concatenate([balls[np.nonzero(one)[1]] for one in held]), np.array(firsts)


_near, _first_near = _balls_of_places()


class FilledBalls(NamedTuple):
    """The balls that meet a block.

    Attributes
    ----------
    fills : (radii, channels, z, y, x) int16
        How many voxels of a phase they hold: of two phases of the second, else of each; -1 where
        one leaves the material.
    lines : (n,) int64
        From the ball before a voxel, along each axis, to one that holds it: steps in fills (z, y,
        x), read as one line.
    tally : (fractions,) int64
        Room for what one voxel changes; zero.
    """

    fills: np.ndarray
    lines: np.ndarray
    tally: np.ndarray


@kernel
def count_balls(local, margin, phases, counts, rooms):
    """Count the balls whose centres are in the block: counts (radii x channels x fractions,) and
    rooms (radii,), both in parts.
    """
    fills = _fill_balls(local, margin, phases)
    for n in range(len(RADII)):
        for c in range(fills.shape[1]):
            first = (n * fills.shape[1] + c) * _FRACTIONS
            for z in range(_LEAD, fills.shape[2] - _LEAD):
                for y in range(_LEAD, fills.shape[3] - _LEAD):
                    for x in range(_LEAD, fills.shape[4] - _LEAD):
                        if fills[n, c, z, y, x] < 0:
                            continue
                        if c == 0:
                            rooms[n] += UNIT
                        at = _begins[n] + fills[n, c, z, y, x]
                        counts[first + _lower[at]] += UNIT - _parts[at]
                        counts[first + _lower[at] + 1] += _parts[at]


@inline
def _fill_balls(local, margin, phases):
    """Return how many voxels of a phase the balls hold that meet the block, (radii, channels, z, y,
    x); -1 where one leaves the material. Of two phases the second has a channel, else all have one.
    """
    channels = 1 if phases == 2 else phases
    sides = np.empty(3, np.int64)
    for axis in range(3):
        sides[axis] = (local.shape[axis] - 2 * margin - 1) // STEP + 1 + 2 * _LEAD
    fills = np.empty((len(RADII), channels, sides[0], sides[1], sides[2]), np.int16)
    sums = np.empty((local.shape[0], local.shape[1], local.shape[2] + 1), np.uint16)
    for c in range(channels):
        _sum_rows(local, 1 if channels == 1 else c, sums)
        for n in range(len(RADII)):
            for z in range(sides[0]):
                for y in range(sides[1]):
                    for x in range(sides[2]):
                        fills[n, c, z, y, x] = _fill(
                            sums,
                            n,
                            margin + (z - _LEAD) * STEP,
                            margin + (y - _LEAD) * STEP,
                            margin + (x - _LEAD) * STEP,
                        )
    return fills


@inline
def _sum_rows(local, phase, sums):
    """Sum the voxels of a phase along x, less than 256 a row, in the low byte, and those outside in
    the high one.
    """
    for z in range(local.shape[0]):
        for y in range(local.shape[1]):
            total = np.uint16(0)
            sums[z, y, 0] = 0
            for x in range(local.shape[2]):
                there = local[z, y, x]
                total += np.uint16(there == phase) + np.uint16(256 * (there == OUTSIDE))
                sums[z, y, x + 1] = total


@inline
def _fill(sums, n, z, y, x):
    """Return how many voxels of a phase a ball holds; -1 where it leaves the material."""
    radius, found = RADII[n], np.int32(0)
    for dz in range(-radius, radius + 1):
        for dy in range(-radius, radius + 1):
            far = dz * dz + dy * dy
            if far > radius * radius:
                continue
            half = _half_rows[n, far]
            row = sums[z + dz, y + dy]
            both = np.int32(row[x + half + 1]) - np.int32(row[x - half])
            if both > 255:
                return -1
            found += both
    return found


@inline
def filled_balls(local, margin, phases):
    """Return the balls that meet the block, and room for what one voxel changes."""
    return _filled(_fill_balls(local, margin, phases))


@inline
def no_balls():
    """Return none."""
    return _filled(np.empty((0, 0, 0, 0, 0), np.int16))


@inline
def _filled(fills):
    """Return balls with the steps to those that hold a voxel."""
    lines = np.empty(len(_near), np.int64)
    for n in range(len(_near)):
        z, y, x = _near[n]
        lines[n] = (z * fills.shape[3] + y) * fills.shape[4] + x
    return FilledBalls(fills, lines, np.zeros(_FRACTIONS, np.int64))


@inline
def list_ball_changes(balls, place, own, new, first, found, count):
    """List the bins, from `first` on, that change where a voxel of the block becomes a phase, and
    by how many parts; return how many.
    """
    fills, lines, tally = balls
    channels = fills.shape[1]
    for n in range(len(RADII)):
        begin, stop, line = _balls_around(fills, n, place)
        for c in range(channels):
            more = _gained(c, channels, own, new)
            if more == 0:
                continue
            full = fills[n, c].reshape(-1)
            for k in range(begin, stop):
                there = full[np.uint64(line + lines[k])]
                if there >= 0:
                    step = _steps[np.uint64(_begins[n] + there + min(more, 0))]
                    tally[np.uint64(step >> _UNIT_BITS)] += step & (UNIT - 1)
            moved = np.int64(0)
            for k in range(_FRACTIONS):
                by, moved = moved - tally[k], tally[k]
                tally[k] = 0
                if by != 0:
                    found.bins[count] = first + (n * channels + c) * _FRACTIONS + k
                    found.by[count] = more * by
                    count += 1
    return count


@inline
def refill_balls(balls, place, own, new):
    """Fill the balls around a voxel of the block that became a phase."""
    fills, lines, _ = balls
    channels = fills.shape[1]
    for n in range(len(RADII)):
        begin, stop, line = _balls_around(fills, n, place)
        for c in range(channels):
            more = _gained(c, channels, own, new)
            full = fills[n, c].reshape(-1)
            for k in range(begin, stop):
                if full[line + lines[k]] >= 0:
                    full[line + lines[k]] += more


@inline
def _gained(channel, channels, own, new):
    """Return how many voxels of its phase a channel gains where a voxel becomes a phase."""
    if channels == 1:
        return np.int64(new) - np.int64(own)
    return np.int64(channel == new) - np.int64(channel == own)


@inline
def _balls_around(fills, n, place):
    """Return which of `_near` are the balls of a radius that hold a voxel of the block, from one to
    the one after the last, and where in fills (z, y, x), read as one line, they begin to be
    counted.
    """
    z, y, x = place
    within = ((z % STEP) * STEP + y % STEP) * STEP + x % STEP
    line = (z // STEP + _LEAD) * fills.shape[3] + y // STEP + _LEAD
    first = _first_near[n]
    return first[within], first[within + 1], line * fills.shape[4] + x // STEP + _LEAD
