"""Where the stress goes in a part under its loads: the principal directions of every element."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.fields.grid import as_marks, part_region
from trabecula.fields.topology.cases import Case, case, part_nodes
from trabecula.fields.topology.displacements import solve_displacements
from trabecula.fields.topology.elements import ElementGrid
from trabecula.measure.mechanics.elements import CORNERS, isotropic, mean_strain

_BALANCE, _STEPS = 1e-4, 1000  # residual of the displacements, and their steps at most


@dataclass(frozen=True, eq=False)
class PrincipalStress:
    """The principal stress of largest magnitude in every element of a part."""

    direction: np.ndarray
    """(Z, Y, X, 3) float32: unit vectors z, y, x, the first component that is not 0 positive; 0
    where there is no element."""
    stress: np.ndarray
    """(Z, Y, X) float32: its size, above 0 where it pulls, in the unit of the forces over that of
    the element's area, for elements of Young's modulus 1."""
    compliance: tuple[float, ...]
    """Work of the loads, of each load case."""
    strain: np.ndarray
    """(Z, Y, X) float32: the effective strain sqrt(2 U / E) of the strain energy density U (Pistoia
    2002, doi:10.1016/S8756-3282(02)00736-6), the largest of all load cases."""


def principal_stress(
    density: Image | ArrayLike,
    of: str | Path | Mapping[str, Any] | Case,
    *,
    mask: Image | ArrayLike | None = None,
    marks: Mapping[str, ArrayLike] | None = None,
    penalty: float | None = None,
    poisson: float = 0.3,
) -> PrincipalStress:
    """Find the direction in which every element of a part is pulled or pressed most.

    Material laid along it carries the loads by tension and compression (Wolff's law). Of several
    load cases an element has the direction of that which stresses it most.

    Parameters
    ----------
    density : Image or array, (Z, Y, X)
        As `simp` returns it, with the spacing of the elements: 0 .. 1, less than 0.001 counts as
        that.
    of, mask, marks, penalty, poisson
        As of `simp`.

    Returns
    -------
    found : PrincipalStress

    Raises
    ------
    InputError
        As `simp`; densities out of range.

    Examples
    --------
    >>> bar = {"shape": (2, 2, 8), "supports": [{"box": [(0, 1), (0, 1), (0, 0)]}],
    ...        "loads": [{"box": [(0, 1), (0, 1), (1, 1)], "force": (0, 0, 1)}]}
    >>> found = principal_stress(np.full((2, 2, 8), 0.5), bar)
    >>> found.direction[1, 1, 4].round(3).tolist(), bool(found.stress[1, 1, 4] > 0)
    ([0.0, 0.0, 1.0], True)
    """
    chosen = case(of)
    image = (
        density if isinstance(density, Image) else Image(np.asarray(density, np.float32), "grey")
    )
    values = np.asarray(image.values, np.float64)
    if values.ndim != 3:
        raise InputError(f"the density has shape {values.shape}: give a volume (Z, Y, X)")
    exponent = chosen.penalty if penalty is None else penalty
    exponent = as_number(exponent, name="penalty", low=1.0, high=5.0)
    ratio = as_number(poisson, name="poisson", low=-0.9, high=0.45)
    if not (values.min() >= 0 and values.max() <= 1):
        raise InputError(
            f"the density runs from {values.min():.4g} to {values.max():.4g}: give shares 0 .. 1"
        )
    sides = values.shape
    inside = part_region(mask, sides)
    part = part_nodes(chosen, inside, image.spacing, as_marks(marks, sides))
    grid = ElementGrid.of(chosen, part, edges=part.edges, poisson=ratio)
    stiff = np.where(part.inside, np.maximum(values, 1e-3) ** exponent, 0.0)
    return stress_of(grid, grid.loaded(chosen, part), stiff, isotropic(1.0, ratio), part.edges)


def stress_of(
    grid: ElementGrid,
    loaded: Sequence[tuple[float, ElementGrid]],
    stiff: np.ndarray,
    material: np.ndarray,
    edges: tuple[float, ...],
) -> PrincipalStress:
    """Return the principal stress of elements of given stiffness, over all load cases."""
    direction = np.zeros((*stiff.shape, 3), np.float32)
    stress = np.zeros(stiff.shape, np.float32)
    strain = np.zeros(stiff.shape, np.float32)
    compliance = []
    to_strain = mean_strain(edges)
    for _, one in loaded:
        start = np.zeros_like(grid.load)
        u = solve_displacements(one, stiff, start, tolerance=_BALANCE, most=_STEPS)
        compliance.append(float((stiff * one.energy(u)).sum()))
        for z in range(len(stiff)):
            ways, size, effective = _principal(to_strain, material, u[z : z + 2], stiff[z])
            larger = np.abs(size) > np.abs(stress[z])
            stress[z] = np.where(larger, size, stress[z])
            direction[z] = np.where(larger[..., None], ways, direction[z])
            strain[z] = np.maximum(strain[z], effective)
    return PrincipalStress(direction, stress, tuple(compliance), strain)


def _principal(
    to_strain: np.ndarray, material: np.ndarray, u: np.ndarray, stiff: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return direction (Y, X, 3) and size (Y, X) of the largest principal stress of a layer of
    elements, and their effective strain, from the displacements of its two layers of nodes.
    """
    height, width = stiff.shape
    strain = np.zeros((height, width, 6))
    for corner, part in zip(CORNERS, to_strain.transpose(1, 0, 2), strict=True):
        z, y, x = corner
        strain += u[z, y : y + height, x : x + width] @ part.T
    bulk = strain @ material
    effective = np.sqrt(np.maximum((strain * bulk).sum(axis=-1), 0)) * (stiff > 0)
    voigt = stiff[..., None] * bulk
    tensor = np.zeros((height, width, 3, 3))
    for axis in range(3):  # Voigt's order is xx, yy, zz
        tensor[..., axis, axis] = voigt[..., 2 - axis]
    for (i, j), shear in zip(((0, 1), (0, 2), (1, 2)), (3, 4, 5), strict=True):
        tensor[..., i, j] = tensor[..., j, i] = voigt[..., shear]
    values, vectors = np.linalg.eigh(tensor)
    most = np.abs(values).argmax(axis=-1)
    size = np.take_along_axis(values, most[..., None], axis=-1)[..., 0]
    found = np.take_along_axis(vectors, most[..., None, None], axis=-1)[..., 0]
    lead = np.take_along_axis(found, (np.abs(found) > 1e-6).argmax(axis=-1)[..., None], axis=-1)
    return np.where(lead < 0, -found, found) * (stiff > 0)[..., None], size, effective
