"""Descriptors of a volume that is read some planes at a time, without the volume in memory."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from trabecula.core.checks import as_number, check_name, check_type
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.engine.lazy_volume import Slabs, depth_within
from trabecula.engine.memory import Plan, as_budget, available_memory
from trabecula.measure.centre_crop import box_sides
from trabecula.measure.correlation.pair_geometry import Radial, steps_of
from trabecula.measure.correlation.window import Window
from trabecula.measure.describe import (
    SIZE_KEYS,
    derive_phase_figures,
    outline_without_solid,
    void_notes,
)
from trabecula.measure.each_phase import drop_redundant, redundant_beside_solid
from trabecula.measure.effective_properties import PHYSICS, describe_physics, physics_notes
from trabecula.measure.phases import indicator
from trabecula.measure.registry import CURVES, DESCRIPTORS, LEVELS, select
from trabecula.measure.runs import RUN_BYTES
from trabecula.measure.slab_diameters import mean_diameter_of_slabs
from trabecula.measure.streaming import ComponentSizes, SolidNumbers
from trabecula.measure.streaming.numbers import CurveTally, PhaseTallies
from trabecula.measure.streaming.pairs import pairs_bytes

PHASES_LEFT_OUT = ("cross_correlation", "triples")
"""Figures of three phases or more that need the whole volume in memory."""

_AT_ONCE = 2 * 160**3  # voxels that are described at once
_IN_CORE = {"quick": 26, "default": 45, "full": 45}
"""Bytes a voxel of `describe`, by level, less the solvers' own (which are refused by their own
forecast).
"""


def describe_slabs(
    volume: Slabs,
    *,
    r_max: int = 50,
    level: str = "default",
    box: int | None = None,
    depth: int | None = None,
    memory: int | None = None,
) -> dict[str, Any]:
    """Describe a volume from slabs of it, as `describe` does: every plane is read once.

    Parameters
    ----------
    volume : Slabs
        Labels, (Z, Y, X).
    r_max : int
        Largest distance of the curves, in voxels; lowered to half the smallest side.
    level : {"quick", "default", "full"}
        As of `describe`; "full" solves transport and stiffness in a centre `box`, which alone is
        read for it.
    box : int, optional
        Edge of that box, voxels; needed at level "full".
    depth : int, optional
        Planes of a slab. Default: as many as fit into `memory`. No figure depends on it.
    memory : int, optional
        Bytes that may be used. Default: what is available.

    Returns
    -------
    descriptors : dict
        The keys of `describe`, with its values; the radial curve of large volumes within the
        rounding errors of float32 (1e-7 of the pairs). `None` for `morphometry`, `anisotropy`,
        `two_point_cluster` and `shape_index`, which need the whole volume, with three phases or
        more for `triples` and the `cross_correlation` of pairs, and for `pore_size` or `thickness`
        where slabs with the largest sphere's planes on either side, twice, do not fit into memory:
        `notes` names what was left out.

    Raises
    ------
    InputError
        As `describe`; level "full" without a box.
    MemoryBudgetError
        Not even a slab of one plane fits.
    """
    check_type(volume, Slabs, name="volume", advice="tb.open_slabs gives one")
    check_name(level, LEVELS, name="level")
    if level == "full" and box is None:
        raise InputError(
            "transport and stiffness of a volume in slabs are solved in a centre box: "
            "give its edge (--box)"
        )
    reach = int(as_number(r_max, name="r_max", low=1, high=2**62, whole=True))
    reach = max(1, min(reach, min(volume.shape) // 2))
    most = volume.shape[0] if depth is None else depth
    if depth is None:
        depth = fitting_depth(volume, r_max=reach, memory=memory, phases=True)
    depth = int(as_number(depth, name="depth", low=1, high=2**62, whole=True))
    if "void" in volume.phases:
        found = count_slabs(volume, r_max=reach, depth=depth, phases=True)[0] | dict.fromkeys(
            (*names_without_slabs(), *PHYSICS)
        )
    else:
        found = _count_phases(volume, r_max=reach, depth=depth)
    if DESCRIPTORS["thickness"].is_measured(level):
        _add_diameters(found, volume, most, memory)
    known = derive_phase_figures(volume.phases, found)
    whole = [one for one in select(each="phase", source=CURVES) if not one.streams]
    left_out: dict[str, Any] = dict.fromkeys(one.name for one in whole)
    each = {
        name: left_out | known.get(name, {}) | found["phases"].get(name, {})
        for name in volume.phases
    }
    found["phases"] = drop_redundant(each, redundant_beside_solid(volume.phases))
    if level == "full" and "void" in volume.phases:
        found |= describe_physics(volume.centre(box_sides(box, volume.shape)), halving=True)
    left = _notes(level, volume.phases, found)
    notes = [*void_notes(volume.phases), *left, *physics_notes(found)]
    return found | {"level": level, "notes": notes}


def fitting_depth(
    volume: Slabs, *, r_max: int, memory: int | None = None, phases: bool = False
) -> int:
    """Return the planes of the deepest slab with which `count_slabs` fits into memory.

    Raises
    ------
    MemoryBudgetError
        Not even a slab of one plane fits.
    """
    advice = "measure a smaller box (--crop)"
    return depth_within(
        volume,
        lambda planes: forecast(volume, r_max=r_max, depth=planes, phases=phases),
        memory=memory,
        advice=advice,
    )


def count_slabs(
    volume: Slabs, *, r_max: int, depth: int, phases: bool = False, tallies: Sequence[Any] = ()
) -> tuple[dict[str, Any], ComponentSizes]:
    """Measure what one pass over all planes gives, by the names of `describe`, and the components
    of the solid.

    Parameters
    ----------
    volume : Slabs
    r_max : int
        Largest distance of the curves; it has to fit every side.
    depth : int
        Planes of a slab.
    phases : bool
        Measure `phases` and `pairs` as well. Every phase is a pass of its own over each slab.
    tallies : sequence, optional
        Further objects whose `add` takes every slab, so that planes are read once for them as well.

    Raises
    ------
    InputError
        No phase is named void.
    """
    pairs = _radial(volume, r_max)
    numbers, curves = SolidNumbers(volume.shape, volume.spacing, volume.phases), CurveTally(pairs)
    each = _each_phase(volume, pairs) if phases else None
    for slab in _iterate_slabs(volume, depth):
        inside = indicator(slab, None)[1]
        numbers.add(slab)
        curves.add(inside)
        if each is not None:
            each.add(slab)
        for tally in tallies:
            tally.add(slab)
    found = {
        "shape": list(volume.shape),
        "spacing": list(volume.spacing),
        "unit": volume.unit,
        **numbers.result(),
        "r_max": r_max,
        "two_point": curves.two_point(),
        "lineal_path": curves.lineal_path(),
    }
    return found | (each.result() if each is not None else {}), numbers.component_sizes()


def _count_phases(volume: Slabs, *, r_max: int, depth: int) -> dict[str, Any]:
    """Count every phase in one pass over all planes, where no phase is named void."""
    each = _each_phase(volume, _radial(volume, r_max))
    counts = np.zeros(len(volume.phases), np.int64)
    for slab in _iterate_slabs(volume, depth):
        counts += np.bincount(slab.values.ravel(), minlength=len(counts))
        each.add(slab)
    return outline_without_solid(volume, counts, r_max=r_max) | each.result()


def _each_phase(volume: Slabs, pairs: Radial) -> PhaseTallies:
    solid = [name for name in volume.phases if name != "void"]
    # With two phases the solid is the phase that is not void, and counted anyway.
    skipped = solid if len(volume.phases) == 2 and len(solid) == 1 else ()
    return PhaseTallies(volume.spacing, volume.phases, pairs, skipped=skipped)


def _iterate_slabs(volume: Slabs, depth: int) -> Iterable[Image]:
    return track(volume.slabs(depth), "slabs", total=-(-volume.shape[0] // depth))


def _radial(volume: Slabs, r_max: int) -> Radial:
    return Radial(Window(volume.shape, (False,) * 3), r_max, steps_of(volume.spacing))


def _add_diameters(found: dict[str, Any], volume: Slabs, depth: int, memory: int | None) -> None:
    """Add the mean diameters of solid, void and every further phase, as far as memory allows."""
    budget = available_memory() if memory is None else as_budget(memory)

    def mean(phase: str | None, default: str) -> float | None:
        return mean_diameter_of_slabs(
            volume, phase=phase, default=default, depth=depth, memory=budget
        )

    if "void" in volume.phases and 0 < found["porosity"] < 1:
        found["thickness"], found["pore_size"] = mean(None, "solid"), mean(None, "void")
    for name, figures in found["phases"].items():
        figures["thickness"] = found["pore_size"] if name == "void" else mean(name, "solid")


def _notes(level: str, phases: Sequence[str], found: Mapping[str, Any]) -> list[str]:
    missing = [
        name
        for name in names_without_slabs()
        if DESCRIPTORS[name].is_measured(level) and found.get(name) is None
    ]
    missing += PHASES_LEFT_OUT if len(phases) > 2 else ()
    if not missing:
        return []
    return [
        f"Measured slab by slab: {', '.join(missing)} need the whole volume in memory and were "
        "left out; measure them in a box (--crop), or at a coarser level of the store."
    ]


def names_without_slabs() -> tuple[str, ...]:
    """Return the names of the descriptors that need the whole volume in memory."""
    curves = [one for one in select(source=CURVES, kind="labels") if not one.streams]
    single = select(source="", kind="labels")
    return (*SIZE_KEYS, *(one.name for one in (*curves, *single)))


def forecast(volume: Slabs, *, r_max: int, depth: int, phases: bool = False) -> Plan:
    """Forecast the memory of `count_slabs` with slabs of `depth` planes; `r_max` has to fit every
    side.

    Parameters
    ----------
    volume : Slabs
    r_max, depth : int
    phases : bool
        Whether every phase is measured as well.

    Returns
    -------
    plan : Plan
    """
    plane = math.prod(volume.shape[1:])
    pairs = _radial(volume, r_max)
    # Of two phases the void alone is counted besides the solid.
    tallies = 1 + phases * (len(volume.phases) if len(volume.phases) > 2 else 1)
    numbering = RUN_BYTES * depth * plane // 2  # two voxels hold one run at most
    return Plan(
        {
            "slab": 3 * depth * plane,
            "planes before it": (2 * pairs.reach[0] + 40) * plane * tallies,
            "work": max(numbering, pairs_bytes(pairs, depth)),
        }
    )


def images_at_once(shapes: Sequence[Sequence[int]], level: str) -> int:
    """Return how many images of at most these shapes may be described at once: larger ones share
    their slabs among threads as well, and take what `in_core_bytes` says one after the other.
    """
    if level == "full":  # whose solvers take more, and report their own progress
        return 1
    return max(1, _AT_ONCE // max(map(math.prod, shapes)))


def in_core_bytes(shape: tuple[int, ...], level: str) -> int:
    """Estimate the bytes that `describe` of a volume in memory needs."""
    return _IN_CORE[level] * math.prod(shape)
