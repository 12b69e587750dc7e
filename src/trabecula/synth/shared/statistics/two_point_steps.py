"""Steps that bring the two-point function of a field to an exemplar's, by moving its interfaces a
little.

The two-point function here is that of a soft indicator, which rises from 0 to 1 over `softness`
around the interface, so that a small move changes it a little. A step is one of Gauss and Newton in
as many directions as there are bands of distances: the direction of a band is the gradient of the
squared misfit at these distances, a convolution of the field, kept on the interface and freed of
its mean there (which would change the volume fraction). The convolution wraps around the faces even
where the material does not: cut off there it would pile up one phase on them.

The two-point function of a vote falls short of what the step before had reached, always on the same
side. `debt`, the sum of such misfits, makes the step aim as far beyond (as the integral term of a
controller does).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from trabecula.engine.memory import Array, Stage, Workspace
from trabecula.synth.shared.content.fields import FULL, UNIT, votes_of
from trabecula.synth.shared.slabs import for_plane_groups
from trabecula.synth.shared.statistics.pairs import Pairs
from trabecula.synth.shared.statistics.two_point import Correlations, Soft

# a misfit at distance r weighs 1 + (_SHORT / r)^2: what sets the surface is a few distances only
_SHORT = 2.0

LEAK = 0.5
"""Share of the misfits of earlier rounds that still counts."""

BANDS = (1, 2, 3, 5, 8, 12)
"""Where the bands of distances begin, voxels; the last one reaches to r_max."""

_RIDGE = 1e-3
_TOGETHER = 1 << 16  # voxels that are moved in one call, unless a plane has more
_LENGTHS = np.arange(1, 33) / 16  # of a step, in steps of Gauss and Newton


def accumulate_debt(
    debt: np.ndarray | None,
    field: np.ndarray,
    target: Correlations,
    *,
    periodic: Sequence[bool] = (False, False, False),
    free: np.ndarray | None = None,
) -> np.ndarray:
    """Return the debt after a round of votes that left `field` (C, Z, Y, X) int8."""
    now = misfit(field, target, periodic=periodic, free=free)
    return now if debt is None else now + LEAK * debt


def misfit(
    field: np.ndarray,
    target: Correlations,
    *,
    periodic: Sequence[bool] = (False, False, False),
    free: np.ndarray | None = None,
) -> np.ndarray:
    """Subtract the target's two-point functions from those of (C, Z, Y, X) int8: (C, bins), 0 where
    there are no pairs.
    """
    pairs, _ = _pairs(field.shape[1:], target, periodic, free)
    found = np.empty_like(target.curves)
    for c, channel in enumerate(field):
        spectrum = pairs.forward(Soft.of(channel, target.softness, free).planes)
        found[c] = pairs.curve(spectrum, spectrum) - target.curves[c]
    return np.where((pairs.fits > 0) & target.held, found, 0.0)


def two_point_step(
    field: np.ndarray,
    target: Correlations,
    *,
    debt: np.ndarray | None = None,
    periodic: Sequence[bool] = (False, False, False),
    free: np.ndarray | None = None,
) -> np.ndarray:
    """Move the interfaces of a field one step towards the target's two-point functions.

    Parameters
    ----------
    field : (C, Z, Y, X) int8
    target : Correlations
    debt : (C, bins), optional
        Misfit to aim beyond the target by: a field at target - debt is left as it is.
    periodic : three bools
        Whether pairs wrap around.
    free : (Z, Y, X) bool, optional
        Only pairs of such voxels count, and only such voxels change.

    Returns
    -------
    (C, Z, Y, X) int16
        In 1 / UNIT of an int8 step, to be matched to the exemplar's histogram.
    """
    pairs, around = _pairs(field.shape[1:], target, periodic, free)
    votes = votes_of(field)
    for c, channel in enumerate(field):
        aim = target.curves[c] if debt is None else target.curves[c] - debt[c]
        step = _step(Soft.of(channel, target.softness, free), aim, target, pairs, around)
        if step is not None:
            step[0].take(step[1], np.float32(UNIT * target.softness), votes[c])
    return votes


def step_stages(
    shape: Sequence[int], target: Correlations, periodic: Sequence[bool] = (False, False, False)
) -> tuple[Stage, ...]:
    """Declare the arrays of `two_point_step` beside the field and the votes, for a volume of this
    shape.
    """
    return _stages(*_pairs(shape, target, periodic))


def _stages(pairs: Pairs, around: Pairs) -> tuple[Stage, ...]:
    held = {"spectrum": pairs.spectrum, "centred": around.spectrum}
    slope = {"slope": Array(pairs.shape, np.float32)}
    tables = pairs.table_bytes + around.table_bytes + max(pairs.slab_bytes, around.slab_bytes)
    inverse = {"kernel": around.kernel, "product": around.spectrum}
    return (
        Stage("make a direction", {**held, **slope, **inverse}, tables),
        Stage("transform it", {**held, **slope, "change": pairs.spectrum}, tables),
        Stage(
            "compare it",
            {**held, "change": pairs.spectrum, "lines": pairs.kernel},
            tables + 4 * pairs.table_bytes,
        ),
        Stage("take it", {**slope, "change": pairs.spectrum, "lines": pairs.kernel}, tables),
    )


def _pairs(
    shape: Sequence[int],
    target: Correlations,
    periodic: Sequence[bool],
    free: np.ndarray | None = None,
) -> tuple[Pairs, Pairs]:
    """Return the pairs that count, and those of directions, which wrap around the faces."""
    pairs = Pairs(
        tuple(shape),
        target.r_max,
        tuple(bool(wrap) for wrap in periodic),
        target.edges,
        free,
        directions=target.directions,
    )
    return pairs, replace(pairs, wraps=(True, True, True), free=None)


class Slopes(Protocol):
    """Planes (n, Y, X) float32 of a gradient, by slices: an array, or what makes them."""

    def __len__(self) -> int: ...
    def __getitem__(self, planes: slice, /) -> np.ndarray: ...


@dataclass(frozen=True)
class Direction:
    """A direction in which the two-point function falls where it is pushed: on the interface only,
    its mean there left as it is.

    `slope` (Z, Y, X) float32 is the gradient everywhere, `mean` that on the interface.
    """

    slope: Slopes
    mean: np.float32
    soft: Soft

    def planes(self, start: int, stop: int) -> np.ndarray:
        """Return planes start..stop (n, Y, X) float32."""
        down = self.mean - self.slope[start:stop]
        return np.where(self.soft.interface(start, stop), down, np.float32(0))

    @classmethod
    def of(cls, slope: Slopes, soft: Soft, moving: int) -> Direction:
        """Return the direction down a slope, on the interface of `moving` voxels."""
        sums = np.zeros(len(slope))

        def work(start: int, stop: int) -> None:
            pushed = slope[start:stop] * soft.interface(start, stop)
            sums[start:stop] = pushed.sum(axis=(1, 2), dtype=np.float64)

        for_plane_groups(work, soft.field.shape, at_once=_TOGETHER)
        return cls(slope, np.float32(math.fsum(sums.tolist()) / moving), soft)

    def take(self, length: np.float32, unit: np.float32, votes: np.ndarray) -> None:
        """Go so far: into votes (Z, Y, X) int16, `unit` of which is the soft indicator's whole
        range.
        """
        limit = FULL * UNIT

        def work(start: int, stop: int) -> None:
            moved = self.planes(start, stop)
            moved *= length
            moved *= unit
            moved += votes[start:stop]
            votes[start:stop] = np.clip(np.rint(moved, out=moved), -limit, limit, out=moved)

        for_plane_groups(work, votes.shape, at_once=_TOGETHER)


def _step(
    soft: Soft, aim: np.ndarray, target: Correlations, pairs: Pairs, around: Pairs
) -> tuple[Direction, np.float32] | None:
    """Find the direction of the soft indicator's move, and its length; None where nothing can move,
    or nothing has to.
    """
    mean, moving = soft.mean_and_moving()
    if not moving:
        return None
    work = Workspace(_stages(pairs, around))
    work.enter("compare it")
    work.adopt("spectrum", pairs.forward(soft.planes))
    r, weights = weigh_distances(pairs, target)
    excess = pairs.curve(work["spectrum"], work["spectrum"]) - aim
    work.adopt("centred", around.forward(partial(soft.centre, mean)))

    shortest = longest_wave(target)
    pushes, changes = split_into_bands(excess * weights, r), []
    for push in pushes:
        work.enter("make a direction")
        direction = _direction(push, soft, moving, work["centred"], around, shortest)
        work.enter("transform it")
        work.adopt("change", pairs.forward(direction.planes))
        del direction  # as large as the field
        work.enter("compare it")
        changes.append(2 * pairs.curve(work["spectrum"], work["change"]))
    if not pushes:
        return None
    shares = least_squares(np.array(changes), excess, weights)
    push = np.sum([share * push for share, push in zip(shares, pushes, strict=True)], axis=0)
    change = np.sum([share * change for share, change in zip(shares, changes, strict=True)], axis=0)
    work.enter("make a direction")
    direction = _direction(push, soft, moving, work["centred"], around, shortest)
    work.enter("take it")
    square = pairs.curve(*[work.adopt("change", pairs.forward(direction.planes))] * 2)
    return direction, np.float32(best_length(excess, change, square, weights))


def _direction(
    push: np.ndarray, soft: Soft, moving: int, centred: np.ndarray, around: Pairs, shorter_than: int
) -> Direction:
    """Return the direction that lowers the two-point function where it is pushed, on the interface
    of `moving` voxels.
    """
    slope = around.convolve(centred, push / np.maximum(around.fits, 1), shorter_than=shorter_than)
    return Direction.of(slope, soft, moving)


def weigh_distances(pairs: Pairs, target: Correlations) -> tuple[np.ndarray, np.ndarray]:
    """Return the distance of every bin, and what its misfit weighs: 0 without pairs."""
    r = np.arange(pairs.bins) % (target.r_max + 1)
    counts = (r > 0) & (pairs.fits > 0) & target.held
    return r, np.where(counts, 1 + (_SHORT / np.maximum(r, 1)) ** 2, 0.0)


def longest_wave(target: Correlations) -> int:
    """Return the width of the widest window of the target's long waves, in its blocks; 0 where it
    has none.

    Steps that were cut at twice the smallest window instead left S2 of bone .03 off where it is
    .015 now: lags of 16 to 40 have no other hold.
    """
    if target.waves is None or not target.waves.widths:
        return 0
    return target.waves.widths[-1] // target.blocks


def split_into_bands(push: np.ndarray, r: np.ndarray) -> list[np.ndarray]:
    """Split a push at the distance of every bin into one array a band, scaled to its largest; bands
    without any are left out.
    """
    bands = []
    for low, high in zip(BANDS, (*BANDS[1:], len(push)), strict=True):
        part = np.where((r >= low) & (r < high), push, 0.0)
        if part.any():
            bands.append(part / np.abs(part).max())
    return bands


def least_squares(changes: np.ndarray, excess: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the share of each change that takes the excess away best; exact sums and no LAPACK, so
    the same everywhere.
    """
    count = len(changes)

    def dot(a: np.ndarray, b: np.ndarray) -> float:
        return math.fsum((a * b * weights).tolist())

    matrix = [
        [dot(changes[i], changes[j]) for j in range(count)] + [-dot(changes[i], excess)]
        for i in range(count)
    ]
    for i in range(count):
        matrix[i][i] = matrix[i][i] * (1 + _RIDGE) + 1e-300
    for i in range(count):  # symmetric and positive definite: the diagonal serves as it comes
        for j in range(i + 1, count):
            factor = matrix[j][i] / matrix[i][i]
            matrix[j] = [a - factor * b for a, b in zip(matrix[j], matrix[i], strict=True)]
    shares = [0.0] * count
    for i in reversed(range(count)):
        known = math.fsum(matrix[i][j] * shares[j] for j in range(i + 1, count))
        shares[i] = (matrix[i][-1] - known) / matrix[i][i]
    return np.array(shares)


def best_length(
    excess: np.ndarray, change: np.ndarray, square: np.ndarray, weights: np.ndarray
) -> float:
    """Choose the step, of a few lengths, that leaves least: a move by a changes the curve by a
    change + a^2 square.
    """
    left = excess + _LENGTHS[:, None] * change + _LENGTHS[:, None] ** 2 * square
    return float(_LENGTHS[np.argmin((left**2 * weights).sum(axis=1))])
