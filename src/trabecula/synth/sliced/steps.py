"""Steps on the two-point function of the phases that a field is cut to, rather than of its soft
values.

A field that is histogram-matched to distances need not be one: where it rises slowly, fewer and
smoother interfaces make up the same histogram, and a soft indicator of its values does not see it.
Divided by its own slope it is a distance near the interface, whichever way it rises; the target is
the two-point function of the picture's phases themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.memory import Array, Stage, within
from trabecula.engine.parallel import for_slabs, thread_count
from trabecula.synth.shared.content.fields import FULL, UNIT
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.statistics.two_point import Correlations
from trabecula.synth.shared.statistics.two_point_steps import step_stages, two_point_step

FAR = 4.0
"""Voxels at which distances saturate here."""

_FLAT = np.float32(1.0)  # least slope, int8 steps a voxel
# planes of which slopes are made at once, unless these are more voxels than so many
_FEW, _MANY = 8, 1 << 19


def distance_step(field: np.ndarray, target: Correlations, region: Region) -> np.ndarray:
    """Take one step.

    Parameters
    ----------
    field : (C, Z, Y, X) int8
    target : Correlations
        The softness is that of distances which saturate at `FAR`.
    region : Region

    Returns
    -------
    (C, Z, Y, X) int16
        In 1 / UNIT of an int8 step of the field, to be matched to its histogram.
    """
    distance = memmap.empty(field.shape, np.int8, least=0)  # another process may write it
    for channel, far in zip(field, distance, strict=True):
        _by_few(partial(_divide_by_slope, channel, region.wraps, far), channel.shape, anywhere=True)
    votes = two_point_step(distance, target, periodic=region.wraps, free=region.free)
    for channel, far, moved in zip(field, distance, votes, strict=True):
        _by_few(partial(_multiply_by_slope, channel, region.wraps, far, moved), channel.shape)
    return votes


def distance_stages(
    shape: Sequence[int], target: Correlations, periodic: Sequence[bool]
) -> tuple[Stage, ...]:
    """Declare the arrays of `distance_step` beside the field (C, Z, Y, X) and the votes."""
    held = {"distance": Array(shape, np.int8)}
    planes = thread_count() * 48 * (_few(shape[1:]) + 2) * shape[2] * shape[3]
    return (
        Stage("divide by the slope", held, planes),
        *within(held, step_stages(shape[1:], target, periodic)),
    )


def _few(shape: Sequence[int]) -> int:
    """Count the planes that are worked on at once: their temporary arrays are many
    times as large.
    """
    return max(1, min(_FEW, _MANY // (shape[1] * shape[2])))


def _by_few(
    work: Callable[[int, int], None], shape: Sequence[int], *, anywhere: bool = False
) -> None:
    """Call work(start, stop) on all planes, a few at a time."""
    most = _few(shape)

    def few(start: int, stop: int) -> None:
        for first in range(start, stop, most):
            work(first, min(first + most, stop))

    for_slabs(few, shape[0], anywhere=anywhere)


def _divide_by_slope(
    channel: np.ndarray, wraps: Sequence[bool], far: np.ndarray, start: int, stop: int
) -> None:
    """Divide planes start..stop of a channel (Z, Y, X) int8 by their slope, into `far`, alike:
    `FULL` is `FAR` voxels.
    """
    ratio = channel[start:stop] / slope(channel, wraps, start, stop)
    np.clip(ratio, -FAR, FAR, out=ratio)
    ratio *= np.float32(FULL / FAR)
    far[start:stop] = np.rint(ratio, out=ratio)


def _multiply_by_slope(
    channel: np.ndarray,
    wraps: Sequence[bool],
    far: np.ndarray,
    votes: np.ndarray,
    start: int,
    stop: int,
) -> None:
    """Convert the move of planes start..stop of `far` (Z, Y, X) int8 to `votes` (Z, Y, X) int16
    into votes for the channel, in place.
    """
    limit = FULL * UNIT
    part = slice(start, stop)
    moves = (votes[part] - far[part] * np.int16(UNIT)) * (
        slope(channel, wraps, start, stop) * np.float32(FAR / FULL)
    )
    np.rint(moves, out=moves)
    moves += channel[part] * np.float32(UNIT)
    votes[part] = np.clip(moves, -limit, limit, out=moves)


def slope(channel: np.ndarray, wraps: Sequence[bool], start: int, stop: int) -> np.ndarray:
    """Return the length of the gradient of (Z, Y, X) int8 in steps a voxel, averaged over
    neighbours and never 0: planes start..stop, float32.
    """
    # a neighbour more on either side
    planes = _around(np.arange(start - 1, stop + 1), len(channel), wraps[0])
    square = np.zeros((len(planes), *channel.shape[1:]), np.float32)
    before, after = (channel[_around(planes + by, len(channel), wraps[0])] for by in (-1, 1))
    _add_square(square, before, after)
    for axis in (1, 2):
        _add_square(square, *_neighbours(channel[planes], axis, wraps[axis]))
    wide = np.sqrt(square, out=square)
    mean = _average(wide[1:-1], wide[:-2], wide[2:])
    for axis in (1, 2):
        mean = _average(mean, *_neighbours(mean, axis, wraps[axis]))
    return np.maximum(mean, _FLAT, out=mean)


def _add_square(square: np.ndarray, before: np.ndarray, after: np.ndarray) -> None:
    rise = after.astype(np.float32)
    rise -= before
    rise *= np.float32(0.5)
    rise *= rise
    square += rise


def _average(values: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Average with weights of a quarter, a half, a quarter."""
    return (before + after + 2 * values) * np.float32(0.25)


def _neighbours(values: np.ndarray, axis: int, wrap: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the values before and after every voxel along an axis."""
    cells, side = np.arange(values.shape[axis]), values.shape[axis]
    before, after = (_around(cells + by, side, wrap) for by in (-1, 1))
    return values.take(before, axis), values.take(after, axis)


def _around(cells: np.ndarray, side: int, wrap: bool) -> np.ndarray:
    """Clip cells to the last one beyond an end, or wrap them to the other end."""
    return cells % side if wrap else cells.clip(0, side - 1)
