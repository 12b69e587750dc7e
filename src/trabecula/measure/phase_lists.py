"""Figures of every phase by flat names, for a list of figures such as the certificate's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.image import Image
from trabecula.measure.each_phase import (
    SAME_FOR_TWO,
    as_labels,
    measure_curves,
    measure_numbers,
    redundant_phases,
)
from trabecula.measure.registry import DESCRIPTORS, select

VOID_REPORTED = ("specific_surface", "mean_curvature", "thickness", "two_point", "shape_index")
"""What is reported of the void already where the solid phases are taken together: their interface,
S2, and `pore_size`.
"""
DERIVED_FROM_OTHER = ("fraction", "mean_curvature", "chord_length", *SAME_FOR_TWO)
"""Of two phases, what follows from the figures of the other."""


def phase_numbers(image: Image | ArrayLike, *, level: str = "default") -> dict[str, Any]:
    """Return the numbers of every phase, pair and triple by flat names, to stand beside those of
    `describe`.

    Nothing comes twice. Where a phase is named void, `describe` reports its interface, curvature
    and thickness (`pore_size`) already. Of two phases, one of them void, only what the void has for
    itself is left: components, percolation and Euler number.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    level : {"quick", "default", "full"}
        "quick" leaves out thickness.

    Returns
    -------
    numbers : dict
        `NAME_PHASE` for `fraction`, `specific_surface`, `mean_curvature`, `euler_density`,
        `components`, `floating`, `floating_voxels`, `largest_fraction`, `percolates` (a dict, per
        axis), `percolating_fraction` (mean over the axes), `chord_length`, `thickness`;
        `contact_PHASE_PHASE`; `triple_line_density` and `triple_line_active`, with more than three
        phases `..._PHASE_PHASE_PHASE` of each three. `None` as in `describe_phases`.

    Raises
    ------
    InputError
        As `describe_phases`.
    """
    image = as_labels(image, level)
    redundant = _redundant_figures(image.phases)
    known = {name: dict.fromkeys(keys) for name, keys in redundant.items()}
    found = measure_numbers(image, level=level, known=known)
    numbers: dict[str, Any] = {}
    for phase, figures in found.phases.items():
        own = {
            name: value
            for name, value in figures.items()
            if name not in redundant.get(phase, ()) and DESCRIPTORS[name].is_measured(level)
        }
        if "percolating_fraction" in own:
            own["percolating_fraction"] = float(np.mean(list(own["percolating_fraction"].values())))
        numbers |= {f"{name}_{phase}": value for name, value in own.items()}
    numbers |= {f"contact_{'_'.join(pair)}": area for pair, area in found.contacts.items()}
    for triple, line in found.lines.items():
        suffix = "" if len(found.lines) == 1 else "_" + "_".join(triple)
        numbers |= {
            f"triple_line_density{suffix}": line.density,
            f"triple_line_active{suffix}": line.active,
        }
    return numbers


def phase_curves(
    image: Image | ArrayLike, *, r_max: int, cross: bool = True
) -> dict[str, np.ndarray]:
    """Return the curves of every phase and pair by flat names, r = 0 .. r_max voxels, to stand
    beside those of `describe`.

    Nothing comes twice: S2 of a phase named void, or of one of two phases, follows from that of the
    others together.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    r_max : int
        Largest distance, below every side.
    cross : bool
        Include cross-correlations, which take longer than all else. That of the two solid phases
        of three is half of what S2 of both together is above the sum of theirs.

    Returns
    -------
    curves : dict
        `two_point_PHASE` (radial), `two_point_PHASE_AXIS` (z, y, x), `lineal_path_PHASE`,
        `shape_index_PHASE` (of volumes), and with three phases or more `cross_PHASE_PHASE`
        (radial).

    Raises
    ------
    InputError
        As `two_point` and `lineal_path`.
    """
    image = as_labels(image, "quick")
    redundant = _redundant_figures(image.phases)
    known = {name: dict.fromkeys(keys) for name, keys in redundant.items()}
    found = measure_curves(image, level="default", r_max=r_max, known=known, cross=cross)
    curves: dict[str, np.ndarray] = {}
    for phase, figures in found.phases.items():
        for along, curve in (figures["two_point"] or {}).items():
            curves[f"two_point_{phase}" + ("" if along == "radial" else f"_{along}")] = np.array(
                curve
            )
        for name in ("lineal_path", "shape_index"):
            if figures[name] is not None:
                curves[f"{name}_{phase}"] = np.array(figures[name])
    return curves | {f"cross_{'_'.join(pair)}": curve for pair, curve in found.pairs.items()}


def _redundant_figures(phases: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the figures of each phase that follow from those of the other, or of the solid phases
    together.
    """
    if len(phases) != 2:
        return {"void": VOID_REPORTED} if "void" in phases else {}
    first = redundant_phases(phases, None)[0]
    if first != "void":
        return {first: DERIVED_FROM_OTHER}
    solid = next(name for name in phases if name != "void")
    every = tuple(one.name for one in select(each="phase"))
    return {"void": (*DERIVED_FROM_OTHER, "thickness"), solid: every}
