"""A finished part under its loads, voxel by voxel."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.recipe import digest
from trabecula.engine.memory import Plan, check_budget
from trabecula.fields.grid import as_field, part_region
from trabecula.fields.topology.cases import Case, case, part_nodes, to_json
from trabecula.fields.topology.elements import ElementGrid
from trabecula.fields.topology.optimise import ELEMENT_BYTES
from trabecula.fields.topology.places import PartNodes, at_corners, elements_at
from trabecula.fields.topology.stress import stress_of
from trabecula.measure.labelling import label_components
from trabecula.measure.mechanics.elements import isotropic
from trabecula.measure.phases import indicator

_WEAKEST = 10  # places that the report lists


def part_stress(
    image: Image | ArrayLike,
    of: str | Path | Mapping[str, Any] | Case,
    *,
    phase: str | int | None = None,
    mask: Image | ArrayLike | None = None,
    poisson: float = 0.3,
    memory: int | None = None,
) -> Image:
    """Compute the stress in a finished part under its loads: every voxel of it is an element.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
    of : str, path, mapping or Case
        As of `simp`; its places are those of the form. Painted meshes are not known here.
    phase : str or int, optional
        What carries. Default: "solid", which is every phase but "void".
    mask : (Z, Y, X) bool array or Image of labels, optional
        The form that the material fills, whose surface the case's normals mean. Default: the whole
        grid.
    poisson : float
        Ratio of the solid, -0.9 .. 0.45.
    memory : int, optional
        Budget in bytes. Default: what the machine has available.

    Returns
    -------
    field : Image
        Grey, float32: size of the largest principal stress of every voxel (of all load cases), for
        a solid of Young's modulus 1 and forces as the case gives them, over the area of a voxel's
        face; 0 in the void. Its recipe's step holds a `report`: `compliance` of every load case;
        `solid_compliance`, of the form filled with solid; `largest`, and the stress that 99 % of
        the voxels stay below; `largest strain` and `99 % strain`, the same of the effective strain
        sqrt(2 U / E); `weakest`, the places (z, y, x) of the most stressed voxels, ten at
        most, no two nearer than four; `fraction`, the solid's share of the
        form; `loose`, the share of the solid that no support holds, which
        is left out.

    Raises
    ------
    InputError
        Supports and loads that meet no solid, or different pieces of it.
    MemoryBudgetError
        More voxels than the memory has room for.

    Notes
    -----
    Bricks of one voxel are too stiff in bending where struts are one or two voxels thick, and
    stress at steps of the surface is not resolved: compare parts of the same resolution.
    """
    chosen = case(of)
    image, solid = indicator(image, phase)
    if image.ndim != 3:
        raise InputError("the part is 2-D: give a volume")
    ratio = as_number(poisson, name="poisson", low=-0.9, high=0.45)
    check_budget(
        Plan({"elements": ELEMENT_BYTES * solid.size}),
        budget=memory,
        advice="coarsen the part first",
    )
    form = part_region(mask, image.shape)
    filled = part_nodes(chosen, form, image.spacing)
    edges = filled.edges
    material = isotropic(1.0, ratio)
    whole = ElementGrid.of(chosen, filled, edges=edges, poisson=ratio)
    bulk = stress_of(
        whole, whole.loaded(chosen, filled), filled.inside.astype(float), material, edges
    )
    held = _held(chosen, PartNodes(solid & filled.inside, None, edges, form))
    part = PartNodes(held, None, edges, form)
    grid = ElementGrid.of(chosen, part, edges=edges, poisson=ratio)
    found = stress_of(grid, grid.loaded(chosen, part), held.astype(float), material, edges)
    size = np.abs(found.stress)
    report = {
        "compliance": list(found.compliance),
        "solid_compliance": list(bulk.compliance),
        "largest": float(size.max()),
        "99 %": float(np.quantile(size[held], 0.99)),
        "largest strain": float(found.strain.max()),
        "99 % strain": float(np.quantile(found.strain[held], 0.99)),
        "weakest": _weakest(size),
        "fraction": float(np.count_nonzero(solid & form) / np.count_nonzero(form)),
        "loose": 1 - np.count_nonzero(held) / max(1, np.count_nonzero(solid)),
    }
    settings: dict[str, Any] = {"of": to_json(chosen), "phase": phase, "poisson": ratio}
    if mask is not None:
        made = mask.recipe.to_json() if isinstance(mask, Image) else []
        settings["mask"] = made or digest(form.view(np.uint8))
    return as_field(
        size,
        "part_stress",
        settings,
        spacing=image.spacing,
        unit=image.unit,
        before=image.recipe,
        report=report,
    )


def _held(of: Case, part: PartNodes) -> np.ndarray:
    """Return the elements of the pieces that a support holds."""
    labels, _ = label_components(part.inside)
    touched = np.zeros(part.inside.shape, bool)
    for support in of.supports:
        touched |= elements_at(part.pick(support.box, support.place))
    numbers = np.unique(labels[touched & part.inside])
    held = np.isin(labels, numbers[numbers > 0])
    if not held.any():
        raise InputError(
            f"the supports of case {of.name!r} meet no solid: move them to where the part is, or "
            "widen their places"
        )
    for load in (load for one in of.alone for load in one.loads):
        pushed = part.pick(load.box, load.place)
        if not (pushed & at_corners(held)).any():
            raise InputError(
                f"the load at {load.box} meets no solid that is held: connect the part "
                "(trabecula finish --connect), or widen the load's place"
            )
    return held


def _weakest(size: np.ndarray) -> list[list[int]]:
    """Return the places of the most stressed voxels, no two nearer than four along every axis."""
    left = size.copy()
    found: list[list[int]] = []
    while len(found) < _WEAKEST and left.max() > 0:
        at = np.unravel_index(int(left.argmax()), size.shape)
        found.append([int(k) for k in at])
        left[tuple(slice(max(0, k - 4), k + 5) for k in at)] = 0
    return found
