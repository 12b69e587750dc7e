"""Steps that bring the two-point function of a field to an exemplar's, by moving its interfaces a little.

The two-point function here is that of a soft indicator, which rises from 0 to 1 over `softness` around the interface, so that a
small move changes it a little. Pairs are told apart by their distance and by the axis they lie nearest to: of distance
alone, a material that is longer along one axis would come out longer still. A step is one of Gauss and Newton in as many
directions as there are bands of distances: the direction of a band is the gradient of the squared misfit at these
distances, a convolution of the field, kept on the interface and freed of its mean there (which would change the volume
fraction). The convolution wraps around the faces even where the material does not: cut off there it would pile up one
phase on them.

The two-point function of a vote falls short of what the step before had reached, always on the same side. `debt`, the sum of
such misfits, makes the step aim as far beyond (as the integral term of a controller does).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.synth.shared.fields import FULL
from trabecula.synth.shared.statistics.pairs import Pairs
from trabecula.synth.shared.statistics.sliced import UNIT

BANDS = (1, 2, 3, 5, 8, 12)
"""Where the bands of distances begin, voxels; the last one reaches to r_max."""

_SOFTNESS = (1.6, 2.4)  # voxels of the soft interface: on the finest level, and on the others
_REACH, _NEAR = 30, 6  # farthest distance in voxels of the finest level, and at least so many of a level's own
_LEAK = 0.5  # share of earlier rounds' misfits that is still aimed against
_SHORT = 2.0  # a misfit at distance r weighs 1 + (_SHORT / r)^2: what sets the surface is a few distances only
_RIDGE = 1e-3
_LENGTHS = np.arange(1, 33) / 16  # of a step, in steps of Gauss and Newton


@dataclass(frozen=True)
class Correlations:
    """What to come to: `curves` (C, 3 (r_max + 1)), the two-point function of every channel's soft indicator, of pairs
    nearest to z, then to y, then to x.

    `softness` is the width of the soft step in int8 steps of the field; `edges` are the sides of a voxel; `held` (bool) says
    for which of them the exemplars hold any pairs.
    """

    curves: np.ndarray
    softness: float
    edges: tuple[float, ...]
    held: np.ndarray

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
    """The two-point functions of the soft indicators of exemplars (C, Z, Y, X) int8, all pairs of them counted alike.

    A picture is a volume of one plane across the axis that it is seen across: it says nothing of pairs along that axis.

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
            spectrum = pairs.forward(soft_indicator(channel, softness))
            sums[c] += pairs.curve(spectrum, spectrum) * pairs.fits
    return Correlations(sums / np.maximum(fits, 1), softness, steps, fits > 0)


