"""Permeability: slow viscous flow through the void.

The saddle point of velocity and pressure along the first axis, with viscous matrix A and divergence
B: A u - B' p = f, B u = 0. A step of the preconditioner is a step of SIMPLE (Patankar and Spalding
1972, doi:10.1016/0017-9310(72)90054-3): a velocity from the momentum, a pressure that makes it free
of divergence, a velocity corrected by that pressure. Two things make it quick in porous media:

- The inverse of A that stands between pressure and velocity is replaced by its row sums, the
  solution of A m = 1: the parabola of every channel, so that m is the local permeability, and B m
  B' the pressure equation of Darcy's law. It is exact for a constant gradient, where the usual
  inverse of A's diagonal is off by the square of the pore's width.
- Below the width of a pore B A^-1 B' is the identity; so the identity's inverse is added to that of
  B m B' (as for a Helmholtz term by Cahouet and Chabard 1988, doi:10.1002/fld.1650080802).

With it some 12 to 22 steps do, whatever the size of the image and the width of its pores.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image
from trabecula.measure.phases import as_inside, indicator
from trabecula.measure.transport.marker_grid import MarkerGrid, SimplePreconditioner
from trabecula.measure.transport.result import Effective, imbalance, not_percolating
from trabecula.measure.transport.section import Solver, as_tolerance, effective, percolating_voxels
from trabecula.numerics.krylov import conjugate_residuals
from trabecula.numerics.vectors import dot

_MOST_STEPS = 300
_SINGLE = 3e-5  # tolerance from which on solution and residual are kept in float32

FLOW_BYTES = 310
"""Memory per voxel that carries flow, at the peak: resident memory, from 40 to 100 voxels an edge
of noise that is some voxels wide 195 to 230, of white noise 240 to 310.
"""


def permeability(
    image: Image | ArrayLike,
    *,
    axis: int,
    phase: str | int | None = None,
    tolerance: float = 1e-4,
    box: int | Sequence[int] | None = None,
    halving: bool = False,
) -> Effective:
    """Return the permeability k of a phase along one axis, in unit^2 (voxel^2 without a unit).

    Darcy's law: q = -k grad(p) / viscosity.

    Stokes flow through the phase from one end face of the image to the other by a difference of
    pressure: no slip at the other phases, mirrors at the side faces (no flow across them, no drag
    either), constant pressure and no tangential velocity on the end faces. That is the flow through
    the periodic medium that mirrors of the image build. Finite differences on a marker-and-cell
    grid with the voxels' spacing (Manwart et al. 2002, doi:10.1103/PhysRevE.66.016702, section III;
    Harlow and Welch 1965, doi:10.1063/1.1761178), solved for velocity and pressure at once. Voxels
    are neighbours where they share a face; only components that touch both end faces are solved.

    Narrow pores are resolved badly by any method on voxels. Along the axes a slit of n voxels comes
    out too permeable by the factor 1 + 2 / n^2 exactly, a square duct by 1 + 4 / n^2 about (4
    voxels: 22 %, 16: 1.5 %); a duct turned by 45 degrees, all stairs, errs as much beside one of
    the same number of voxels (4: 16 %, 8: 4 %, 16: 1.4 %), and by the voxels that the cut adds or
    drops besides (8 voxels: -6 to +32 %, by where it lies on the grid). Simple cubic spheres:
    within 2 % from a radius of 9 voxels where an eighth or a fifth is solid, from 14 where a third
    is (4 % at 10), up to 11 % at 4 to 7. With `halving`, `extrapolated` takes the error of flat
    walls along the axes away (square duct: 1.1 % at 3 voxels, .4 % at 4). Of round or oblique walls
    it must not be used: halved stairs stay stairs, and it is 5 to 29 % too low.

    Memory: 220 to 270 bytes a voxel of the phase in scans, up to 410 in noise, checked before
    anything is solved. Edges that differ by a hundred times may not converge (the result says so).

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
        With any spacing. In 2-D the flow between cylinders, without drag in the third direction.
    axis : int
        0 is z (y in 2-D); negative counts from the back.
    phase : str or int, optional
        Default: "void".
    tolerance : float, 1e-10 .. 0.1
        Of the imbalance of the flow between sections, of the power, and of the residual.
    box : int or one per axis, optional
        Solve a centred box of this edge in voxels (or as much of it as there is). Default: the
        whole image.
    halving : bool
        Also estimate the error of discretisation: on a centre box of at most 48 voxels an edge, the
        value with every voxel split into 2x2x2 (2x2) over the value without, minus 1. Stairs stay
        stairs and get rougher by it, so for round grains it overstates the error.

    Returns
    -------
    effective : Effective
        `value` is k; 0.0 where the phase does not percolate, infinite where it fills the image.

    Raises
    ------
    InputError
        No such axis or phase, a tolerance or box out of range, an image too large to solve at once.
    MemoryBudgetError
        More memory would be needed than there is: give a smaller `box`.

    Examples
    --------
    A slit of 8 voxels between walls: 8^2 / 12 times its share of the area, 0.8, plus 3 %.

    >>> slit = np.pad(np.zeros((4, 8), np.uint8), ((0, 0), (1, 1)), constant_values=1)
    >>> round(permeability(slit, axis=0).value / (8**2 / 12 * 0.8), 4)
    1.0312
    """
    image, inside = indicator(image, phase, default="void")
    solve = partial(_permeability, tolerance=as_tolerance(tolerance))
    solver = Solver(solve, np.array([False, True]), FLOW_BYTES)
    return effective(
        image, as_inside(inside).reshape(image.shape), solver, axis=axis, box=box, halving=halving
    )


def _permeability(inside: np.ndarray, edges: np.ndarray, *, tolerance: float) -> Effective:
    """Solve for the permeability along the first axis."""
    fraction = int(np.count_nonzero(inside)) / inside.size
    active = percolating_voxels(np.ascontiguousarray(inside))
    if active is None:
        return not_percolating(fraction)
    if active.all():  # mirrors alone hold no fluid
        return Effective(math.inf, True, 0.0, 0, fraction)
    # In units of the smallest edge, so that couplings stay near 1 in any unit.
    least = float(edges.min())
    sides = edges / least
    flow, steps, converged = _section_flows(active, sides, tolerance=tolerance)
    depth, height, width = inside.shape
    length, area = depth * sides[0], height * width * sides[1] * sides[2]
    value = float(flow.mean() * length / area) * least**2
    return Effective(value, converged, imbalance(flow), steps, fraction)


def _section_flows(
    active: np.ndarray, edges: np.ndarray, *, tolerance: float
) -> tuple[np.ndarray, int, bool]:
    """Solve for the flow through every section of the first axis, pressure drop and viscosity 1;
    return also the steps, and whether they converged.
    """
    flow, x, steps, converged = solve_flow(active, edges, tolerance=tolerance)
    return flow.section_flows(x), steps, converged


def solve_flow(
    active: np.ndarray, edges: np.ndarray, *, tolerance: float
) -> tuple[MarkerGrid, np.ndarray, int, bool]:
    """Solve for velocity and pressure in the active voxels: the grid, its vector, the steps, and
    whether they converged.

    Parameters
    ----------
    active : (Z, Y, X) bool
        Voxels that percolate along z, not all of them.
    edges : (3,) float
        In units of the smallest.
    tolerance : float
    """
    flow = MarkerGrid.of(active, edges)
    precondition = SimplePreconditioner(flow)
    kind = np.float32 if tolerance >= _SINGLE else np.float64
    x, residual = precondition.start(kind), np.empty(flow.length, kind)
    force = flow.driving_force()
    limit = tolerance**2 * dot(force, force)
    velocities = slice(0, flow.bounds[3])

    def renew() -> None:
        """Set the residual by its definition: that of the steps has drifted off by round-off."""
        flow.apply(x, residual)
        np.negative(residual, out=residual)
        residual[: len(force)] += force

    def is_small() -> bool:
        return bool(dot(residual[velocities], residual[velocities]) <= limit)

    def accept(x: np.ndarray, residual: np.ndarray) -> bool:
        if not is_small():
            return False
        renew()
        if not is_small():
            return False
        through = flow.section_flows(x)
        # x . residual is the power put in less the power dissipated.
        power = abs(dot(x, residual))
        return imbalance(through) <= tolerance and power <= tolerance * abs(float(through.mean()))

    renew()
    steps, converged = conjugate_residuals(
        flow.multiply, residual, x, precondition, accept=accept, most=_MOST_STEPS, keep=1
    )
    return flow, x, steps, converged
