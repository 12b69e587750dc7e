"""Flow through a network: Kirchhoff's law at every pore, by conjugate gradients."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.measure.transport.result import Effective, not_percolating
from trabecula.measure.union_find import join, number_trees
from trabecula.numerics.krylov import Iterate, LinearSystem, conjugate_gradients

if TYPE_CHECKING:
    from trabecula.measure.network.pore_network import PoreNetwork

_TOLERANCE = 1e-10
_MOST_STEPS = 100_000


def effective(net: PoreNetwork, axis: int, inner: np.ndarray, outer: np.ndarray) -> Effective:
    """Return the effective coefficient along an axis: the flux over the mean gradient, with
    conductances of the throats (`inner`) and of the openings.
    """
    sides = np.array(net.shape) * np.array(net.spacing)
    fraction = float(net.volume.sum() / np.prod(sides))
    length, area = float(sides[axis]), float(np.prod(sides) / sides[axis])
    drop = (net.throats.shift[:, axis] * 1.0) if net.periodic[axis] else np.zeros(len(inner))
    inlet, outlet = np.zeros(len(net)), np.zeros(len(net))
    if not net.periodic[axis]:
        for end, conductance in enumerate((inlet, outlet)):
            own = net.openings.face == 2 * axis + end
            np.add.at(conductance, net.openings.pores[own, 0], outer[own])
    if net.periodic[axis]:
        through = _winding(net.throats.pores, net.throats.shift[:, axis], len(net))
    else:
        joined = _joined(net.throats.pores, len(net))
        ends = [np.bincount(joined, end)[joined] > 0 for end in (inlet, outlet)]
        through = ends[0] & ends[1]
    if not through.any():
        return not_percolating(fraction)
    first, second = net.throats.pores.T
    kept = through[first]
    first, second, weight, drop = first[kept], second[kept], inner[kept], drop[kept]
    inlet, outlet = inlet * through, outlet * through
    # pressure 1 before the inlet, 0 behind the outlet; of a period the drop across a throat is
    # p_first - p_second + drop
    right = inlet.copy()
    np.subtract.at(right, first, weight * drop)
    np.add.at(right, second, weight * drop)
    system = _Network(first, second, weight, inlet + outlet, len(net))
    x = np.zeros(len(net))
    # what a pore's throats to its own image put in cancels out, but for rounding
    size = inlet + np.bincount(first, weight * abs(drop), len(net))
    limit = _TOLERANCE**2 * float(size @ size)

    def accept(at: Iterate) -> bool:
        return bool(at.residual @ at.residual <= limit)

    at, converged = conjugate_gradients(system, x, right.copy(), accept=accept, most=_MOST_STEPS)
    if net.periodic[axis]:
        # Power is flux times drop.
        fall = at.x[first] - at.x[second] + drop
        flux = float(weight @ fall**2)
        value, gap = flux * length / area, 0.0
    else:
        came = float(inlet @ (1 - at.x))
        went = float(outlet @ at.x)
        value = 0.5 * (came + went) * length / area
        gap = abs(came - went) / (0.5 * (came + went)) if came + went > 0 else 0.0
    return Effective(value, converged, gap, at.steps, fraction)


class _Network(LinearSystem):
    """Conductances between pores, and from them to what surrounds them; scaled by its diagonal."""

    def __init__(
        self, first: np.ndarray, second: np.ndarray, weight: np.ndarray, out: np.ndarray, count: int
    ) -> None:
        self.ends = np.ascontiguousarray(np.stack([first, second], axis=1))
        self.weight = weight
        self.diagonal = out + np.bincount(first, weight, count) + np.bincount(second, weight, count)
        self.out = out
        self.inverse = np.where(self.diagonal > 0, 1 / np.maximum(self.diagonal, 1e-300), 0.0)

    def apply(self, vector: np.ndarray) -> np.ndarray:
        """Return the matrix times a vector."""
        return _times(self.ends, self.weight, self.out, vector)

    def precondition(self, residual: np.ndarray) -> np.ndarray:
        """Return the residual over the diagonal."""
        return np.asarray(self.inverse * residual)

    def dot(self, a: np.ndarray, b: np.ndarray) -> float:
        """Return the scalar product."""
        return float(a @ b)


@kernel
def _times(ends, weight, out, x):
    y = out * x
    for t in range(len(weight)):
        i, j = ends[t]
        flow = weight[t] * (x[i] - x[j])
        y[i] += flow
        y[j] -= flow
    return y


@kernel
def _joined(pores, count):
    """Return the number of every pore's connected component."""
    parent = np.arange(count)
    for t in range(len(pores)):
        join(parent, pores[t, 0], pores[t, 1])
    return number_trees(parent)[0]


@kernel
def _winding(pores, shift, count):
    """Return the pores of components whose paths lead from a pore to its own image: trees with the
    number of periods from every pore to its root.
    """
    parent, away = np.arange(count), np.zeros(count, np.int64)
    winds = np.zeros(count, np.bool_)
    ends, periods = np.empty(2, np.int64), np.empty(2, np.int64)
    for t in range(len(pores)):
        for side in range(2):
            at, sum_ = pores[t, side], 0
            while parent[at] != at:
                sum_ += away[at]
                at = parent[at]
            ends[side], periods[side] = at, sum_
        step = periods[0] + shift[t] - periods[1]
        low, high = min(ends[0], ends[1]), max(ends[0], ends[1])
        if low == high:
            winds[low] |= step != 0
        else:
            parent[high] = low
            away[high] = step if high == ends[1] else -step
            winds[low] |= winds[high]
    found = np.zeros(count, np.bool_)
    for k in range(count):
        at = k
        while parent[at] != at:
            at = parent[at]
        found[k] = winds[at]
    return found
