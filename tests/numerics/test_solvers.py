"""Conjugate gradients and multigrid against direct solves of small systems."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from trabecula.numerics.krylov import LinearSystem, conjugate_gradients, conjugate_residuals
from trabecula.numerics.multigrid import Multigrid, k_cycle, v_cycle, w_cycle


@dataclass
class Dense(LinearSystem):
    """A dense system of several right-hand sides, with the diagonal as preconditioner."""

    matrix: np.ndarray

    def apply(self, vector):
        return self.matrix @ vector

    def precondition(self, residual):
        return residual / self.matrix.diagonal()[:, None]

    def dot(self, a, b):
        return (a * b).sum(axis=0)


class Poisson:
    """A level of the one-dimensional Poisson equation, ends at 0: damped Jacobi, linear weights."""

    def __init__(self, count):
        self.matrix = (2 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1)) * (count + 1)

    def apply(self, x):
        return (self.matrix @ x).astype(np.float32)

    def presmooth(self, right, x):
        return self.postsmooth(right, np.zeros_like(right) if x is None else x)

    def postsmooth(self, right, x):
        residual = right - self.matrix @ x
        return (x + 2 / 3 * residual / self.matrix[0, 0]).astype(np.float32)

    def restrict(self, right, x):
        r = right - self.matrix @ x
        return (r[1::2] + (r[:-2:2] + r[2::2]) / 2).astype(np.float32)

    def prolong(self, correction, x):
        x = x.copy()
        x[1::2] += correction
        x[::2] += (np.append(0, correction) + np.append(correction, 0)) / 2
        return x

    def solve(self, right):
        return np.linalg.solve(self.matrix, right).astype(np.float32)


def spd(count, seed=0):
    a = np.random.default_rng(seed).standard_normal((count, count))
    return a @ a.T + count * np.eye(count)


@pytest.mark.parametrize("flexible", [False, True])
def test_conjugate_gradients_solve_every_right_hand_side_in_as_many_steps_as_unknowns(flexible):
    matrix, right = spd(12), np.random.default_rng(1).standard_normal((12, 3))
    right[:, 1] = 0.0  # solved from the start: nothing may be divided by 0
    system, x, residual = Dense(matrix), np.zeros((12, 3)), right.copy()

    def accept(at):
        return np.abs(at.residual).max() < 1e-9

    last, converged = conjugate_gradients(
        system, x, residual, accept=accept, most=13, flexible=flexible
    )
    assert converged and last.steps <= 13 and last.x is x
    assert np.allclose(x, np.linalg.solve(matrix, right), atol=1e-9)
    assert np.allclose(residual, right - matrix @ x, atol=1e-8)
    assert np.allclose(last.energy, (x * right).sum(axis=0), rtol=1e-8)


def test_conjugate_gradients_stop_at_the_limit_and_without_energy():
    system, right = Dense(spd(12)), np.ones((12, 1))
    last, converged = conjugate_gradients(
        system, np.zeros((12, 1)), right.copy(), accept=lambda at: False, most=2
    )
    assert last.steps == 2 and not converged
    nothing = Dense(np.zeros((3, 3)) + np.diag([1e-300] * 3))
    nothing.matrix[:] = 0.0
    nothing.precondition = lambda residual: residual
    last, converged = conjugate_gradients(
        nothing, np.zeros((3, 1)), np.ones((3, 1)), accept=lambda at: False, most=5
    )
    assert last.steps == 0 and not converged


def test_the_estimate_of_the_error_is_that_of_the_energy_norm():
    matrix, right = spd(8), np.ones((8, 1))
    system = Dense(matrix)
    system.precondition = lambda residual: np.linalg.solve(matrix, residual)
    found = []

    def accept(at):
        found.append(float(at.rho[0]))
        return at.steps == 1

    conjugate_gradients(system, np.zeros((8, 1)), right.copy(), accept=accept, most=3)
    assert found[0] == pytest.approx(float(right[:, 0] @ np.linalg.solve(matrix, right[:, 0])))
    assert found[1] == pytest.approx(0.0, abs=1e-9)


def test_conjugate_residuals_solve_a_saddle_point():
    rng = np.random.default_rng(2)
    a, b = spd(6), rng.standard_normal((3, 6))
    matrix = np.block([[a, -b.T], [b, np.zeros((3, 3))]])
    right = rng.standard_normal(9)
    x, residual = np.zeros(9), right.copy()
    steps, converged = conjugate_residuals(
        lambda v: matrix @ v,
        residual,
        x,
        lambda r: r.copy(),
        accept=lambda x, residual: np.abs(residual).max() < 1e-8,
        most=200,
        keep=9,
    )
    assert converged and steps < 200
    assert np.allclose(matrix @ x, right, atol=1e-6)


@pytest.mark.parametrize("visit", [v_cycle, w_cycle, k_cycle])
def test_a_cycle_reduces_the_error_alike_on_any_number_of_levels(visit):
    for levels in (2, 4, 6):
        grids = [Poisson(2 ** (n + 2) - 1) for n in range(levels, 0, -1)]
        exact = np.random.default_rng(levels).standard_normal(len(grids[0].matrix))
        right = (grids[0].matrix @ exact).astype(np.float32)
        energy = exact @ grids[0].matrix @ exact
        error = exact - Multigrid(grids, visit)(right)
        assert error @ grids[0].matrix @ error < 0.15 * energy


def test_a_single_level_is_solved_at_once():
    grid = Poisson(7)
    right = np.ones(7, np.float32)
    assert np.allclose(Multigrid([grid], v_cycle)(right), np.linalg.solve(grid.matrix, right))