def correlations_at(fields: Sequence[np.ndarray], level: int, *, edges: Sequence[float], clip: float) -> Correlations:
    """The target of one level (0 the finest) of a pyramid, with the softness and the reach that suit it.

    `clip` is the distance in voxels of the level at which its int8 fields saturate.
    """
    shortest = min(side for field in fields for side in field.shape[1:] if side > 1)  # a picture has no depth
    reach = min(_REACH, shortest * 2**level // 2 - 1)
    softness = _SOFTNESS[min(level, len(_SOFTNESS) - 1)] * FULL / clip
    return correlations_of(fields, softness=softness, r_max=max(_NEAR, reach // 2**level), edges=edges)


def owed(
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


def soft_indicator(field: np.ndarray, softness: float) -> np.ndarray:
    """0 .. 1 in float32 of a field in int8."""
    table = np.clip(np.arange(-128, 128) / softness + 0.5, 0, 1).astype(np.float32)
    return np.asarray(table[field.astype(np.int16) + 128])


def misfit(
    field: np.ndarray,
    target: Correlations,
    *,
    periodic: Sequence[bool] = (False, False, False),
    free: np.ndarray | None = None,
) -> np.ndarray:
    """The two-point functions of (C, Z, Y, X) int8 less the target's, (C, 3 (r_max + 1)); 0 where there are no pairs."""
    pairs = _pairs(field, target, periodic, free)
    found = np.empty_like(target.curves)
    for c, channel in enumerate(field):
        spectrum = pairs.forward(_soft(channel, target, free))
        found[c] = pairs.curve(spectrum, spectrum) - target.curves[c]
    return np.where((pairs.fits > 0) & target.held, found, 0.0)


def corrected(
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
    pairs = _pairs(field, target, periodic, free)
    around = Pairs(pairs.shape, target.r_max, (True, True, True), target.edges)
    votes = field.astype(np.int16) * np.int16(UNIT)
    for c, channel in enumerate(field):
        aim = target.curves[c] if debt is None else target.curves[c] - debt[c]
        move = _step(channel, aim, target, pairs, around, free)
        if move is not None:
            limit = FULL * UNIT
            votes[c] = np.clip(np.rint(votes[c] + move * np.float32(UNIT * target.softness)), -limit, limit)
    return votes


def _pairs(field: np.ndarray, target: Correlations, periodic: Sequence[bool], free: np.ndarray | None) -> Pairs:
    return Pairs(field.shape[1:], target.r_max, tuple(bool(wrap) for wrap in periodic), target.edges, free)


def _soft(channel: np.ndarray, target: Correlations, free: np.ndarray | None) -> np.ndarray:
    soft = soft_indicator(channel, target.softness)
    return soft if free is None else soft * free


def _step(
    channel: np.ndarray,
    aim: np.ndarray,
    target: Correlations,
    pairs: Pairs,
    around: Pairs,
    free: np.ndarray | None,
) -> np.ndarray | None:
    """How far the soft indicator moves, (Z, Y, X) float32; None where nothing can, or nothing has to."""
    soft = _soft(channel, target, free)
    interface = (soft > 0) & (soft < 1)
    if not interface.any():
        return None
    spectrum = pairs.forward(soft)
    r = np.arange(pairs.bins) % (target.r_max + 1)
    weights = np.where((r > 0) & (pairs.fits > 0) & target.held, 1 + (_SHORT / np.maximum(r, 1)) ** 2, 0.0)
    excess = pairs.curve(spectrum, spectrum) - aim
    mean = np.float32(soft.sum(dtype=np.float64) / (soft.size if free is None else np.count_nonzero(free)))
    centred = around.forward(np.subtract(soft, mean, out=soft, where=True if free is None else free))
    del soft  # the peak is ahead

    pushes, changes = [], []
    for push in _bands(excess * weights):
        pushes.append(push)
        changes.append(2 * pairs.curve(spectrum, pairs.forward(_direction(push, interface, centred, around))))
    if not pushes:
        return None
    shares = _least_squares(np.array(changes), excess, weights)
    push = np.sum([share * push for share, push in zip(shares, pushes, strict=True)], axis=0)
    move = _direction(push, interface, centred, around)
    change = np.sum([share * change for share, change in zip(shares, changes, strict=True)], axis=0)
    spectra = pairs.forward(move)
    length = _best_length(excess, change, pairs.curve(spectra, spectra), weights)
    return np.asarray(move * np.float32(length))


def _direction(push: np.ndarray, interface: np.ndarray, centred: np.ndarray, around: Pairs) -> np.ndarray:
    """What lowers the two-point function where it is pushed, on the interface, and leaves the mean as it is."""
    move = around.convolved(centred, push / np.maximum(around.fits, 1))
    move *= interface
    mean = np.float32(move.sum(dtype=np.float64) / np.count_nonzero(interface))
    return np.subtract(mean, move, out=move, where=interface)


def _bands(push: np.ndarray) -> list[np.ndarray]:
    """What to push at every distance, one array a band, scaled to its largest; bands without any are left out."""
    r = np.arange(len(push)) % (len(push) // 3)
    bands = []
    for low, high in zip(BANDS, (*BANDS[1:], len(push)), strict=True):
        part = np.where((r >= low) & (r < high), push, 0.0)
        if part.any():
            bands.append(part / np.abs(part).max())
    return bands


def _least_squares(changes: np.ndarray, excess: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """How much of each change takes the excess away best; exact sums and no LAPACK, so the same everywhere."""
    count = len(changes)

    def dot(a: np.ndarray, b: np.ndarray) -> float:
        return math.fsum((a * b * weights).tolist())

    matrix = [[dot(changes[i], changes[j]) for j in range(count)] + [-dot(changes[i], excess)] for i in range(count)]
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


def _best_length(excess: np.ndarray, change: np.ndarray, square: np.ndarray, weights: np.ndarray) -> float:
    """The step, of a few lengths, that leaves least: a move by a changes the curve by a change + a^2 square."""
    left = excess + _LENGTHS[:, None] * change + _LENGTHS[:, None] ** 2 * square
    return float(_LENGTHS[np.argmin((left**2 * weights).sum(axis=1))])
