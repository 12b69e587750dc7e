"""`tetrahedra`: an image of labels as tetrahedra with smooth interfaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, check_labels, phase_index
from trabecula.core.progress import report
from trabecula.engine.memory import Plan, check_budget
from trabecula.mesh.tetrahedra.base import Tetrahedra
from trabecula.mesh.tetrahedra.cut import cut_cells
from trabecula.mesh.tetrahedra.lattice import lattice
from trabecula.mesh.tetrahedra.levels import interface_voxels, level_at, smooth_levels
from trabecula.mesh.tetrahedra.quality import volumes

_SIGMA = 0.8  # voxels that labels are smoothed by: less leaves steps, more rounds struts off
_ROUNDS = 6  # of cutting again with levels shifted until the volumes fit
_FIT = 2e-3  # of the volume of every phase
_MOST = 0.1  # that a level is shifted by at once
_CELL_BYTES = 1700  # a cell of the lattice: 12 tetrahedra, their cuts and copies
_VOXEL_BYTES = 16  # levels of two phases and their smoothing


def tetrahedra(
    image: Image | ArrayLike,
    *,
    edge: float = 2.0,
    phases: str | int | Sequence[str | int] | None = None,
) -> Tetrahedra:
    """Mesh phases with tetrahedra that share nodes at smooth interfaces.

    Labels are smoothed by 0.8 voxels; a point is of the phase whose level is highest there, and
    levels are shifted until every phase has the volume of its voxels. A body-centred lattice is cut
    along these interfaces one phase after the other (Labelle and Shewchuk 2007,
    doi:10.1145/1276377.1276448).

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
        Voxels are cubes.
    edge : float
        Side of a cell of the lattice in voxels, 0.5 to 100; edges are between half of it and all of
        it. What is thinner comes out broken.
    phases : str, int or sequence of them, optional
        Phases that are kept. Default: every phase but "void".

    Returns
    -------
    Tetrahedra
        Phases that were left out shape the others nevertheless. Opposite faces of the image have
        the same nodes in empty regions alone: a periodic image gives no periodic mesh.

    Raises
    ------
    InputError
        Not 3-D, voxels that are no cubes, none of a phase, an edge out of range or above the
        shortest side.
    MemoryBudgetError
        It would not fit into memory.

    Examples
    --------
    >>> ball = np.linalg.norm(np.indices((20, 20, 20)) - 9.5, axis=0) < 7
    >>> found = tetrahedra(ball.astype(int))
    >>> bool(abs(found.volume["solid"] / ball.sum() - 1) < 0.01), found.angles.least > 8
    (True, True)
    """
    image = as_image(image)
    check_labels(image)
    if image.ndim != 3:
        raise InputError(f"tetrahedra need a volume, the image has shape {image.shape}")
    if max(image.spacing) > 1.001 * min(image.spacing):
        raise InputError(
            f"voxels of {image.spacing} are no cubes: resample the image before it is meshed"
        )
    step = as_number(edge, name="edge", low=0.5, high=100)
    if step > min(image.shape):
        raise InputError(f"edge {step:g} is longer than the image of {image.shape}: take less")
    kept = _kept(image, phases)
    cells = float(np.prod(np.array(image.shape) / step))
    check_budget(
        Plan({"tetrahedra": int(cells * _CELL_BYTES), "levels": image.values.size * _VOXEL_BYTES}),
        advice="take a longer edge, or mesh a crop",
    )
    order = _order(image, kept)
    points, members, labels = _fit(image.values, order, step)
    chosen = np.isin(labels, kept)
    members, labels = members[chosen], labels[chosen]
    used, members = np.unique(members, return_inverse=True)
    # x, y, z instead of z, y, x turns every tetrahedron over, so two of its nodes are swapped
    members = members.reshape(-1, 4)[:, [0, 1, 3, 2]].astype(np.int32)
    places = points[used][:, ::-1] * image.spacing[0]
    recipe = image.recipe.then(
        "tetrahedra", places, edge=step, phases=[image.phases[n] for n in kept]
    )
    extent = np.array(image.shape[::-1]) * image.spacing[0]
    names = tuple(image.phases)
    return Tetrahedra(places, members, labels, names, extent, image.unit, recipe)


def _kept(image: Image, phases: str | int | Sequence[str | int] | None) -> list[int]:
    """Return the labels that are kept."""
    present = np.unique(image.values)
    if phases is None:
        kept = [n for n in present if image.phases[n] != "void"]
    else:
        given = [phases] if isinstance(phases, (str, int)) else list(phases)
        kept = [phase_index(image, one, default="solid") for one in given]
        missing = [image.phases[n] for n in kept if n not in present]
        if missing:
            raise InputError(f"no voxel is {' or '.join(missing)}: there is nothing to mesh")
    if not kept:
        raise InputError("every voxel is void: there is nothing to mesh")
    return [int(n) for n in kept]


def _order(image: Image, kept: list[int]) -> list[int]:
    """Return the labels in the order in which they are cut: kept ones first, of these the smallest,
    since what is cut first has the best tetrahedra.
    """
    counts = np.bincount(image.values.ravel())
    present = np.flatnonzero(counts).tolist()
    return sorted(present, key=lambda n: (n not in kept, counts[n], n))


def _fit(
    values: np.ndarray, order: list[int], step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut until the volumes fit."""
    levels = smooth_levels(values, order, _SIGMA)
    if len(order) == 1:
        return _cut(levels, order, values.shape, step)
    wanted = np.bincount(values.ravel())[order].astype(np.float64)
    response = interface_voxels(levels)
    before, expected = wanted, np.zeros(len(order))
    for number in range(_ROUNDS):
        points, cells, labels = _cut(levels, order, values.shape, step)
        sizes: np.ndarray = np.bincount(labels, volumes(points, cells), max(order) + 1)[order]
        report("tetrahedra", (number + 1) / _ROUNDS)
        if np.abs(sizes / wanted - 1).max() < _FIT:
            break
        if number:  # how far the last shift went tells how far the next one goes
            went = (sizes - before) / np.where(expected == 0, 1, expected)
            response *= np.clip(went, 0.25, 4)
        before, shift = sizes, np.clip((wanted - sizes) / response, -_MOST, _MOST)
        expected = shift * response
        levels += shift.astype(np.float32).reshape(-1, 1, 1, 1)
    report("tetrahedra", 1)
    return points, cells, labels


def _cut(
    levels: np.ndarray, order: list[int], shape: tuple[int, ...], step: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut phase after phase out of the lattice; return points, tetrahedra and their labels."""
    points, cells, planes = lattice(np.array(shape, np.float64), step)
    fixed = np.zeros(len(points), bool)
    labels = np.full(len(cells), order[-1], np.uint8)
    for number, label in enumerate(order[:-1]):
        level = level_at(levels, number, points)
        free = labels == order[-1]
        points, cells, planes, fixed, whole, side = cut_cells(
            points, cells, planes, fixed, level, step, free
        )
        labels, free = labels[whole], free[whole]
        flat = np.flatnonzero(free & (side == 0))
        middle = points[cells[flat]].mean(axis=1)
        side[flat] = np.where(level_at(levels, number, middle) > 0, 1, -1)
        labels[free & (side > 0)] = label
    return points, cells, labels
