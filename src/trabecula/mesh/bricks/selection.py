"""Which voxels become bricks: those of some phases, and of these all that a load case reaches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from trabecula.core.checks import quote
from trabecula.core.errors import InputError
from trabecula.core.image import phase_index
from trabecula.core.progress import notify
from trabecula.engine.lazy_volume import Slabs
from trabecula.engine.memory import Plan, check_budget
from trabecula.measure.labelling import label_components
from trabecula.measure.percolation import spanning_voxels, wrapping_components
from trabecula.measure.phases import members as labels_inside
from trabecula.mesh.bricks.faces import AXES
from trabecula.mesh.bricks.grid import BrickGrid


@dataclass(frozen=True, eq=False)
class BrickComponent:
    """Bricks that hold together by the nodes that they share.

    Attributes
    ----------
    ends : int array, (3, 2, 3)
        For every axis the voxel (z, y, x) of the component that is lowest along it, and that which
        is highest.
    periods : int array, (n, 3)
        Periods that it wraps along; of a load case between faces empty.
    """

    ends: np.ndarray
    periods: np.ndarray


@dataclass(frozen=True, eq=False)
class Bearing:
    """The bricks of a load case."""

    grid: BrickGrid
    components: tuple[BrickComponent, ...]
    left_out: int
    """Voxels of the phases that no load reaches."""


def choose_phases(volume: Slabs, phases: Sequence[str | int] | None) -> BrickGrid:
    """Return the bricks of some phases; of every phase but "void" where none is named.

    Raises
    ------
    InputError
        No such phase; none is given, and none is named "void".
    """
    plane = volume.planes(0, 1)
    if phases is None:
        inside = labels_inside(plane, None)
        labels = [n for n in range(len(volume.phases)) if inside[n]]
    else:
        labels = list(dict.fromkeys(phase_index(plane, phase, default="") for phase in phases))
    table = np.full(256, -1, np.int16)
    table[labels] = np.arange(len(labels))
    return BrickGrid(volume, table, tuple(volume.phases[label] for label in labels))


def choose_bearing(
    grid: BrickGrid, axis: int, *, periodic: bool, held: bool, memory: int | None
) -> Bearing:
    """Return the bricks of components (of shared faces) that reach from face to face along an axis,
    or that wrap around the periodic box; `held` asks for the components that have to be held.

    Raises
    ------
    InputError
        The phases do not percolate along the axis.
    MemoryBudgetError
        The labels of all voxels do not fit into memory.
    """
    voxels = int(np.prod(grid.volume.shape))
    check_budget(
        Plan({"voxels": 2 * voxels, "labels": 8 * voxels, "held": 8 * voxels * held}),
        budget=memory,
        advice="export a crop, or without a load case",
    )
    inside = np.empty(grid.volume.shape, bool)
    for z, plane in enumerate(grid.planes()):
        inside[z] = plane >= 0
    total = int(np.count_nonzero(inside))
    periods: dict[int, np.ndarray] = {}
    if periodic:
        labels, periods = wrapping_components(inside)
        through = np.zeros(int(labels.max(initial=0)) + 1, bool)
        through[list(periods)] = True
        keep = through[labels]
        passes = any(gaps[:, axis].any() for gaps in periods.values())
    else:
        labels = label_components(inside)[0]
        keep = spanning_voxels(labels, axis)
        passes = bool(keep.any())
    if not passes:
        _refuse(grid, inside, axis, periodic)
    found = _components(keep, periods if periodic else None) if held else ()
    left_out = total - int(np.count_nonzero(keep))
    return Bearing(replace(grid, keep=keep if left_out else None), found, left_out)


def _refuse(grid: BrickGrid, inside: np.ndarray, axis: int, periodic: bool) -> None:
    names = " and ".join(map(quote, grid.names))
    if periodic:
        raise InputError(
            f"{names} does not meet itself across the faces along {AXES[axis]}, so the periodic "
            "volume bears nothing: make it periodic, or choose --case compression"
        )
    labels = label_components(inside)[0]
    others = [AXES[a] for a in range(3) if a != axis and spanning_voxels(labels, a).any()]
    way = f"choose --axis {' or '.join(others)}" if others else "join it first (finish --connect)"
    raise InputError(
        f"{names} does not percolate along {AXES[axis]}, so nothing passes from face to face: {way}"
    )


def _components(
    keep: np.ndarray, periods: dict[int, np.ndarray] | None
) -> tuple[BrickComponent, ...]:
    """Find what holds together: components that touch by an edge or a node are one here; `periods`
    of components by shared faces, where the volume repeats itself.
    """
    if periods is None:
        labels, sizes = label_components(keep, connectivity=26)
        numbers, wraps = list(range(1, len(sizes) + 1)), dict[int, np.ndarray]()
        hinged = len(label_components(keep)[1]) > len(sizes)
    else:
        labels, wraps = wrapping_components(keep, connectivity=26)
        numbers = sorted(wraps)
        hinged = _ranks(periods) != _ranks(wraps)
    if hinged:
        notify(
            "bricks hold together by an edge or a node alone, as by hinges: a solver may find them "
            "loose; join them first (finish --manifold)"
        )
    ends = np.full((int(labels.max()) + 1, 3, 2, 3), -1, np.int64)
    for axis in range(3):
        for at, plane in enumerate(np.moveaxis(labels, axis, 0)):
            known, first = np.unique(plane, return_index=True)
            places = np.insert(
                np.stack(np.unravel_index(first, plane.shape), axis=1), axis, at, axis=1
            )
            ends[known, axis, 1] = places
            fresh = ends[known, axis, 0, 0] < 0
            ends[known[fresh], axis, 0] = places[fresh]
    none = np.empty((0, 3), np.int64)
    return tuple(BrickComponent(ends[n], wraps.get(n, none)) for n in numbers)


def _ranks(periods: dict[int, np.ndarray]) -> list[int]:
    """Return along how many directions each component repeats, sorted."""
    return sorted(int(np.linalg.matrix_rank(gaps)) for gaps in periods.values())
