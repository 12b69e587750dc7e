"""The field that fits voted values and gradients best: the screened Poisson system of `gradient`,
solved matrix-free.

Conjugate gradients with the diagonal as preconditioner. The condition is about 1 + 12 mu, so with
mu near 1 ten products with the matrix suffice, each at the cost of a vote of two neighbourhoods;
multigrid would pay from a mu of some tens on.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from trabecula.core.checks import as_number
from trabecula.engine import memmap
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs, sum_slabs
from trabecula.synth.texture.gradient import GradientVotes

_QUANTUM = 256  # parts of a field's unit in the result
_MOST = 32767
_STEPS = 500  # of conjugate gradients at most: mu = 1000 takes some 300


def solve_votes(
    votes: GradientVotes,
    *,
    mu: float,
    unit: int = 1,
    tolerance: float = 1 / 64,
    start: np.ndarray | None = None,
) -> np.ndarray:
    """Find the field that fits the voted values and gradients best: equation (1) for fixed matches
    and weights.

    Parameters
    ----------
    votes : Votes
    mu : float
        Weight of the gradients, 0 .. 100000, against values of weight 1; 0 gives the weighted mean.
        Beyond some 1000 the steps end before the tolerance is met.
    unit : int
        The integer weight that stands for 1.
    tolerance : float
        How far voxels may stay from the solution, as root mean square over those voted on, in units
        of the field.
    start : (C, Z, Y, X) array, optional
        A guess, in units of the field. Default: the weighted mean.

    Returns
    -------
    (C, Z, Y, X) int16
        256 times the field; 0 where no neighbourhood votes.

    Raises
    ------
    InputError
        A number out of range.
    """
    mu = float(as_number(mu, name="mu", low=0, high=1e5))
    unit = int(as_number(unit, name="unit", low=1, high=2**20, whole=True))
    tolerance = float(as_number(tolerance, name="tolerance", low=1e-6, high=16))
    result = memmap.empty(votes.values.shape, np.int16)
    for channel in range(len(result)):
        guess = None if start is None else start[channel]
        _solve_channel(votes, channel, np.float32(mu * unit), guess, tolerance, result[channel])
    return result


def _solve_channel(
    votes: GradientVotes,
    channel: int,
    mu: np.float32,
    guess: np.ndarray | None,
    tolerance: float,
    result: np.ndarray,
) -> None:
    """Write 256 times the field of one channel to `result`."""
    field = _initial_field(votes, channel, guess if mu > 0 else None)
    if mu > 0:
        _solve(votes, channel, mu, field, tolerance)
    for_slabs(partial(_round, field, result), len(field))


def _initial_field(votes: GradientVotes, channel: int, guess: np.ndarray | None) -> np.ndarray:
    """Return the guess, or the weighted mean, as (Z, Y, X) float32."""
    field = memmap.empty(votes.weights.shape, np.float32)
    if guess is None:
        for_slabs(partial(_average, votes.values[channel], votes.weights, field), len(field))
    else:
        for_slabs(partial(_copy_guess, guess, votes.weights, field), len(field))
    return field


def _copy_guess(
    guess: np.ndarray, weights: np.ndarray, field: np.ndarray, start: int, stop: int
) -> None:
    field[start:stop] = np.where(weights[start:stop] > 0, guess[start:stop], 0)


def _solve(
    votes: GradientVotes, channel: int, mu: np.float32, field: np.ndarray, tolerance: float
) -> None:
    """Iterate conjugate gradients on `field`. Scalar products are summed plane by plane, then over
    planes.
    """
    weights, pairs = votes.weights, votes.pairs
    planes = len(field)
    part = np.empty((planes, 2))
    inverse, rest, along, image = (memmap.empty(field.shape, np.float32) for _ in range(4))

    def total() -> np.ndarray:
        return np.array([_sum(part[:, 0]), _sum(part[:, 1])])

    system = votes.values[channel], votes.gradients[channel], weights, pairs, mu
    for_slabs(partial(_begin, *system, field, inverse, rest, along, part), planes)
    old, size = total()
    # The preconditioned rest is the error of a voxel whose neighbours are right. Where they err
    # alike, the diagonal overstates what holds a voxel in its place by this ratio.
    paired, weight, held = sum_slabs(partial(_count_votes, pairs, weights), planes).tolist()
    ratio = 1 + 2 * float(mu) * paired / max(weight, 1)
    enough = (tolerance / ratio) ** 2 * held
    for _ in range(_STEPS):
        if size <= enough or old <= 0:
            break
        for_slabs(partial(_multiply, weights, pairs, mu, along, image, part), planes)
        step = np.float32(old / total()[0])
        for_slabs(partial(_advance, step, along, image, inverse, field, rest, part), planes)
        new, size = total()
        for_slabs(partial(_turn, np.float32(new / old), inverse, rest, along), planes)
        old = new


def _count_votes(pairs: np.ndarray, weights: np.ndarray, start: int, stop: int) -> np.ndarray:
    """Count pairs, weights and voxels voted on."""
    part = weights[start:stop]
    return np.array(
        [pairs[:, start:stop].sum(dtype=np.int64), part.sum(dtype=np.int64), np.count_nonzero(part)]
    )


@kernel
def _sum(values):
    total = 0.0
    for value in values:
        total += value
    return total


@kernel
def _round(field, result, start, stop):
    for z in range(start, stop):
        for y in range(field.shape[1]):
            for x in range(field.shape[2]):
                value = np.rint(field[z, y, x] * np.float32(_QUANTUM))
                result[z, y, x] = np.int16(min(max(value, np.float32(-_MOST)), np.float32(_MOST)))


@kernel
def _average(values, weights, mean, start, stop):
    for z in range(start, stop):
        for y in range(mean.shape[1]):
            for x in range(mean.shape[2]):
                w = weights[z, y, x]
                mean[z, y, x] = (
                    np.float32(values[z, y, x]) / np.float32(w) if w > 0 else np.float32(0)
                )


@inline
def _row(weights, pairs, mu, field, z, y, out):
    """Multiply the matrix by `field`, one row: W s + mu sum_b n_ab (s_a - s_b)."""
    Z, Y, X = field.shape
    below, above, before, after = (
        z - 1 if z > 0 else Z - 1,
        z + 1 if z < Z - 1 else 0,
        y - 1 if y > 0 else Y - 1,
        y + 1,
    )
    after = after if after < Y else 0
    s, n2 = field[z, y], pairs[2, z, y]
    nu, nd, nf, nb = pairs[0, z, y], pairs[0, below, y], pairs[1, z, y], pairs[1, z, before]
    su, sd, sf, sb = field[above, y], field[below, y], field[z, after], field[z, before]
    for x in range(X):
        pull = np.float32(nu[x]) * (s[x] - su[x]) + np.float32(nd[x]) * (s[x] - sd[x])
        pull += np.float32(nf[x]) * (s[x] - sf[x]) + np.float32(nb[x]) * (s[x] - sb[x])
        out[x] = np.float32(weights[z, y, x]) * s[x] + mu * pull
    for x in range(X - 1):
        out[x] += mu * np.float32(n2[x]) * (s[x] - s[x + 1])
    for x in range(1, X):
        out[x] += mu * np.float32(n2[x - 1]) * (s[x] - s[x - 1])
    wrapped = mu * np.float32(n2[X - 1]) * (s[X - 1] - s[0])
    out[X - 1] += wrapped
    out[0] -= wrapped


@kernel
def _begin(values, gradients, weights, pairs, mu, field, inverse, rest, along, part, start, stop):
    """Write the diagonal's inverse, the first residual and direction; per plane residual .
    direction and |direction|^2.
    """
    X = field.shape[2]
    for z in range(start, stop):
        part[z] = 0
        for y in range(field.shape[1]):
            _row(weights, pairs, mu, field, z, y, rest[z, y])
            for x in range(X):
                n = (
                    np.int32(pairs[0, z, y, x])
                    + pairs[0, z - 1, y, x]
                    + pairs[1, z, y, x]
                    + pairs[1, z, y - 1, x]
                )
                n += np.int32(pairs[2, z, y, x]) + pairs[2, z, y, x - 1]
                # weightless voxels keep their value: a row of zeros has no part in the directions
                weight = np.float32(weights[z, y, x])
                inverse[z, y, x] = (
                    np.float32(1) / (weight + mu * np.float32(n)) if weight > 0 else np.float32(0)
                )
                wanted = np.float32(values[z, y, x]) + mu * np.float32(gradients[z, y, x])
                rest[z, y, x] = wanted - rest[z, y, x] if weight > 0 else np.float32(0)
                along[z, y, x] = inverse[z, y, x] * rest[z, y, x]
            part[z, 0] += _dot(rest[z, y], along[z, y])
            part[z, 1] += _dot(along[z, y], along[z, y])


@inline
def _dot(a, b):
    """Multiply in float64 and eight interleaved sums: one sum would wait for each addition."""
    part = np.zeros(8)
    for i in range(0, len(a) - 7, 8):
        for j in range(8):
            part[j] += np.float64(a[i + j]) * np.float64(b[i + j])
    for i in range(len(a) // 8 * 8, len(a)):
        part[0] += np.float64(a[i]) * np.float64(b[i])
    return ((part[0] + part[1]) + (part[2] + part[3])) + ((part[4] + part[5]) + (part[6] + part[7]))


@kernel
def _multiply(weights, pairs, mu, along, image, part, start, stop):
    for z in range(start, stop):
        part[z] = 0
        for y in range(along.shape[1]):
            _row(weights, pairs, mu, along, z, y, image[z, y])
            part[z, 0] += _dot(along[z, y], image[z, y])


@kernel
def _advance(step, along, image, inverse, field, rest, part, start, stop):
    """Advance along the direction; per plane residual . z and |z|^2 of the preconditioned residual
    z.
    """
    near = np.empty(field.shape[2], np.float32)
    for z in range(start, stop):
        part[z] = 0
        for y in range(field.shape[1]):
            for x in range(field.shape[2]):
                field[z, y, x] += step * along[z, y, x]
                rest[z, y, x] -= step * image[z, y, x]
                near[x] = inverse[z, y, x] * rest[z, y, x]
            part[z, 0] += _dot(rest[z, y], near)
            part[z, 1] += _dot(near, near)


@kernel
def _turn(share, inverse, rest, along, start, stop):
    for z in range(start, stop):
        for y in range(along.shape[1]):
            for x in range(along.shape[2]):
                along[z, y, x] = inverse[z, y, x] * rest[z, y, x] + share * along[z, y, x]
