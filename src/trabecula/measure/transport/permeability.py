"""Permeability: slow viscous flow through the void."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image
from trabecula.measure.phases import as_inside, indicator
from trabecula.measure.transport.result import Effective, imbalance, not_percolating
from trabecula.measure.transport.section import Solver, checked_tolerance, effective, percolating
from trabecula.measure.transport.stokes import flow_through

FLOW_BYTES = 880
"""Memory per voxel that carries flow, at the peak: resident memory, from 40 and 64 voxels an edge.
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
    """Permeability k of a phase along one axis, in unit^2 (voxel^2 without a unit): Darcy's law, q
    = -k grad(p) / viscosity.

    Stokes flow through the phase from one end face of the image to the other by a difference of
    pressure: no slip at the other phases, mirrors at the side faces (no flow across them, no drag
    either), constant pressure and no tangential velocity on the end faces. That is the flow through
    the periodic medium that mirrors of the image build. Finite differences on a marker-and-cell
    grid with the voxels' spacing (Manwart et al. 2002, doi:10.1103/PhysRevE.66.016702, section III;
    Harlow and Welch 1965, doi:10.1063/1.1761178), solved for velocity and pressure at once. Voxels
    are neighbours where they share a face; only components that touch both end faces are solved.

    Narrow pores are resolved badly by any method on voxels. Here a slit of n voxels comes out too
    permeable by the factor 1 + 2 / n^2 exactly, a square duct by 1 + 4 / n^2 about (4 voxels: 22
    %); simple cubic spheres within 2 % at a radius of 10 voxels, within 8 % at 5. Memory: about 900
    bytes a voxel of the phase, checked before anything is solved. Edges that differ by a hundred
    times may not converge (the result says so).

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
    solve = partial(_flow, tolerance=checked_tolerance(tolerance))
    solver = Solver(solve, np.array([False, True]), FLOW_BYTES)
    return effective(
        image, as_inside(inside).reshape(image.shape), solver, axis=axis, box=box, halving=halving
    )


def _flow(inside: np.ndarray, edges: np.ndarray, *, tolerance: float) -> Effective:
    """Permeability along the first axis."""
    fraction = int(np.count_nonzero(inside)) / inside.size
    active = percolating(inside)
    if active is None:
        return not_percolating(fraction)
    if active.all():  # mirrors alone hold no fluid
        return Effective(math.inf, True, 0.0, 0, fraction)
    # In units of the smallest edge, so that couplings stay near 1 in any unit.
    least = float(edges.min())
    sides = edges / least
    flow, steps, converged = flow_through(active, sides, tolerance=tolerance)
    depth, height, width = inside.shape
    length, area = depth * sides[0], height * width * sides[1] * sides[2]
    value = float(flow.mean() * length / area) * least**2
    return Effective(value, converged, imbalance(flow), steps, fraction)
