"""The global energy of equation (1), the weights of equation (2), their feedback on lambda, and the
stop rule.

Choices where the paper leaves some:

- Which energy has to fall. Equation (1) holds the weights, and the weights hold lambda: raised by 5
%, it makes the energy
  rise by itself, the rise makes lambda fall by 30 %, the energy follows it down, and so on: a curve
  that falls fast and deep while nothing improves. So `Energy.robust` is compared: each weight
  belonging to the present distance, lambda = 1. With mu = 0 it is what reweighted least squares
  descends. `literal=True` compares `Energy.weighted` instead, as it is written. `Energy.squares`
  has no weights: curves with and without them are compared by it.
- The unit of a distance. d^(r - 2) is not free of units beside mu, so a distance counts against a
`reference`; another
  reference is another mu.
- An exact match has an infinite weight: `floor` is added to a squared distance.
- How far lambda may go, and the threshold of the stop rule.

With mu = 0 a factor common to all weights leaves the vote unchanged, so then lambda changes nothing
but `weighted`.

Zhang, Chen, Wang, Wang (2017), Computer Aided Geometric Design, sections 4.1 and 4.3.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from trabecula.core.errors import InputError
from trabecula.engine import memmap
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs


@dataclass(frozen=True)
class Energy:
    """The energies after one round, in squared units of the field; comparable only on one level
    with one neighbourhood size.
    """

    weighted: float
    """sum w_p d_p^2 + mu g: equation (1) with the weights of the vote, lambda in them."""

    robust: float
    """reference^(2 - r) sum d_p^r + mu g: the same with weights of the present distances and lambda
    = 1.
    """

    squares: float
    """sum d_p^2."""

    gradient: float
    """g = sum of squared differences of gradients."""


@dataclass(frozen=True)
class Feedback:
    """The state of equation (2)'s control and of the stop rule. Start with `Feedback()`, continue
    with `after`.
    """

    scale: float = 1.0
    """lambda."""

    increase: float = 0.05
    """epsilon_i, 0 or more; 0 for this and `decrease` leaves lambda at 1."""

    decrease: float = 0.3
    """epsilon_d, 0 .. 1."""

    limit: float = 32.0
    """lambda stays within 1 / limit .. limit, 1 or more: an energy that oscillates would take it to
    0, and mu / lambda to infinity."""

    tolerance: float = 1e-3
    """Relative change of the energy below which a round was the last, 0 or more."""

    most: int = 30
    """Rounds at most."""

    literal: bool = False
    """Compare equation (1) with lambda in it."""

    trace: tuple[Energy, ...] = ()
    """The rounds so far."""

    def after(self, energy: Energy) -> Feedback:
        """Return the state after a round that ended with `energy`."""
        scale = self.scale
        if self.trace:
            before, now = self._comparable(self.trace[-1]), self._comparable(energy)
            scale *= 1 + self.increase if now < before else 1 - self.decrease if now > before else 1
        scale = min(max(scale, 1 / self.limit), self.limit)
        return replace(self, scale=scale, trace=(*self.trace, energy))

    @property
    def is_over(self) -> bool:
        """Return whether the energy has settled, or the rounds are used up."""
        if len(self.trace) >= self.most:
            return True
        if len(self.trace) < 2:
            return False
        before, now = (self._comparable(energy) for energy in self.trace[-2:])
        return abs(now - before) <= self.tolerance * before

    def _comparable(self, energy: Energy) -> float:
        return energy.weighted if self.literal else energy.robust


def mismatch(
    field: np.ndarray,
    exemplar: np.ndarray,
    match: np.ndarray,
    *,
    shape: tuple[int, ...],
    stride: int,
    step: int,
    width: int,
    gradient: bool = True,
    active: np.ndarray | None = None,
) -> np.ndarray:
    """Compute, per site, d^2 = |s_p - e_p|^2, and |G(s_p) - G(e_p)|^2 over pairs of adjacent
    voxels, in whole neighbourhoods.

    Parameters
    ----------
    field : (C, Z, Y, X) int8, or int16 for 256 times the field
        The state, on the volume that the sites cover (continued round axes that wrap).
    exemplar : (C, z, y, x) int8
    match : (sz, sy, sx) int32
        As for `add_votes`; 0 is returned where it is below 0.
    gradient : bool
        False leaves the second at 0, in a third of the time.
    active : (sz, sy, sx) bool, optional
        Sites that count; 0 is returned for the others.

    Returns
    -------
    (2, sz, sy, sx) float64
        In squared units of the field; exact.

    Raises
    ------
    InputError
        The field is not on the volume that the sites cover.
    """
    covered = tuple((count - 1) * step + width for count in match.shape)
    if field.shape != (len(exemplar), *covered) or field.dtype not in (np.int8, np.int16):
        raise InputError(
            f"the field is {field.dtype} of shape {field.shape}: int8 or int16 of "
            f"{(len(exemplar), *covered)} is needed"
        )
    parts = 1 if field.dtype == np.int8 else 256
    where = np.empty((0, 0, 0), bool) if active is None else active
    result = memmap.zeros((2, *match.shape), np.float64)

    place = (shape, stride, step, width)

    def work(start: int, stop: int) -> None:
        _mismatch(field, parts, exemplar, match, where, place, gradient, result, start, stop)

    for_slabs(work, len(match), least=1)
    return result


def adaptive_weights(
    squared: np.ndarray,
    *,
    robustness: float,
    reference: float,
    scale: float = 1.0,
    floor: float = 0.0,
) -> np.ndarray:
    """Compute w_p = lambda (d_p / reference)^(r - 2): equation (2).

    Parameters
    ----------
    squared : array
        d_p^2, in whatever unit.
    robustness : float
        r, 0 .. 2; 2 gives every neighbourhood the same weight.
    reference : float
        The distance whose weight is lambda, in the same unit (not squared); keep it for all rounds
        that are compared.
    scale : float
        lambda.
    floor : float
        Added to `squared`, so that an exact match does not outvote everything; such as one unit of
        the field per voxel.

    Returns
    -------
    float64 array

    Examples
    --------
    >>> import numpy as np
    >>> adaptive_weights(np.array([1.0, 4.0, 16.0]), robustness=1, reference=2.0).tolist()
    [2.0, 1.0, 0.5]
    """
    return scale * ((squared + floor) / reference**2) ** ((robustness - 2) / 2)


def energy(
    squared: np.ndarray,
    gradient: np.ndarray,
    weights: np.ndarray,
    *,
    mu: float,
    robustness: float,
    reference: float,
    floor: float = 0.0,
    unit: float = 1.0,
) -> Energy:
    """Evaluate equation (1) for a state and its matches.

    Parameters
    ----------
    squared, gradient : (sz, sy, sx) arrays
        From `mismatch`, after the vote.
    weights : (sz, sy, sx) array
        Those of the vote (0: no neighbourhood).
    mu, robustness, reference, floor : float
        As in the vote and in `adaptive_weights`.
    unit : float
        The weight that counts as 1.

    Notes
    -----
    Sums are rounded once, at their end, so they do not depend on an order.
    """
    settings = {"robustness": robustness, "reference": reference, "floor": floor}

    def there(values: np.ndarray, z: int) -> np.ndarray:
        return np.asarray(values[z][weights[z] > 0])

    def robust(z: int) -> np.ndarray:
        kept = there(squared, z)
        # kept + floor: d^r at d = 0 has to be finite for r = 0 as well, and smooth for the
        # comparison of rounds
        return adaptive_weights(kept, **settings) * (kept + floor)

    count = len(weights)
    steepness = total(lambda z: there(gradient, z), count)
    return Energy(
        weighted=total(lambda z: there(weights, z) * unit * there(squared, z), count)
        + mu * steepness,
        robust=total(robust, count) + mu * steepness,
        squares=total(lambda z: there(squared, z), count),
        gradient=steepness,
    )


def total(values: Callable[[int], np.ndarray], count: int) -> float:
    """Sum `values(z)` over all `count` planes, rounded once, at its end: it depends on no order."""
    return math.fsum(chain.from_iterable(_values_by_plane(values, count)))


def _values_by_plane(values: Callable[[int], np.ndarray], count: int) -> Iterator[list[float]]:
    """Yield one plane after the other: numbers of Python take 32 bytes each."""
    for z in range(count):
        yield values(z).ravel().tolist()
        memmap.release_pages()


@kernel
def _mismatch(state, parts, example, match, active, place, gradient, result, start, stop):
    """Compute sites start..stop in whole numbers: `state` counts `parts` to a unit. An empty
    `active` means everywhere.
    """
    shape, stride, step, width = place
    difference = np.empty((width, width, width), np.int32)
    for sz in range(start, stop):
        for sy in range(match.shape[1]):
            for sx in range(match.shape[2]):
                m = match[sz, sy, sx]
                if m < 0 or (active.size > 0 and not active[sz, sy, sx]):
                    continue
                ez = m // (shape[2] * shape[1]) * stride
                ey, ex = (m // shape[2]) % shape[1] * stride, m % shape[2] * stride
                squared, slopes, x0 = np.int64(0), np.int64(0), sx * step
                for c in range(len(state)):
                    for z in range(width):
                        for y in range(width):
                            row = state[c, sz * step + z, sy * step + y, x0 : x0 + width]
                            own = example[c, ez + z, ey + y, ex : ex + width]
                            for x in range(width):
                                apart = np.int32(row[x]) - np.int32(parts) * np.int32(own[x])
                                difference[z, y, x] = apart
                                squared += np.int64(apart) * np.int64(apart)
                    if not gradient:
                        continue
                    for z in range(width):
                        for y in range(width):
                            for x in range(width):
                                here = np.int64(difference[z, y, x])
                                if x > 0:
                                    slopes += (here - difference[z, y, x - 1]) ** 2
                                if y > 0:
                                    slopes += (here - difference[z, y - 1, x]) ** 2
                                if z > 0:
                                    slopes += (here - difference[z - 1, y, x]) ** 2
                # Below 2^53 and over a power of two: exact.
                result[0, sz, sy, sx] = squared / np.float64(parts * parts)
                result[1, sz, sy, sx] = slopes / np.float64(parts * parts)
