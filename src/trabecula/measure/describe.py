"""All descriptors of an image at once, as plain values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, check_name
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.core.progress import notify
from trabecula.engine.lazy_volume import Slabs
from trabecula.measure.correlation import lineal_path, two_point, two_point_cluster
from trabecula.measure.curvatures import has_curvatures, shape_index
from trabecula.measure.each_phase import (
    PHASE_CURVES,
    collect_phases,
    drop_redundant,
    redundant_beside_solid,
)
from trabecula.measure.effective_properties import PHYSICS, describe_physics, physics_notes
from trabecula.measure.fabric import anisotropy
from trabecula.measure.grey import autocorrelation, grey_values, histogram, ten_bins
from trabecula.measure.margins import margin_note
from trabecula.measure.morphometry import morphometry
from trabecula.measure.orientation import orientation
from trabecula.measure.percolation import AXES
from trabecula.measure.phases import check_sides, indicator
from trabecula.measure.registry import DESCRIPTORS, LEVELS, measure_one_by_one, select
from trabecula.measure.streaming.numbers import SOLID_NUMBERS, SolidNumbers, fractions_of
from trabecula.measure.thickness import pore_size, thickness

SIZE_KEYS = ("pore_size", "thickness", "morphometry", "anisotropy")
"""What needs distances and directions, in the order of `describe`."""
SOLID_CURVES = ("two_point_cluster", "shape_index")
"""Curves of the solid alone, which need the whole image."""


def describe(
    image: Image | ArrayLike, *, r_max: int = 50, level: str = "default", box: int | None = None
) -> dict[str, Any]:
    """Describe a material by every descriptor, as plain JSON values.

    Where one number is needed, it is that of the solid: every phase but "void". Every phase for
    itself stands under `phases`. Neighbours share a face.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
        A grey or colour image is described by its texture: see `describe_texture`.
    r_max : int
        Largest distance of the curves, in voxels; lowered to half the smallest side.
    level : {"quick", "default", "full"}
        "quick" leaves out what needs distances and directions (thickness, pore size, morphometry,
        anisotropy, the cluster function); "full" adds transport and stiffness, which take minutes.
    box : int, optional
        Edge of the centre box, voxels, that transport and stiffness are solved in. Default: the
        whole image.

    Returns
    -------
    descriptors : dict
        `porosity`, `fractions` (of every phase), `specific_surface`, `euler` (of the image as an
        object), `euler_density` and `mean_curvature` (per volume, without what the faces cut),
        `components`, `floating`, `floating_voxels`, `largest_fraction`, `percolates` and
        `percolating_fraction` (per axis), `chord_length`, `two_point` (per axis and radial, r = 0
        .. r_max voxels), `lineal_path`; from "default" on `pore_size`, `thickness`, `morphometry`
        (by the names of bone histomorphometry), `anisotropy`, `two_point_cluster`,
        `shape_index` (of volumes); in "full" `diffusivity` and `tortuosity` and `permeability` of
        the void, `conductivity` of the solid (each per axis), `stiffness` of the solid (matrix and
        moduli), and `physics`, which says of each whether it converged and what halving the voxel
        changes. Besides `shape`, `spacing`, `unit`, `r_max`, `level`, and `notes` on margins
        without material (`find_margins`), and on what is infinite or has not converged. Lengths are
        in `unit`; the curves run in voxels. `None` where a value does not exist, such as the
        thickness of a phase that fills the image, or was not asked for.

    Raises
    ------
    InputError
        A side of one voxel, r_max below 1, an unknown level.
    MemoryBudgetError
        At level "full", transport or stiffness would take more memory than there is: give a smaller
        `box`.
    """
    image = as_image(image)
    check_name(level, LEVELS, name="level")
    notes = margin_notes(image)
    if image.kind != "labels":
        return describe_texture(image, lags=r_max) | {"notes": notes}
    r_max = int(as_number(r_max, name="r_max", low=1, high=2**62, whole=True))
    check_sides(image.shape, what="has no surface inside")
    r_max = max(1, min(r_max, min(image.shape) // 2))
    if "void" in image.phases:
        found = describe_numbers(image, level=level) | describe_curves(
            image, r_max=r_max, level=level
        )
        full = level == "full"
        found |= describe_physics(image, box=box, halving=True) if full else dict.fromkeys(PHYSICS)
    else:
        counts = np.bincount(image.values.ravel(), minlength=len(image.phases))
        found = outline_without_solid(image, counts, r_max=r_max)
    found |= collect_phases(
        image, level=level, r_max=r_max, known=derive_phase_figures(image.phases, found)
    )
    found["phases"] = drop_redundant(found["phases"], redundant_beside_solid(image.phases))
    return found | {
        "level": level,
        "notes": [*notes, *void_notes(image.phases), *physics_notes(found)],
    }


def derive_phase_figures(
    phases: Sequence[str], found: Mapping[str, Any]
) -> dict[str, dict[str, Any]]:
    """Return the figures of single phases that are among those of `describe` already."""
    if "void" not in phases:
        return {}
    known: dict[str, dict[str, Any]] = {"void": {"thickness": found["pore_size"]}}
    if len(phases) == 2:
        solid = next(name for name in phases if name != "void")
        numbers = {one.name for one in select(each="phase") if not one.curve}
        known[solid] = {name: value for name, value in found.items() if name in numbers}
        known[solid] |= {
            "fraction": found["fractions"][solid],
            "lineal_path": found["lineal_path"],
            "two_point": None,
            "shape_index": None,
        }
    return known


def outline_without_solid(
    image: Image | Slabs, counts: np.ndarray, *, r_max: int
) -> dict[str, Any]:
    """Return the keys of `describe` for an image without a void, so that no phase is known as the
    solid; `counts` are voxels of every phase.
    """
    outline = {"shape": list(image.shape), "spacing": list(image.spacing), "unit": image.unit}
    single = (one.name for one in select(source="", kind="labels"))
    solid = dict.fromkeys(
        (*SOLID_NUMBERS, *SIZE_KEYS, *single, *PHASE_CURVES, *SOLID_CURVES, *PHYSICS)
    )
    return {**outline, "fractions": fractions_of(counts, image.phases), "r_max": r_max, **solid}


def void_notes(phases: Sequence[str]) -> list[str]:
    """Return a note where no phase is named void."""
    if "void" in phases:
        return []
    return [
        f"No phase of {', '.join(phases)} is named void, so it is open what is solid: figures of "
        "pores and of the solid are left out, those of every phase stand under phases. Name one of "
        "the phases void to have both."
    ]


def margin_notes(image: Image) -> list[str]:
    """Report margins without material, where there are any; return the line as well."""
    note = margin_note(image)
    if note is not None:
        notify(note)
    return [] if note is None else [note]


def describe_numbers(image: Image, *, level: str = "default") -> dict[str, Any]:
    """Measure what `describe` reports, less the curves and the physics."""
    image, solid = indicator(image, None)
    numbers = SolidNumbers(image.shape, image.spacing, image.phases)
    numbers.add(image)
    found = {
        "shape": list(image.shape),
        "spacing": list(image.spacing),
        "unit": image.unit,
        **numbers.result(),
    }
    sizes: dict[str, Any] = dict.fromkeys(SIZE_KEYS)
    if DESCRIPTORS["thickness"].is_measured(level):
        sizes |= _sizes(image, solid)
    return found | sizes | measure_one_by_one(image, level=level)


def _sizes(image: Image, solid: np.ndarray) -> dict[str, Any]:
    """Measure what needs distances and directions."""
    both = bool(solid.any() and not solid.all())
    bones = morphometry(image) if image.ndim == 3 else None
    if bones is not None:
        bones["DA"] = anisotropy(image) if both else None
        thick, pore = bones["Tb.Th"], bones["Tb.Sp"]
    else:
        thick = None if solid.all() else thickness(image)
        pore = pore_size(image) if solid.any() else None
    return {
        "pore_size": pore,
        "thickness": thick,
        "morphometry": bones,
        "anisotropy": (bones["DA"] if bones else anisotropy(image)) if both else None,
    }


def describe_curves(image: Image, *, r_max: int, level: str = "default") -> dict[str, Any]:
    """Measure the curves of `describe`, r = 0 .. r_max voxels; r_max has to fit every side."""
    curves = {
        name: two_point(image, r_max=r_max, axis=axis)
        for axis, name in enumerate(AXES[3 - image.ndim :])
    }
    curves["radial"] = two_point(image, r_max=r_max)
    solid: dict[str, Any] = dict.fromkeys(SOLID_CURVES)
    if DESCRIPTORS["two_point_cluster"].is_measured(level):
        solid["two_point_cluster"] = two_point_cluster(image, r_max=r_max).tolist()
    if DESCRIPTORS["shape_index"].is_measured(level) and has_curvatures(image.shape):
        solid["shape_index"] = shape_index(image).tolist()
    single = measure_one_by_one(image, level=level, curve=True, r_max=r_max)
    return {
        "r_max": r_max,
        "two_point": {name: curve.tolist() for name, curve in curves.items()},
        "lineal_path": lineal_path(image, r_max=r_max).tolist(),
        **solid,
        **{
            name: None if curve is None else np.asarray(curve).tolist()
            for name, curve in single.items()
        },
    }


def describe_texture(image: Image | ArrayLike, *, lags: int = 32) -> dict[str, Any]:
    """Describe grey values or colours as they are, as `describe` does where there are no labels.

    Parameters
    ----------
    image : Image of grey or colour, (Z, Y, X) or (Y, X)
    lags : int
        Largest lag of the autocorrelation along every axis, voxels; lowered to the smallest side
        less one.

    Returns
    -------
    descriptors : dict
        `mean` and `standard_deviation` (of a colour's luminance), `histogram` (256 bins; of a
        colour one a channel), `ten_bins` (None where values are not bytes), `autocorrelation` (per
        axis, lag 0 first), `orientation` (the histogram of local orientations); and `shape`,
        `spacing`, `unit`, `level`.

    Raises
    ------
    InputError
        Labels, lags below 1, or a side of one voxel.
    """
    image = as_image(image)
    if image.kind == "labels":
        raise InputError("the image is labels, which have no texture of grey levels: use describe")
    values = grey_values(image)
    bytes_only = image.values.dtype == np.uint8
    return {
        "shape": list(image.shape),
        "spacing": list(image.spacing),
        "unit": image.unit,
        "mean": float(values.mean(dtype=np.float64)),
        "standard_deviation": float(values.std(dtype=np.float64)),
        "histogram": histogram(image).tolist(),
        "ten_bins": ten_bins(image).tolist() if bytes_only else None,
        "autocorrelation": {
            name: line.tolist() for name, line in autocorrelation_lines(image, lags=lags).items()
        },
        "orientation": orientation(image).shares.tolist(),
        **measure_one_by_one(image, level="full"),
        "level": "texture",
    }


def autocorrelation_lines(image: Image, *, lags: int) -> dict[str, np.ndarray]:
    """Return the autocorrelation along every axis by its name, lag 0 first."""
    most = int(as_number(lags, name="lags", low=0, high=2**31, whole=True))
    whole = autocorrelation(image, lags=max(1, min(most, min(image.shape) - 1)))
    centre = tuple(side // 2 for side in whole.shape)
    return {
        name: np.moveaxis(whole, axis, -1)[
            (*(c for a, c in enumerate(centre) if a != axis), slice(centre[axis], None))
        ]
        for axis, name in enumerate(AXES[3 - image.ndim :])
    }
