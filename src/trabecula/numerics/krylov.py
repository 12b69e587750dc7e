"""Krylov methods: preconditioned conjugate gradients, and conjugate residuals for any matrix."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from trabecula.numerics.vectors import add_to, dot

_IDLE = 0.05  # share of the residual's square that a step has to take away
_LONGEST = 15  # directions that are stored at most

Scalar = Any
"""A float, or an array with one number for each of several right-hand sides."""


class LinearSystem(ABC):
    """A symmetric positive semidefinite system with its preconditioner and its vector operations.

    Vectors have any shape; a system may solve for several right-hand sides at once, the last axis.
    It may return the same array from every call of `precondition`, and from every call of `apply`:
    flexible steps look back at the last product, but before the next one.
    """

    @abstractmethod
    def apply(self, vector: np.ndarray) -> np.ndarray:
        """Return the matrix times a vector."""

    @abstractmethod
    def precondition(self, residual: np.ndarray) -> np.ndarray:
        """Return an approximate solution for a residual."""

    @abstractmethod
    def dot(self, a: np.ndarray, b: np.ndarray) -> Scalar:
        """Return the inner product, one for each right-hand side."""

    def turn(self, direction: np.ndarray, factor: Scalar, z: np.ndarray) -> None:
        """Replace the direction by `z + factor * direction`."""
        direction *= factor
        direction += z

    def advance(
        self, at: Iterate, length: Scalar, direction: np.ndarray, product: np.ndarray
    ) -> None:
        """Add `length * direction` to x and take `length * product` from the residual."""
        at.x += length * direction
        at.residual -= length * product


class Iterate:
    """The state of conjugate gradients before a step.

    Parameters
    ----------
    system : LinearSystem
    x, residual : array
        Solution and residual so far; both change in place.

    Attributes
    ----------
    steps : int
        Steps taken.
    energy : float or array
        Sum of `length * (residual . z)`: from x = 0 it is x . right-hand side, and it grows with
        every step.
    """

    def __init__(self, system: LinearSystem, x: np.ndarray, residual: np.ndarray) -> None:
        self.system, self.steps = system, 0
        self.x, self.residual = x, residual
        self.energy: Scalar = 0.0
        self._z: np.ndarray | None = None
        self._rho: Scalar = None

    @property
    def z(self) -> np.ndarray:
        """Return the preconditioned residual, computed once a step."""
        if self._z is None:
            self._z = self.system.precondition(self.residual)
        return self._z

    @property
    def rho(self) -> Scalar:
        """Return residual . z, computed once a step: it estimates the square of the error in the
        energy norm.
        """
        if self._rho is None:
            self._rho = self.system.dot(self.residual, self.z)
        return self._rho

    def step(self, length: Scalar, direction: np.ndarray, product: np.ndarray) -> None:
        """Move x by `length * direction`."""
        self.system.advance(self, length, direction, product)
        self.steps += 1
        self._z = self._rho = None


def conjugate_gradients(
    system: LinearSystem,
    x: np.ndarray,
    residual: np.ndarray,
    *,
    accept: Callable[[Iterate], bool],
    most: int,
    flexible: bool = False,
) -> tuple[Iterate, bool]:
    """Improve `x` and its `residual` in place by preconditioned conjugate gradients.

    Parameters
    ----------
    system : LinearSystem
    x, residual : array
        The start, and right-hand side less matrix times start.
    accept : callable
        Returns whether an iterate is good enough; called before every step and after the last.
    most : int
        Steps at most.
    flexible : bool
        For a preconditioner that changes from step to step, as the K-cycle does: the new direction
        is made conjugate to the last one by an inner product of its own (Notay 2000,
        doi:10.1137/S1064827599362314, truncated to one direction).

    Returns
    -------
    last : Iterate
    converged : bool
        `accept` ended the steps; False also where no direction of positive energy was left.
    """
    at = Iterate(system, x, residual)
    direction = product = residual
    curvature = rho = None
    while not accept(at):
        if at.steps == most:
            return at, False
        if curvature is None:
            direction = at.z.copy()
        else:
            factor = (
                -_quotient(system.dot(at.z, product), curvature)
                if flexible
                else _quotient(at.rho, rho)
            )
            system.turn(direction, factor, at.z)
        product = system.apply(direction)
        curvature = system.dot(direction, product)
        if not np.any(curvature > 0.0):  # float64 resolves nothing more
            return at, False
        rho = system.dot(direction, residual) if flexible else at.rho
        length = _quotient(rho, curvature)
        at.energy = at.energy + length * rho
        at.step(length, direction, product)
    return at, True


def _quotient(a: Scalar, b: Scalar) -> Scalar:
    """Return a / b, and 0 where b is not positive: for a right-hand side that is solved exactly."""
    if np.ndim(b) == 0:
        return a / b if b > 0.0 else 0.0
    return np.where(b > 0.0, a / np.where(b > 0.0, b, 1.0), 0.0)


def conjugate_residuals(
    matrix: Callable[[np.ndarray], np.ndarray],
    residual: np.ndarray,
    x: np.ndarray,
    precondition: Callable[[np.ndarray], np.ndarray],
    *,
    accept: Callable[[np.ndarray, np.ndarray], bool],
    most: int,
    keep: int = 3,
) -> tuple[int, bool]:
    """Improve `x` and its `residual` in place, for any matrix and a preconditioner that may change.

    Generalised conjugate residuals, truncated to the last `keep` directions (Eisenstat, Elman and
    Schultz 1983, doi:10.1137/0720023).

    Returns
    -------
    steps : int
    converged : bool
        `accept`, called with x and its residual, ended the steps.
    """
    stored: deque[tuple[np.ndarray, np.ndarray, float]] = deque()
    source, left = residual, dot(residual, residual)
    for step in range(most):
        if accept(x, residual):
            return step, True
        direction = precondition(source)
        image = matrix(direction)
        _orthogonalise(direction, image, stored)
        size = dot(image, image)
        if not size > 0.0:
            return step, False
        length = dot(image, residual) / size
        add_to(x, length, direction)
        add_to(residual, -length, image)
        stored.append((direction, image, size))
        idle = length * length * size < _IDLE * left
        # The same residual would give the same direction again, for ever: continue from its image,
        # and store more directions.
        source = image if idle else residual
        keep = min(keep + 3, _LONGEST) if idle else keep
        while len(stored) > keep:
            stored.popleft()
        left = dot(residual, residual)
    return most, accept(x, residual)


def _orthogonalise(
    direction: np.ndarray,
    image: np.ndarray,
    stored: deque[tuple[np.ndarray, np.ndarray, float]],
) -> None:
    """Make an image orthogonal to those that are stored; no name here outlives the call, so that a
    pair that is dropped later is freed at once.
    """
    for before, its_image, size in stored:
        overlap = dot(image, its_image) / size
        add_to(direction, -overlap, before)
        add_to(image, -overlap, its_image)
