"""Effective diffusivity and conductivity: Laplace's equation on the voxels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import check_name, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, check_labels
from trabecula.measure.phases import members
from trabecula.measure.transport.conduction_segments import ConductionSegments
from trabecula.measure.transport.conduction_system import ConductionSystem
from trabecula.measure.transport.result import Effective, imbalance, not_percolating
from trabecula.measure.transport.section import (
    Solver,
    as_tolerance,
    carrying_voxels,
    effective,
    percolating_voxels,
)
from trabecula.numerics.krylov import Iterate, conjugate_gradients
from trabecula.numerics.vectors import dot

_MOST_STEPS = 300
_SINGLE = 1e-6  # tolerance from which on residual and directions are float32
_MOST_CONTRAST = 1e12

CONDUCTION_BYTES = 72
"""Memory per voxel that conducts, at the peak: resident memory, from 80 to 240 voxels an edge and
of one thread or two; 13 to 34 where structures are some voxels wide, 36 to 81 in white noise."""


def diffusivity(
    image: Image | ArrayLike,
    *,
    axis: int,
    phase: str | int | None = None,
    tolerance: float = 1e-5,
    box: int | Sequence[int] | None = None,
    halving: bool = False,
) -> Effective:
    """Measure the effective diffusivity of a phase along one axis, relative to that of the bulk:
    D_eff / D_0, 0..1.

    Steady diffusion through the phase from one end face of the image (concentration 1) to the other
    (0), nothing through the sides and the other phases: flux times length over area and difference.
    Finite volumes of one voxel, seven points (five in 2-D), the end faces half a voxel from the
    centres. Voxels are neighbours where they share a face; only components that touch both end
    faces are solved. The same as for the periodic medium that mirrors of the image build (Cooper et
    al. 2016, doi:10.1016/j.softx.2016.09.002, section 2).

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
        With any spacing; scaling it changes nothing.
    axis : int
        0 is z (y in 2-D); negative counts from the back.
    phase : str or int, optional
        Default: "void".
    tolerance : float, 1e-10 .. 0.1
        Of the imbalance of the flux between sections, of the power, and of the residual.
    box : int or one per axis, optional
        Solve a centred box of this edge in voxels (or as much of it as there is). Default: the
        whole image.
    halving : bool
        Also estimate the error of discretisation: on a centre box of at most 48 voxels an edge, the
        value with every voxel split into 2x2x2 (2x2) over the value without, minus 1. Stairs stay
        stairs, so this shows whether the equation is resolved, not whether the image is.

    Returns
    -------
    effective : Effective
        `value` is D_eff / D_0, 0.0 where the phase does not percolate.

    Raises
    ------
    InputError
        No such axis or phase, a tolerance or box out of range, an image too large to solve at once.
    MemoryBudgetError
        More memory would be needed than there is, some 70 bytes a voxel of the phase: give a
        smaller `box`.

    Examples
    --------
    A straight duct has its share of the area.

    >>> duct = np.ones((6, 4, 4), np.uint8)
    >>> duct[:, 1:3, 1:3] = 0
    >>> round(diffusivity(duct, axis=0).value, 6), diffusivity(duct, axis=1).value
    (0.25, 0.0)
    """
    image = as_image(image)
    sigma = members(image, phase, default="void").astype(np.float64)
    solver = _solver(sigma, tolerance)
    return effective(image, image.values, solver, axis=axis, box=box, halving=halving)


def tortuosity(
    image: Image | ArrayLike,
    *,
    axis: int,
    phase: str | int | None = None,
    tolerance: float = 1e-5,
    box: int | Sequence[int] | None = None,
    halving: bool = False,
) -> Effective:
    """Measure the tortuosity factor of a phase along one axis: its volume fraction over D_eff /
    D_0, 1 or more.

    Cooper et al. 2016, doi:10.1016/j.softx.2016.09.002, equation 1. All of the phase counts, also
    what does not percolate.

    Parameters
    ----------
    image, axis, phase, tolerance, box, halving
        As of `diffusivity`.

    Returns
    -------
    effective : Effective
        `value` is infinite where the phase does not percolate along the axis; `halving` is of the
        tortuosity.

    Raises
    ------
    InputError, MemoryBudgetError
        As `diffusivity`.

    Examples
    --------
    >>> tortuosity(np.array([[0, 1], [0, 1]]), axis=1).value
    inf
    """
    found = diffusivity(
        image, axis=axis, phase=phase, tolerance=tolerance, box=box, halving=halving
    )
    value = found.fraction / found.value if found.value > 0.0 else math.inf
    change = None if found.halving is None else 1.0 / (1.0 + found.halving) - 1.0
    return replace(found, value=value, halving=change)


def conductivity(
    image: Image | ArrayLike,
    *,
    conductivities: Mapping[str, float],
    axis: int,
    tolerance: float = 1e-5,
    box: int | Sequence[int] | None = None,
    halving: bool = False,
) -> Effective:
    """Measure the effective conductivity (thermal, electric, ...) along one axis when every phase
    conducts.

    As `diffusivity`, with the harmonic mean of both voxels at a face, which is exact for layers
    (Patankar 1980, doi:10.1201/9781482234213, section 4.2-3). Phases of conductivity 0 insulate.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    conductivities : mapping
        Phase name -> conductivity, 0 or more, for every phase that occurs. Contrasts beyond a
        million may not converge (the result says so), beyond 1e12 they are refused.
    axis, tolerance, box, halving
        As of `diffusivity`.

    Returns
    -------
    effective : Effective
        `value` in the unit of `conductivities`; 0.0 where no path of conducting voxels joins the
        end faces.

    Raises
    ------
    InputError
        A phase that is missing or does not exist, a conductivity that is negative or not finite;
        and as `diffusivity`.
    MemoryBudgetError
        As `diffusivity`.

    Examples
    --------
    >>> layers = np.array([[0, 0], [1, 1]])
    >>> both = {"void": 1.0, "solid": 3.0}
    >>> [round(conductivity(layers, conductivities=both, axis=axis).value, 6) for axis in (0, 1)]
    [1.5, 2.0]
    """
    image = as_image(image)
    check_labels(image)
    sigma = _as_conductivities(image, conductivities)
    largest = float(sigma.max(initial=0.0)) or 1.0
    solver = _solver(sigma / largest, tolerance)
    found = effective(image, image.values, solver, axis=axis, box=box, halving=halving)
    return replace(found, value=found.value * largest)


def _solver(sigma: np.ndarray, tolerance: float) -> Solver:
    solve = partial(_conduct, sigma=sigma, tolerance=as_tolerance(tolerance))
    return Solver(solve, sigma > 0.0, CONDUCTION_BYTES)


def _as_conductivities(image: Image, conductivities: Mapping[str, float]) -> np.ndarray:
    """Return one conductivity a label."""
    if not isinstance(conductivities, Mapping):
        raise InputError(
            f"conductivities is {quote(conductivities)}: give a mapping from the name of every "
            "phase "
            "to a number"
        )
    sigma = np.zeros(len(image.phases))
    for name, value in conductivities.items():
        check_name(name, image.phases, name="phase")
        if (
            not isinstance(value, (int, float, np.integer, np.floating))
            or not 0.0 <= value < math.inf
        ):
            raise InputError(
                f"the conductivity of {name} is {quote(value)}: give a finite number, 0 or more"
            )
        sigma[image.phases.index(name)] = value
    found = np.bincount(image.values.ravel(), minlength=len(image.phases))
    missing = [
        n for n, count in zip(image.phases, found, strict=True) if count and n not in conductivities
    ]
    if missing:
        raise InputError(
            f"no conductivity is given for {', '.join(missing)}: give one for every phase, 0 to "
            "insulate"
        )
    conducting = sigma[sigma > 0.0]
    if len(conducting) and conducting.max() > _MOST_CONTRAST * conducting.min():
        raise InputError(
            f"the conductivities differ by more than {_MOST_CONTRAST:g} times, which float64 "
            "cannot resolve: give 0 for "
            "phases that insulate"
        )
    return sigma


def _conduct(
    labels: np.ndarray, edges: np.ndarray, *, sigma: np.ndarray, tolerance: float
) -> Effective:
    """Solve for the conduction along the first axis; sigma of every label, at most 1."""
    # Scaled by the smallest edge, so that couplings stay near 1 in any unit.
    pull = (edges.min() / edges) ** 2
    part, fraction = _find_segments(np.ascontiguousarray(labels), sigma, pull)
    if part is None:
        return not_percolating(fraction)
    kind = np.float32 if tolerance >= _SINGLE else np.float64
    system = ConductionSystem(part, kind)
    residual = part.driving_flux(kind)
    limit = tolerance**2 * dot(residual, residual)

    def accept(at: Iterate) -> bool:
        if dot(at.residual, at.residual) > limit:
            return False
        flow = system.flow
        lost = abs(system.power_lost(at))
        return imbalance(flow) <= tolerance and lost <= tolerance * abs(float(flow.mean()))

    none = np.zeros(0)  # the system keeps no solution
    last, converged = conjugate_gradients(
        system, none, residual, accept=accept, most=_MOST_STEPS, flexible=True
    )
    flow = system.flow
    depth, height, width = labels.shape
    value = float(flow.mean()) * depth / (height * width) / float(pull[0])
    return Effective(value, converged, imbalance(flow), last.steps, fraction)


def _find_segments(
    labels: np.ndarray, sigma: np.ndarray, pull: np.ndarray
) -> tuple[ConductionSegments | None, float]:
    """Return the segments of what percolates, with the harmonic mean at every face, None where
    nothing does; and the share of voxels that conduct.
    """
    inside = carrying_voxels(labels, sigma > 0.0)
    fraction = int(np.count_nonzero(inside)) / inside.size
    active = percolating_voxels(inside)
    if active is None:
        return None, fraction
    del inside
    some, kinds = np.unique(np.append(0.0, sigma), return_inverse=True)
    sums = some[:, None] + some
    mean = np.divide(2.0 * some[:, None] * some, sums, out=np.zeros_like(sums), where=sums > 0.0)
    face, end = mean[:, :, None] * pull, 2.0 * some * pull[0]
    given = labels, active, kinds[1:].astype(np.int64)
    return ConductionSegments.of(*given, face, end), fraction
