"""Steps that bring the two-point function of a field to an exemplar's, by moving its interfaces a
little.

The two-point function here is that of a soft indicator, which rises from 0 to 1 over `softness`
around the interface, so that a small move changes it a little. Pairs are told apart by their
distance and by the axis they lie nearest to: of distance alone, a material that is longer along one
axis would come out longer still. A step is one of Gauss and Newton in as many directions as there
are bands of distances: the direction of a band is the gradient of the squared misfit at these
distances, a convolution of the field, kept on the interface and freed of its mean there (which
would change the volume fraction). The convolution wraps around the faces even where the material
does not: cut off there it would pile up one phase on them.

The two-point function of a vote falls short of what the step before had reached, always on the same
side. `debt`, the sum of such misfits, makes the step aim as far beyond (as the integral term of a
controller does).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from trabecula.engine.parallel import for_slabs
from trabecula.synth.shared.fields import FULL
from trabecula.synth.shared.statistics.bands import split_into_bands, best_length, least_squares
from trabecula.synth.shared.statistics.long_waves import LongWaves
from trabecula.synth.shared.statistics.pairs import Pairs
from trabecula.synth.shared.statistics.soft import Soft
from trabecula.synth.shared.votes import UNIT, votes_of

_SOFTNESS = (1.6, 2.4)  # voxels of the soft interface: on the finest level, and on the others
# farthest distance in voxels of the finest level, and at least so many of a level's own
_REACH, _NEAR = 30, 6
_LEAK = 0.5  # share of earlier rounds' misfits that is still aimed against
# a misfit at distance r weighs 1 + (_SHORT / r)^2: what sets the surface is a few distances only
_SHORT = 2.0


@dataclass(frozen=True)
class Correlations:
    """What to come to: `curves` (C, 3 (r_max + 1)), the two-point function of every channel's soft
    indicator, of pairs nearest to z, then to y, then to x.

    `softness` is the width of the soft step in int8 steps of the field; `edges` are the sides of a
    voxel; `held` (bool) says for which of them the exemplars hold any pairs. With `waves` the steps
    leave alone waves longer than twice their largest window.
    """

    curves: np.ndarray
    softness: float
    edges: tuple[float, ...]
    held: np.ndarray
    waves: LongWaves | None = None

    @property
    def r_max(self) -> int:
        """The largest distance."""
        return self.curves.shape[1] // 3 - 1


def correlations_of(
    fields: Sequence[np.ndarray],
    *,
    softness: float,
    r_max: int,
    edges: Sequence[float] = (1.0, 1.0, 1.0),
) -> Correlations:
    """The two-point functions of the soft indicators of exemplars (C, Z, Y, X) int8, all pairs of
    them counted alike.

    A picture is a volume of one plane across the axis that it is seen across: it says nothing of
    pairs along that axis.

    Parameters
    ----------
    fields : sequence of arrays
    softness : float
        Width of the soft step in int8 steps of the field: FULL / clip is one voxel.
    r_max : int
        Largest distance, in the unit of `edges`.
    edges : three floats
        Sides of a voxel.
    """
    steps = (float(edges[0]), float(edges[1]), float(edges[2]))
    sums = np.zeros((len(fields[0]), 3 * (r_max + 1)))
    fits = np.zeros(3 * (r_max + 1))
    for field in fields:
        pairs = Pairs(field.shape[1:], r_max, edges=steps)
        fits += pairs.fits
        for c, channel in enumerate(field):
            spectrum = pairs.forward(Soft.of(channel, softness).plane)
            sums[c] += pairs.curve(spectrum, spectrum) * pairs.fits
    return Correlations(sums / np.maximum(fits, 1), softness, steps, fits > 0)


def correlations_at(
    fields: Sequence[np.ndarray], level: int, *, edges: Sequence[float], clip: float
) -> Correlations:
    """The target of one level (0 the finest) of a pyramid, with the softness and the reach that
    suit it.

    `clip` is the distance in voxels of the level at which its int8 fields saturate.
    """
    # a picture has no depth
    shortest = min(side for field in fields for side in field.shape[1:] if side > 1)
    reach = min(_REACH, shortest * 2**level // 2 - 1)
    softness = _SOFTNESS[min(level, len(_SOFTNESS) - 1)] * FULL / clip
    return correlations_of(
        fields, softness=softness, r_max=max(_NEAR, reach // 2**level), edges=edges
    )


def accumulate_debt(
    debt: np.ndarray | None,
    field: np.ndarray,
    target: Correlations,
    *,
    periodic: Sequence[bool] = (False, False, False),
    free: np.ndarray | None = None,
) -> np.ndarray:
    """The debt after a round of votes that left `field` (C, Z, Y, X) int8."""
    now = misfit(field, target, periodic=periodic, free=free)
    return now if debt is None else now + _LEAK * debt


def misfit(
    field: np.ndarray,
    target: Correlations,
    *,
    periodic: Sequence[bool] = (False, False, False),
    free: np.ndarray | None = None,
) -> np.ndarray:
    """The two-point functions of (C, Z, Y, X) int8 less the target's, (C, 3 (r_max + 1)); 0 where
    there are no pairs.
    """
    pairs, _ = _pairs(field.shape[1:], target, periodic, free)
    found = np.empty_like(target.curves)
    for c, channel in enumerate(field):
        spectrum = pairs.forward(Soft.of(channel, target.softness, free).plane)
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
    """One step towards the target's two-point functions.

    Parameters
    ----------
    field : (C, Z, Y, X) int8
    target : Correlations
    debt : (C, 3 (r_max + 1)), optional
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
            _take(*step, np.float32(UNIT * target.softness), votes[c])
    return votes


