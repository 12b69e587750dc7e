"""`describe` of a volume that is read some planes at a time: the same figures, without the volume in memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from trabecula.core.checks import as_number, check_name
from trabecula.core.errors import InputError
from trabecula.core.progress import track
from trabecula.engine.plan import Plan
from trabecula.engine.slabs import Slabs, depth_within
from trabecula.measure.box import box_sides
from trabecula.measure.correlation.paths import segments_that_fit
from trabecula.measure.correlation.separations import Radial, Ray, probability, steps_of
from trabecula.measure.correlation.window import Window
from trabecula.measure.describe import LEVELS, SLOW
from trabecula.measure.percolation import AXES
from trabecula.measure.phases import indicator
from trabecula.measure.physics import PHYSICS, describe_physics, physics_notes
from trabecula.measure.runs import RUN_BYTES
from trabecula.measure.tallies import Lines, Numbers, PieceSizes, RadialPairs
from trabecula.measure.tallies.pairs import pairs_bytes

LEFT_OUT = (*SLOW, "two_point_cluster")
"""What needs the whole volume in memory."""

_IN_CORE = {"quick": 20, "default": 45, "full": 45}
"""Bytes a voxel of `describe`, by level, less the solvers' own (which are refused by their own forecast)."""


def describe_slabs(
    volume: Slabs,
    *,
    r_max: int = 50,
    level: str = "default",
    box: int | None = None,
    depth: int | None = None,
    memory: int | None = None,
) -> dict[str, Any]:
    """What `describe` tells of a volume, from slabs of it: every plane is read once.

    Parameters
    ----------
    volume : Slabs
        Labels, (Z, Y, X).
    r_max : int
        Largest distance of the curves, in voxels; lowered to half the smallest side.
    level : {"quick", "default", "full"}
        As of `describe`; "full" solves transport and stiffness in a centre `box`, which alone is read for it.
    box : int, optional
        Edge of that box, voxels; needed at level "full".
    depth : int, optional
        Planes of a slab. Default: as many as fit into `memory`. No figure depends on it.
    memory : int, optional
        Bytes that may be used. Default: what is available.

    Returns
    -------
    descriptors : dict
        The keys of `describe`, with its values; the radial curve of large volumes within the rounding errors of float32
        (1e-7 of the pairs). `None` for `pore_size`, `thickness`, `morphometry`, `anisotropy` and `two_point_cluster`, which
        need the whole volume: `notes` names what was left out.

    Raises
    ------
    InputError
        As `describe`; level "full" without a box.
    MemoryBudgetError
        Not even a slab of one plane fits.
    """
    check_name(level, LEVELS, name="level")
    if level == "full" and box is None:
        raise InputError(
            "transport and stiffness of a volume in slabs are solved in a centre box: give its edge (--box)"
        )
    reach = int(as_number(r_max, name="r_max", low=1, high=2**62, whole=True))
    reach = max(1, min(reach, min(volume.shape) // 2))
    if depth is None:
        depth = fitting_depth(volume, r_max=reach, memory=memory)
    depth = int(as_number(depth, name="depth", low=1, high=2**62, whole=True))
    found = count_slabs(volume, r_max=reach, depth=depth)[0]
    found |= dict.fromkeys((*LEFT_OUT, *PHYSICS))
    if level == "full":
        found |= describe_physics(volume.centre(box_sides(box, volume.shape)), halving=True)
    return found | {"level": level, "notes": [*_notes(level), *physics_notes(found)]}


def fitting_depth(volume: Slabs, *, r_max: int, memory: int | None = None) -> int:
    """Planes of the deepest slab with which `count_slabs` fits into memory.

    Raises
    ------
    MemoryBudgetError
        Not even a slab of one plane fits.
    """
    advice = "measure a smaller box (--crop)"
    return depth_within(
        volume, lambda planes: forecast(volume, r_max=r_max, depth=planes), memory=memory, advice=advice
    )


def count_slabs(
    volume: Slabs, *, r_max: int, depth: int, tallies: Sequence[Any] = ()
) -> tuple[dict[str, Any], PieceSizes]:
    """What one pass over all planes tells, by the names of `describe`, and the components of the solid.

    Parameters
    ----------
    volume : Slabs
    r_max : int
        Largest distance of the curves; it has to fit every side.
    depth : int
        Planes of a slab.
    tallies : sequence, optional
        Further objects whose `add` takes every slab, so that planes are read once for them as well.
    """
    pairs = _radial(volume, r_max)
    numbers = Numbers(volume.shape, volume.spacing, volume.phases)
    lines, radial = Lines(r_max), RadialPairs(pairs)
    for slab in track(volume.slabs(depth), "slabs", total=-(-volume.shape[0] // depth)):
        inside = indicator(slab, None)[1]
        numbers.add(slab)
        lines.add(inside)
        radial.add(inside)
        for tally in tallies:
            tally.add(slab)
    rays = [Ray(pairs.window, r_max, tuple(float(along == axis) for along in range(3))) for axis in range(3)]
    curves = {name: probability(lines.pairs[axis], rays[axis].fits()).tolist() for axis, name in enumerate(AXES)}
    fits = sum(segments_that_fit(volume.shape, r_max, axis, False) for axis in range(3))
    found = {
        "shape": list(volume.shape),
        "spacing": list(volume.spacing),
        "unit": volume.unit,
        **numbers.result(),
        "r_max": r_max,
        "two_point": {**curves, "radial": radial.result().tolist()},
        "lineal_path": (lines.segments.sum(axis=0) / fits).tolist(),
    }
    return found, numbers.pieces()


def _radial(volume: Slabs, r_max: int) -> Radial:
    return Radial(Window(volume.shape, (False,) * 3), r_max, steps_of(volume.spacing))


def _notes(level: str) -> list[str]:
    if level == "quick":
        return []
    return [
        f"Measured slab by slab: {', '.join(LEFT_OUT)} need the whole volume in memory and were left out; measure them in a "
        "box (--crop), or at a coarser level of the store."
    ]


def forecast(volume: Slabs, *, r_max: int, depth: int) -> Plan:
    """What `describe_slabs` will need with slabs of `depth` planes; `r_max` has to fit every side.

    Parameters
    ----------
    volume : Slabs
    r_max, depth : int

    Returns
    -------
    plan : Plan
    """
    plane = math.prod(volume.shape[1:])
    pairs = _radial(volume, r_max)
    numbering = RUN_BYTES * depth * plane // 2  # two voxels hold one run at most
    return Plan(
        {
            "slab": 3 * depth * plane,
            "planes before it": (2 * pairs.reach[0] + 40) * plane,
            "work": max(numbering, pairs_bytes(pairs, depth)),
        }
    )


def in_core_bytes(shape: tuple[int, ...], level: str) -> int:
    """About what `describe` of a volume in memory needs."""
    return _IN_CORE[level] * math.prod(shape)
