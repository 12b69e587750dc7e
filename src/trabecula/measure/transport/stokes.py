"""Stokes flow along the first axis: the saddle point of velocity and pressure, and its
preconditioner.

Viscous matrix A, divergence B: A u - B' p = f, B u = 0. A step of the preconditioner is a step of
SIMPLE (Patankar and Spalding 1972, doi:10.1016/0017-9310(72)90054-3): a velocity from the momentum,
a pressure that makes it free of divergence, a velocity corrected by that pressure. Two things make
it quick in porous media:

- The inverse of A that stands between pressure and velocity is replaced by its row sums, the
solution of A m = 1: the
  parabola of every channel, so that m is the local permeability, and B m B' the pressure equation
  of Darcy's law. It is exact for a constant gradient, where the usual inverse of A's diagonal is
  off by the square of the pore's width.
- Below the width of a pore B A^-1 B' is the identity; so the identity's inverse is added to that of
B m B' (as for a
  Helmholtz term by Cahouet and Chabard 1988, doi:10.1002/fld.1650080802).

With it some 12 to 20 steps do, whatever the size of the image and the width of its pores.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.measure.transport.conduction_kernels import enumerate_voxels
from trabecula.measure.transport.graph import Graph
from trabecula.measure.transport.krylov import conjugate_gradients, conjugate_residuals
from trabecula.measure.transport.multigrid import multigrid
from trabecula.measure.transport.result import imbalance
from trabecula.measure.transport.stokes_kernels import (
    assemble_pressure,
    assemble_viscous,
    divergence,
    enumerate_faces,
    link,
    momentum,
    push,
    section_flows,
)
from trabecula.measure.transport.vectors import dot

_MOST_STEPS = 300
_ROUGH = 0.03  # residual at which mobility and first pressure are good enough


@dataclass(frozen=True, eq=False)
class Grid:
    """Unknowns and links of a marker-and-cell grid, as `stokes_kernels` describes them."""

    faces: np.ndarray  # int32, (3, Z + 1, Y, X)
    bounds: np.ndarray  # int64, (4,)
    faces_of: np.ndarray  # int32, (N, 6)
    cells_of: np.ndarray  # int32, (M, 2)
    area: np.ndarray  # float64, (3,)
    volume: float
    viscous: Graph
    place: np.ndarray  # int16, (N, 3), of the voxels

    def apply(self, x: np.ndarray) -> np.ndarray:
        """The whole matrix times (velocity, pressure)."""
        u, p = np.split(x, [len(self.cells_of)])
        force = momentum(*self.viscous.rows, self.cells_of, self.bounds, self.area, u, p)
        return np.concatenate([force, divergence(self.faces_of, self.area, u)])

    def driving_force(self) -> np.ndarray:
        """Pressure 1 on the near end face."""
        return np.where(self.cells_of[:, 0] < 0, self.area[0], 0.0)


def grid(active: np.ndarray, edges: np.ndarray) -> Grid:
    """The grid of the active voxels."""
    number, cells = enumerate_voxels(active)
    faces, bounds = enumerate_faces(number)
    count = int(bounds[3])
    faces_of, cells_of = link(number, faces, cells, count)
    volume = float(np.prod(edges))
    viscous = Graph(*assemble_viscous(number, faces, count, volume / edges**2))
    place = np.argwhere(active).astype(np.int16)
    return Grid(faces, bounds, faces_of, cells_of, volume / edges, volume, viscous, place)


class Simple:
    """The preconditioner; calling it maps a residual to a correction."""

    def __init__(self, flow: Grid) -> None:
        self.flow = flow
        self.velocity = multigrid(flow.viscous)
        ends = (flow.cells_of < 0).any(axis=1)
        share = np.where(ends, 0.5 * flow.volume, flow.volume)
        mobility = np.zeros(len(share))
        conjugate_gradients(
            flow.viscous, share, mobility, self.velocity, done=_roughly(share), most=20
        )
        self.mobility = mobility / share
        links = assemble_pressure(
            flow.faces_of, flow.cells_of, self.mobility, flow.area, flow.place
        )
        self.pressure_graph = Graph(*links)
        self.pressure = multigrid(self.pressure_graph)

    def first(self, force: np.ndarray) -> np.ndarray:
        """Velocity and pressure of Darcy's law."""
        flow = self.flow
        u = self.mobility * force
        right = -divergence(flow.faces_of, flow.area, u)
        p = np.zeros(len(right))
        conjugate_gradients(
            self.pressure_graph, right, p, self.pressure, done=_roughly(right), most=20
        )
        push(flow.cells_of, flow.bounds, flow.area, p, self.mobility, u)
        return np.concatenate([u, p])

    def __call__(self, residual: np.ndarray) -> np.ndarray:
        flow = self.flow
        force, outflow = np.split(residual, [len(flow.cells_of)])
        u = self.velocity(force).astype(np.float64)
        rest = outflow - divergence(flow.faces_of, flow.area, u)
        p = self.pressure(rest).astype(np.float64)
        push(flow.cells_of, flow.bounds, flow.area, p, self.mobility, u)
        return np.concatenate([u, p + rest / flow.volume])


def _roughly(right: np.ndarray):
    limit = _ROUGH**2 * dot(right, right)
    return lambda x, residual: dot(residual, residual) <= limit


def flow_through(
    active: np.ndarray, edges: np.ndarray, *, tolerance: float
) -> tuple[np.ndarray, int, bool]:
    """Flow through every section of the first axis for a pressure drop of 1 and viscosity 1; steps,
    converged.
    """
    flow = grid(active, edges)
    count = len(flow.cells_of)
    force = flow.driving_force()
    precondition = Simple(flow)
    x = precondition.first(force)
    residual = -flow.apply(x)
    residual[:count] += force
    limit = tolerance**2 * dot(force, force)

    def flows(x: np.ndarray) -> np.ndarray:
        return section_flows(flow.faces, x[:count]) * flow.area[0]

    def done(x: np.ndarray, residual: np.ndarray) -> bool:
        if dot(residual[:count], residual[:count]) > limit:
            return False
        through = flows(x)
        # x . residual is the power put in less the power dissipated.
        return imbalance(through) <= tolerance and abs(dot(x, residual)) <= tolerance * abs(
            float(through.mean())
        )

    steps, converged = conjugate_residuals(
        flow.apply, residual, x, precondition, done=done, most=_MOST_STEPS
    )
    return flows(x), steps, converged
