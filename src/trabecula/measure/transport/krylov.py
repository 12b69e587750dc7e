"""Krylov methods whose preconditioner may change from step to step, as the K-cycle does."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.measure.transport.graph import Graph
from trabecula.measure.transport.vectors import add_to, combine, dot

_IDLE = 0.05  # share of the residual's square that a step has to take away
_LONGEST = 15  # directions that are kept at most

Operator = Callable[[np.ndarray], np.ndarray]
Test = Callable[[np.ndarray, np.ndarray], bool]
"""Whether x is good enough, from x and its residual."""


def conjugate_gradients(
    graph: Graph, right: np.ndarray, x: np.ndarray, precondition: Operator, *, done: Test, most: int
) -> tuple[int, bool]:
    """Improve `x` in place; the steps taken, and whether `done` ended them.

    Flexible conjugate gradients, truncated to one direction (Notay 2000,
    doi:10.1137/S1064827599362314).
    """
    residual = right - multiply(*graph.rows, x)
    direction = image = np.zeros(0)
    energy = 0.0
    for step in range(most):
        if done(x, residual):
            return step, True
        z = precondition(residual).astype(np.float64)
        direction = combine(1.0, z, -dot(z, image) / energy, direction) if step else z
        image = multiply(*graph.rows, direction)
        energy = dot(direction, image)
        if not energy > 0.0:  # nothing left that float64 could tell
            return step, False
        length = dot(direction, residual) / energy
        add_to(x, length, direction)
        add_to(residual, -length, image)
    return most, done(x, residual)


def conjugate_residuals(
    matrix: Operator,
    residual: np.ndarray,
    x: np.ndarray,
    precondition: Operator,
    *,
    done: Test,
    most: int,
    keep: int = 3,
) -> tuple[int, bool]:
    """Improve `x` and its `residual` in place, for any matrix; the steps taken, and whether `done`
    ended them.

    Generalised conjugate residuals, truncated to the last `keep` directions (Eisenstat, Elman and
    Schultz 1983, doi:10.1137/0720023).
    """
    kept: deque[tuple[np.ndarray, np.ndarray, float]] = deque()
    source, left = residual, dot(residual, residual)
    for step in range(most):
        if done(x, residual):
            return step, True
        direction = precondition(source)
        image = matrix(direction)
        for before, its_image, size in kept:
            overlap = dot(image, its_image) / size
            add_to(direction, -overlap, before)
            add_to(image, -overlap, its_image)
        size = dot(image, image)
        if not size > 0.0:
            return step, False
        length = dot(image, residual) / size
        add_to(x, length, direction)
        add_to(residual, -length, image)
        kept.append((direction, image, size))
        idle = length * length * size < _IDLE * left
        # The same residual would give the same direction again, for ever: go on from its image, and
        # remember more.
        source = image if idle else residual
        keep = min(keep + 3, _LONGEST) if idle else keep
        while len(kept) > keep:
            kept.popleft()
        left = dot(residual, residual)
    return most, done(x, residual)


@kernel
def multiply(start, other, weight, diagonal, x):
    """The matrix times x, float64."""
    y = np.empty(len(x))
    for i in range(len(x)):
        total = diagonal[i] * x[i]
        for k in range(start[i], start[i + 1]):
            total -= weight[k] * x[other[k]]
        y[i] = total
    return y