def step_bytes(
    shape: Sequence[int], target: Correlations, periodic: Sequence[bool] = (False, False, False)
) -> int:
    """Memory of `two_point_step` at its peak beside the field and the votes, for a volume of this shape."""
    pairs, around = _pairs(shape, target, periodic)
    slope, change = 4 * math.prod(shape), pairs.spectrum_bytes
    # Moments that compete: a direction is made, it is transformed, its change of the two-point
    # function is read off.
    most = max(
        slope + around.spectrum_bytes + around.kernel_bytes,
        slope + change,
        change + pairs.kept_bytes,
    )
    held = pairs.spectrum_bytes + around.spectrum_bytes + pairs.table_bytes + around.table_bytes
    return held + most + pairs.slab_bytes


def step_slab_bytes(
    shape: Sequence[int], target: Correlations, periodic: Sequence[bool] = (False, False, False)
) -> int:
    """What of that stays in memory where arrays lie in scratch files."""
    pairs, around = _pairs(shape, target, periodic)
    return max(pairs.slab_bytes, around.slab_bytes) + 6 * pairs.table_bytes


def _pairs(
    shape: Sequence[int],
    target: Correlations,
    periodic: Sequence[bool],
    free: np.ndarray | None = None,
) -> tuple[Pairs, Pairs]:
    """Those that count, and those of directions, which wrap around the faces."""
    pairs = Pairs(
        tuple(shape), target.r_max, tuple(bool(wrap) for wrap in periodic), target.edges, free
    )
    return pairs, replace(pairs, wraps=(True, True, True), free=None)


@dataclass(frozen=True)
class _Direction:
    """A direction in which the two-point function falls where it is pushed: on the interface only,
    its mean there left as it is.

    `slope` (Z, Y, X) float32 is the gradient everywhere, `mean` that on the interface.
    """

    slope: np.ndarray
    mean: np.float32
    soft: Soft

    def plane(self, z: int) -> np.ndarray:
        """Plane z (Y, X) float32."""
        return np.where(self.soft.interface(z), self.mean - self.slope[z], np.float32(0))


def _step(
    soft: Soft, aim: np.ndarray, target: Correlations, pairs: Pairs, around: Pairs
) -> tuple[_Direction, np.float32] | None:
    """Where the soft indicator moves, and how far; None where nothing can, or nothing has to."""
    mean, moving = soft.mean_and_moving()
    if not moving:
        return None
    spectrum = pairs.forward(soft.plane)
    r = np.arange(pairs.bins) % (target.r_max + 1)
    weights = np.where(
        (r > 0) & (pairs.fits > 0) & target.held, 1 + (_SHORT / np.maximum(r, 1)) ** 2, 0.0
    )
    excess = pairs.curve(spectrum, spectrum) - aim
    centred = around.forward(partial(soft.centred, mean))

    # Cut at twice the smallest window instead, S2 of bone is .03 off where it is .015 now: lags of
    # 16 to 40 have no other hold.
    shortest = target.waves.widths[-1] if target.waves is not None and target.waves.widths else 0
    pushes, changes = split_into_bands(excess * weights), []
    for push in pushes:
        # Nobody holds on to a direction: each is as large as the field.
        change = pairs.forward(_direction(push, soft, moving, centred, around, shortest).plane)
        changes.append(2 * pairs.curve(spectrum, change))
        del change
    if not pushes:
        return None
    shares = least_squares(np.array(changes), excess, weights)
    push = np.sum([share * push for share, push in zip(shares, pushes, strict=True)], axis=0)
    change = np.sum([share * change for share, change in zip(shares, changes, strict=True)], axis=0)
    del spectrum
    direction = _direction(push, soft, moving, centred, around, shortest)
    del centred  # the peak is ahead
    spectra = pairs.forward(direction.plane)
    return direction, np.float32(
        best_length(excess, change, pairs.curve(spectra, spectra), weights)
    )


def _direction(
    push: np.ndarray, soft: Soft, moving: int, centred: np.ndarray, around: Pairs, shorter_than: int
) -> _Direction:
    """What lowers the two-point function where it is pushed, on the interface of `moving` voxels."""
    slope = around.convolved(centred, push / np.maximum(around.fits, 1), shorter_than=shorter_than)
    sums = np.zeros(len(slope))

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            sums[z] = (slope[z] * soft.interface(z)).sum(dtype=np.float64)

    for_slabs(work, len(slope))
    return _Direction(slope, np.float32(math.fsum(sums.tolist()) / moving), soft)


def _take(direction: _Direction, length: np.float32, unit: np.float32, votes: np.ndarray) -> None:
    """Go so far in a direction: into votes (Z, Y, X) int16, `unit` of which is the soft indicator's
    whole range.
    """
    limit = FULL * UNIT

    def work(start: int, stop: int) -> None:
        for z in range(start, stop):
            moved = votes[z] + direction.plane(z) * length * unit
            votes[z] = np.clip(np.rint(moved, out=moved), -limit, limit, out=moved)

    for_slabs(work, len(votes))
