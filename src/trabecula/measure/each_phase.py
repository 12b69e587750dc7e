"""Single phases, pairs of phases, and the lines where three meet.

What is the same for two phases is reported once: with two phases the interface and S2 (its
covariance) of the one are those of the other, so they stand with the solid (the last phase, where
none is named void), and there are neither pairs nor triples. Components, percolation, lineal path,
chords and thickness differ, and are reported of both. The components of a phase are found once, for
its own figures and for the active share of the triple-phase lines.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, check_name
from trabecula.core.image import Image, as_image, check_labels, phase_index
from trabecula.measure.configurations import count_cubes
from trabecula.measure.contacts import contact_area
from trabecula.measure.correlation import cross_correlation, lineal_path, two_point
from trabecula.measure.curvatures import has_curvatures, shape_index
from trabecula.measure.minkowski import densities
from trabecula.measure.percolation import AXES
from trabecula.measure.phases import as_inside, check_sides
from trabecula.measure.registry import (
    CURVES,
    DESCRIPTORS,
    LEVELS,
    measure_one_by_one,
    select,
)
from trabecula.measure.streaming import CrossingTally, phase_figures
from trabecula.measure.thickness import thickness
from trabecula.measure.triple_lines import TripleLine, lines_of, mark_components

SAME_FOR_TWO = ("specific_surface", "two_point", "shape_index")
"""What two phases have in common."""
PHASE_CURVES = tuple(one.name for one in select(each="phase", source=CURVES))

Known = Mapping[str, Mapping[str, Any]]
"""Figures by phase that have been measured already, or are not wanted."""


@dataclass(frozen=True)
class PhaseFigures:
    """Numbers of phases by name, contact areas of pairs, lines of triples."""

    phases: dict[str, dict[str, Any]]
    contacts: dict[tuple[str, str], float]
    lines: dict[tuple[str, str, str], TripleLine]


@dataclass(frozen=True)
class PhaseCurves:
    """Curves of phases by name, cross-correlations of pairs."""

    phases: dict[str, dict[str, Any]]
    pairs: dict[tuple[str, str], np.ndarray]


def describe_phases(
    image: Image | ArrayLike,
    *,
    level: str = "default",
    r_max: int = 50,
    phase: str | int | None = None,
) -> dict[str, Any]:
    """Describe every phase for itself, every pair of phases, and the triple-phase lines, as plain
    JSON values.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
        Of any number of phases; none has to be named void.
    level : {"quick", "default", "full"}
        "quick" leaves out thickness and the shape index; "full" adds nothing here.
    r_max : int
        Largest distance of the curves, in voxels; lowered to half the smallest side.
    phase : str or int, optional
        Only this phase, with its pairs and no triples. Default: all.

    Returns
    -------
    described : dict
        `phases`: name -> `fraction`, `specific_surface`, `euler_density`, `mean_curvature`,
        `components`, `floating`, `floating_voxels`, `largest_fraction`, `percolates` and
        `percolating_fraction` (per axis), `chord_length`, `thickness`, `two_point` (per axis and
        radial, r = 0 .. r_max voxels), `lineal_path`, `shape_index` (of volumes, not at "quick");
        neighbours share a face. `pairs`: "name-name" -> `contact` (area per volume, see `contacts`)
        and `cross_correlation` (radial). `triples`: "name-name-name" -> `line_density` and
        `active_share` (see `triple_phase_lines`). Names run in the order of the labels; lengths are
        in the image's unit. `None` where a value does not exist, such as the thickness of a phase
        that is empty or fills the image, or was left out. With two phases `pairs` and `triples` are
        empty, and `specific_surface`, `two_point` and `shape_index` are reported of one phase only
        (of the other they are the same, the shape index with the other sign): the solid, or the
        last one where none is named void.

    Raises
    ------
    InputError
        Not labels, a side of one voxel, r_max below 1, an unknown level, or no such phase.
    """
    image = as_labels(image, level)
    r_max = int(as_number(r_max, name="r_max", low=1, high=2**62, whole=True))
    only = None if phase is None else image.phases[phase_index(image, phase, default="")]
    return collect_phases(
        image, level=level, r_max=max(1, min(r_max, min(image.shape) // 2)), only=only
    )


def collect_phases(
    image: Image, *, level: str, r_max: int, known: Known | None = None, only: str | None = None
) -> dict[str, Any]:
    """Describe as `describe_phases` does, taking figures that are `known`; r_max has to fit every
    side.
    """
    known = known or {}
    numbers = measure_numbers(image, level=level, known=known, only=only)
    curves = measure_curves(image, level=level, r_max=r_max, known=known, only=only)
    phases = {name: numbers.phases[name] | curves.phases[name] for name in numbers.phases}
    return {
        "phases": drop_redundant(phases, redundant_phases(image.phases, only)),
        "pairs": {
            "-".join(pair): {"contact": area, "cross_correlation": curves.pairs[pair].tolist()}
            for pair, area in numbers.contacts.items()
        },
        "triples": {
            "-".join(triple): {"line_density": line.density, "active_share": line.active}
            for triple, line in numbers.lines.items()
        },
    }


def drop_redundant(
    phases: Mapping[str, Mapping[str, Any]], repeating: Container[str]
) -> dict[str, dict[str, Any]]:
    """Return the figures of phases, without those that two phases have in common where the phase
    repeats the other's.
    """
    return {
        name: {
            key: value
            for key, value in figures.items()
            if name not in repeating or key not in SAME_FOR_TWO
        }
        for name, figures in phases.items()
    }


def redundant_beside_solid(image_phases: Sequence[str]) -> Sequence[str]:
    """Return the phases that repeat another's figures in `describe`, which reports the solid's: of
    two, both.
    """
    with_void = len(image_phases) == 2 and "void" in image_phases
    return image_phases if with_void else redundant_phases(image_phases, None)


def as_labels(image: Image | ArrayLike, level: str) -> Image:
    """Return an image of labels that has an interior; raise where it is none, or the level is
    unknown.
    """
    image = as_image(image)
    check_labels(image)
    check_name(level, LEVELS, name="level")
    check_sides(image.shape, what="has no surface inside")
    return image


def redundant_phases(phases: Sequence[str], only: str | None) -> Sequence[str]:
    """Return, of two phases, the one whose interface and S2 are reported with the other: the void,
    or the first.
    """
    if len(phases) != 2 or only is not None:
        return ()
    return ("void" if "void" in phases else phases[0],)


def measure_numbers(
    image: Image, *, level: str, known: Known, only: str | None = None
) -> PhaseFigures:
    """Measure the numbers; one labelling and one count of configurations a phase."""
    names = image.phases
    wanted = names if only is None else (only,)
    pairs = _pairs(names, only)
    touched = {name for pair in pairs for name in pair} | set(wanted)
    triples = only is None and len(names) > 2
    spans = np.zeros(image.shape, bool)
    cubes: dict[str, np.ndarray] = {}
    phases: dict[str, dict[str, Any]] = {}
    for label, name in enumerate(names):
        given = known.get(name, {})
        if name in touched and (triples or "components" not in given):
            inside = image.values == label
            cubes[name] = count_cubes(inside, None)
            if name in wanted:
                phases[name] = _figures(
                    image, name, inside, cubes[name], spans, level=level, given=given
                )
        elif name in wanted:
            numbers = {key: value for key, value in given.items() if key not in PHASE_CURVES}
            phases[name] = {"fraction": None, **numbers}
    areas = {pair: _contact(image, pair, cubes) for pair in pairs}
    return PhaseFigures(phases, areas, lines_of(image, spans) if triples else {})


def _figures(
    image: Image,
    name: str,
    inside: np.ndarray,
    cubes: np.ndarray,
    spans: np.ndarray,
    *,
    level: str,
    given: Mapping[str, Any],
) -> dict[str, Any]:
    """Measure the numbers of a phase, and mark in `spans` what percolates."""
    components = mark_components(inside, spans, range(image.ndim))
    crossings = CrossingTally()
    crossings.add(as_inside(inside))
    shape = densities(cubes, image.spacing, 6 if image.ndim == 3 else 4)
    fraction = components.voxels / inside.size
    found = {
        "fraction": fraction,
        **phase_figures(shape, components, crossings.rates(image.spacing), inside.size),
    }
    thick = None
    if level != "quick" and 0 < fraction < 1:
        thick = given["thickness"] if "thickness" in given else thickness(image, phase=name)
    single = measure_one_by_one(image, level=level, each="phase", phase=name)
    return {**found, "thickness": thick, **single}


def _contact(image: Image, pair: tuple[str, str], cubes: Mapping[str, np.ndarray]) -> float:
    rest = [name for name in image.phases if name not in pair]
    if len(rest) == 1 and rest[0] in cubes:
        joint = cubes[rest[0]][::-1]  # what is not the third phase is one of these two
    else:
        first, second = (image.phases.index(name) for name in pair)
        joint = count_cubes((image.values == first) | (image.values == second), None)
    return contact_area(cubes[pair[0]], cubes[pair[1]], joint, image.spacing)


def measure_curves(
    image: Image,
    *,
    level: str,
    r_max: int,
    known: Known,
    only: str | None = None,
    cross: bool = True,
) -> PhaseCurves:
    """Measure the curves, r = 0 .. r_max voxels; cross-correlations of pairs where `cross`."""
    names = image.phases
    shaped = DESCRIPTORS["shape_index"].is_measured(level) and has_curvatures(image.shape)
    phases: dict[str, dict[str, Any]] = {}
    for name in names if only is None else (only,):
        found = dict(known.get(name, {}))
        repeats = name in redundant_phases(names, only)
        if "two_point" not in found:
            found["two_point"] = None if repeats else _two_point(image, name, r_max)
        if "shape_index" not in found:
            own = shaped and not repeats
            found["shape_index"] = _as_list(shape_index(image, phase=name)) if own else None
        if "lineal_path" not in found:
            found["lineal_path"] = _as_list(lineal_path(image, phase=name, r_max=r_max))
        phases[name] = {curve: found[curve] for curve in PHASE_CURVES}
    pairs = _pairs(names, only) if cross else []
    return PhaseCurves(
        phases,
        {
            pair: cross_correlation(image, first=pair[0], second=pair[1], r_max=r_max)
            for pair in pairs
        },
    )


def _pairs(names: Sequence[str], only: str | None) -> list[tuple[str, str]]:
    """Return the pairs to describe: none of two phases, and with `only` those of that one."""
    return [
        pair for pair in combinations(names, 2) if len(names) > 2 and (only is None or only in pair)
    ]


def _two_point(image: Image, name: str, r_max: int) -> dict[str, list[float]]:
    curves = {
        along: two_point(image, phase=name, r_max=r_max, axis=axis)
        for axis, along in enumerate(AXES[3 - image.ndim :])
    }
    return {
        along: _as_list(curve)
        for along, curve in (curves | {"radial": two_point(image, phase=name, r_max=r_max)}).items()
    }


def _as_list(curve: np.ndarray) -> list[float]:
    return [float(value) for value in curve]
