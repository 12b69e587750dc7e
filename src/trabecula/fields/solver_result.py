"""`import_result`: a solver's result on the voxels of a grid, as a field.

A voxel takes the value at its middle: of an array on cells that of the cell around it, of one on
nodes the linear interpolation between the corners of the cell. For voxel bricks the first is the
brick's own value, the second the mean of its eight nodes.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, as_path_text, as_spacing, check_name, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.core.progress import notify
from trabecula.engine.compile import kernel
from trabecula.engine.memory import Plan, check_budget
from trabecula.fields.grid import as_field, as_sides
from trabecula.fields.interpolate import fill as extend
from trabecula.io.results import open_result
from trabecula.io.results.content import ResultArray, SolverResult
from trabecula.io.units import canonical, check_unit, has_length, to_metres

_AT_ONCE = 1 << 16
"""Cells that are placed at once."""

_FLAT = 1e-4
"""Share of its edge by which a brick may differ from a box: coordinates of some are float32."""

# corners of hexahedra (in the order of VTK), wedges and pyramids as tetrahedra
_TETRAHEDRA = {
    "tetrahedron": [(0, 1, 2, 3)],
    "pyramid": [(0, 1, 2, 4), (0, 2, 3, 4)],
    "wedge": [(0, 1, 2, 3), (1, 2, 3, 4), (2, 3, 4, 5)],
    "hexahedron": [
        (0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)
    ],
}  # fmt: skip
_CORNERS = np.array(
    [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
)
"""Of a box along x, y, z, in the order of VTK."""

_PLACES = {
    6: {"xx": 0, "yy": 1, "zz": 2, "xy": 3, "yz": 4, "xz": 5},
    9: {"xx": 0, "xy": 1, "xz": 2, "yx": 3, "yy": 4, "yz": 5, "zx": 6, "zy": 7, "zz": 8},
    3: {"x": 0, "y": 1, "z": 2},
}
"""Components of tensors and vectors: symmetric ones in the order of VTK and CalculiX."""


def _full(values: np.ndarray) -> np.ndarray:
    """Return tensors of 6 or 9 components as (..., 3, 3), symmetric."""
    order = [0, 3, 5, 3, 1, 4, 5, 4, 2] if values.shape[-1] == 6 else range(9)
    whole = values[..., list(order)].reshape(*values.shape[:-1], 3, 3)
    return (whole + np.swapaxes(whole, -1, -2)) / 2


def _mises(values: np.ndarray) -> np.ndarray:
    """Return von Mises's stress, sqrt(3/2 s:s) of the deviator s."""
    whole = _full(values)
    mean = np.trace(whole, axis1=-2, axis2=-1)[..., None, None] / 3
    deviator = whole - mean * np.eye(3)
    found: np.ndarray = np.sqrt(1.5 * np.sum(deviator * deviator, axis=(-2, -1)))
    return found


DERIVED: dict[str, tuple[tuple[int, ...], Callable[[np.ndarray], np.ndarray]]] = {
    "magnitude": ((3,), lambda values: np.sqrt(np.sum(values * values, axis=-1))),
    "mises": ((6, 9), _mises),
    "mean": ((6, 9), lambda values: np.trace(_full(values), axis1=-2, axis2=-1) / 3),
    "largest": ((6, 9), lambda values: np.linalg.eigvalsh(_full(values))[..., 2]),
    "smallest": ((6, 9), lambda values: np.linalg.eigvalsh(_full(values))[..., 0]),
}
"""What is computed of components: their counts, and the function. `largest` and `smallest` are
principal values."""


def import_result(
    path: str | os.PathLike[str],
    *,
    like: Image | ArrayLike | None = None,
    shape: int | Sequence[int] | None = None,
    spacing: float | Sequence[float] | None = None,
    unit: str = "voxel",
    array: str | None = None,
    component: str | int | None = None,
    file_unit: str | None = None,
    fill: float | str = 0.0,
) -> Image:
    """Read an array of a solver's result as a field on the voxels of a grid.

    The first corner of the grid is the origin of the file's coordinates, as `tb.export` writes
    them, and x is the last axis.

    Parameters
    ----------
    path : path
        `.vtu` and `.vti` (text, base64 or raw, packed or not), legacy `.vtk`, or `.frd` of
        CalculiX in text.
    like : Image or array, (Z, Y, X), optional
        Its grid, spacing and unit are the field's.
    shape, spacing, unit
        The grid without an image, as for `ramp`.
    array : str, optional
        Name of the array ("stress", "U"). Default: the only one.
    component : str or int, optional
        Of a vector x, y, z or magnitude; of a tensor xx, yy, zz, xy, yz, xz, mises, mean, largest
        or smallest (principal values); or a number from 0. Default: the only one.
    file_unit : str, optional
        Unit of the file's coordinates. Default: that of the field. OpenFOAM's is "m".
    fill : float or "extend"
        Value of voxels that no cell holds; "extend" continues the values inside (see `fill`).

    Returns
    -------
    field : Image
        Grey, float32.

    Raises
    ------
    UnknownNameError
        A suffix, array, component or unit that does not exist.
    InputError
        Several arrays or components and none named; NaN; no voxel within the mesh; no grid.
    FileError, MemoryBudgetError
        A file that is missing, truncated or damaged, or does not fit into memory.

    Examples
    --------
    >>> import tempfile, trabecula as tb
    >>> part = tb.Image(np.array([[[0, 1, 1]]], np.uint8), "labels")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = tb.export(part, f"{folder}/part.vtu")
    ...     import_result(path, like=part, array="material", fill=-1).values
    array([[[-1.,  2.,  2.]]], dtype=float32)
    """
    given = as_path_text(path)
    sides, edges, unit = _grid(like, shape, spacing, unit)
    if fill != "extend":
        fill = as_number(fill, name="fill", low=-1e30, high=1e30)
    factor = _factor(file_unit, unit)
    result = open_result(Path(given))
    chosen = result.array(array)
    name = _as_component(result, chosen, component)
    check_budget(
        Plan(
            {
                "components": 4 * chosen.components * int(np.prod(sides)),
                "field": 20 * int(np.prod(sides)),
            }
        ),
        advice="import it on a smaller grid",
    )
    values = result.values(chosen)
    step = np.array(edges[::-1]) / factor
    if result.lattice is not None:
        inside, found = _of_lattice(result, chosen, values, sides, step)
    else:
        inside, found = _of_mesh(result, chosen, values, sides, step)
    count = int(np.count_nonzero(inside))
    if not count:
        raise InputError(_apart(result, sides, edges, unit, factor))
    if count < inside.size:
        rest = "are extended" if isinstance(fill, str) else f"are {fill:g}"
        notify(f"{given}: {count} of {inside.size} voxels lie in the mesh, the others {rest}")
    field = np.full(sides, 0.0 if isinstance(fill, str) else fill)
    field[inside] = _reduce(found[inside], name)
    if isinstance(fill, str):
        field = extend(as_field(field, "import_result", {}, spacing=edges), inside).values
    settings = {
        "path": given,
        "shape": list(sides),
        "spacing": list(edges),
        "unit": unit,
        "array": chosen.name,
        "component": component,
        "file_unit": file_unit,
        "fill": fill,
    }
    return as_field(field, "import_result", settings, spacing=edges, unit=unit)


def _grid(
    like: Image | ArrayLike | None,
    shape: int | Sequence[int] | None,
    spacing: float | Sequence[float] | None,
    unit: str,
) -> tuple[tuple[int, ...], tuple[float, ...], str]:
    if (like is None) == (shape is None):
        raise InputError("a result needs a grid: give an image of it (like), or its shape")
    if like is not None:
        image = as_image(like)
        sides, edges, unit = image.shape, image.spacing, image.unit
    else:
        assert shape is not None
        check_unit(unit)
        sides = as_sides(shape)
        edges, unit = as_spacing(spacing, ndim=len(sides)), canonical(unit)
    if len(sides) != 3:
        raise InputError(f"a result is a volume, the grid has the shape {tuple(sides)}: give z y x")
    return tuple(sides), tuple(edges), unit


def _factor(file_unit: str | None, unit: str) -> float:
    """Return what turns coordinates of the file into lengths of the field."""
    if file_unit is None:
        return 1.0
    check_unit(file_unit)
    if canonical(file_unit) == unit:
        return 1.0
    if not has_length(unit):
        # a volume in voxels is exported with a voxel for each metre
        if canonical(file_unit) == "m":
            return 1.0
        raise InputError(
            f"the file's coordinates are in {file_unit}, the grid's voxels have no length: give "
            "its spacing and unit"
        )
    return to_metres(file_unit) / to_metres(unit)


def _as_component(
    result: SolverResult, array: ResultArray, component: str | int | None
) -> str | int:
    """Return the component of an array as a number, or as the name of what is computed."""
    places = _PLACES.get(array.components, {})
    derived = [name for name, (counts, _) in DERIVED.items() if array.components in counts]
    if component is None:
        if array.components == 1:
            return 0
        words = ", ".join([*places, *derived]) or f"0 .. {array.components - 1}"
        raise InputError(f"{result.path}: {array} needs a component: {words} (--component)")
    if isinstance(component, str) and component.isdigit():
        component = int(component)
    if isinstance(component, str):
        check_name(component, (*places, *derived), name=f"component of {array.name}")
        return places.get(component, component)
    most = array.components - 1
    return int(as_number(component, name="component", low=0, high=most, whole=True))


def _reduce(values: np.ndarray, component: str | int) -> np.ndarray:
    """Return one number a voxel of its components, (voxels, components)."""
    whole = values.astype(np.float64)
    if isinstance(component, str):
        return DERIVED[component][1](whole)
    return whole[:, component]


def _of_lattice(
    result: SolverResult,
    array: ResultArray,
    values: np.ndarray,
    sides: tuple[int, ...],
    step: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return which voxels lie in a lattice, and the values of its cells there."""
    lattice = result.lattice
    assert lattice is not None
    cells = values.reshape(
        *(side + (array.place == "points") for side in lattice.shape), array.components
    )
    if array.place == "points":
        for axis in range(3):
            low = cells[(slice(None),) * axis + (slice(None, -1),)]
            cells = (low + cells[(slice(None),) * axis + (slice(1, None),)]) / 2
    index, within = [], []
    for axis, side in enumerate(sides):
        x = 2 - axis
        at = ((np.arange(side) + 0.5) * step[x] - lattice.origin[x]) / lattice.spacing[x]
        cell = np.floor(at).astype(np.int64)
        within.append((cell >= 0) & (cell < lattice.shape[axis]))
        index.append(cell.clip(0, lattice.shape[axis] - 1))
    inside = within[0][:, None, None] & within[1][:, None] & within[2]
    return inside, cells[np.ix_(*index)].astype(np.float32)


def _of_mesh(
    result: SolverResult,
    array: ResultArray,
    values: np.ndarray,
    sides: tuple[int, ...],
    step: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return which voxels have their middle in a cell, and the values there."""
    assert result.points is not None
    inside = np.zeros(sides, bool)
    found = np.zeros((*sides, array.components), np.float32)
    for block in result.blocks:
        for start in range(0, len(block.nodes), _AT_ONCE):
            nodes = block.nodes[start : start + _AT_ONCE]
            numbers = block.numbers[start : start + _AT_ONCE]
            corners = result.points[nodes] / step
            held = (
                values[nodes]
                if array.place == "points"
                else np.repeat(values[_of_cells(numbers, values)][:, None], nodes.shape[1], 1)
            ).astype(np.float64)
            boxes = (
                _are_boxes(corners) if block.kind == "hexahedron" else np.zeros(len(nodes), bool)
            )
            if boxes.any():
                low = corners[boxes].min(axis=1)
                _place_boxes(low, corners[boxes].max(axis=1), held[boxes], _CORNERS, inside, found)
            for four in _TETRAHEDRA[block.kind] if not boxes.all() else []:
                some = ~boxes
                _place_tetrahedra(
                    np.ascontiguousarray(corners[some][:, four]),
                    np.ascontiguousarray(held[some][:, four]),
                    inside,
                    found,
                )
    return inside, found


def _of_cells(numbers: np.ndarray, values: np.ndarray) -> np.ndarray:
    if len(numbers) and numbers.max() >= len(values):
        raise InputError(f"an array on cells holds {len(values)} values, the mesh has more cells")
    return numbers


def _are_boxes(corners: np.ndarray) -> np.ndarray:
    """Return which hexahedra, (cells, 8, 3), are boxes along the axes in the order of VTK."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    edge = high - low
    ideal = low[:, None] + _CORNERS * edge[:, None]
    apart = np.abs(corners - ideal).max(axis=1)
    # of coordinates in float32 the last digits count more, the farther from the origin
    allowed = np.maximum(_FLAT * edge, 4e-7 * np.abs(high))
    return np.asarray((apart <= allowed).all(axis=1) & (edge > 0).all(axis=1))


def _apart(
    result: SolverResult,
    sides: tuple[int, ...],
    edges: tuple[float, ...],
    unit: str,
    factor: float,
) -> str:
    """Return the message for a mesh and a grid that do not meet."""
    if result.points is not None:
        low, high = result.points.min(axis=0) * factor, result.points.max(axis=0) * factor
    else:
        assert result.lattice is not None
        low = np.array(result.lattice.origin) * factor
        high = low + np.array(result.lattice.spacing) * result.lattice.shape[::-1] * factor
    mesh = " x ".join(f"{a:.4g}..{b:.4g}" for a, b in zip(low, high, strict=True))
    grid = " x ".join(f"0..{n * e:.4g}" for n, e in zip(sides[::-1], edges[::-1], strict=True))
    return (
        f"no voxel lies in the mesh of {quote(str(result.path))}: it reaches over {mesh} (x, y, z),"
        f" the grid over {grid} {unit}; give the unit of the file's coordinates (--unit; "
        "OpenFOAM's is m)"
    )


@kernel
def _place_boxes(low, high, values, order, inside, found):
    """Put boxes on the voxels whose middles they hold.

    low, high: (cells, 3) x, y, z in voxels; values: (cells, 8, components); order: (8, 3) corners;
    inside: (Z, Y, X) bool; found: (Z, Y, X, components). Of several the first counts.
    """
    depth, height, width = inside.shape
    for n in range(len(low)):
        x0, x1 = _first(low[n, 0]), _last(high[n, 0], width)
        y0, y1 = _first(low[n, 1]), _last(high[n, 1], height)
        z0, z1 = _first(low[n, 2]), _last(high[n, 2], depth)
        for z in range(z0, z1):
            for y in range(y0, y1):
                for x in range(x0, x1):
                    if inside[z, y, x]:
                        continue
                    inside[z, y, x] = True
                    u = (x + 0.5 - low[n, 0]) / (high[n, 0] - low[n, 0])
                    v = (y + 0.5 - low[n, 1]) / (high[n, 1] - low[n, 1])
                    w = (z + 0.5 - low[n, 2]) / (high[n, 2] - low[n, 2])
                    for c in range(found.shape[3]):
                        total = 0.0
                        for k in range(8):
                            share = (u if order[k, 0] else 1 - u) * (v if order[k, 1] else 1 - v)
                            total += share * (w if order[k, 2] else 1 - w) * values[n, k, c]
                        found[z, y, x, c] = total


@kernel
def _first(low):
    """Return the first voxel whose middle lies at `low` or above."""
    return max(int(np.ceil(low - 0.5)), 0)


@kernel
def _last(high, side):
    """Return the voxel after the last whose middle lies below `high`."""
    return min(int(np.ceil(high - 0.5)), side)


@kernel
def _place_tetrahedra(corners, values, inside, found):
    """Put tetrahedra on the voxels whose middles they hold.

    corners: (cells, 4, 3) x, y, z in voxels; values: (cells, 4, components); inside, found: as of
    `_place_boxes`.
    """
    depth, height, width = inside.shape
    share = np.empty(4)
    for n in range(len(corners)):
        a = corners[n, 0]
        p, q, r = corners[n, 1] - a, corners[n, 2] - a, corners[n, 3] - a
        volume = (
            p[0] * (q[1] * r[2] - q[2] * r[1])
            - p[1] * (q[0] * r[2] - q[2] * r[0])
            + p[2] * (q[0] * r[1] - q[1] * r[0])
        )
        if volume == 0:
            continue
        # a middle on a face belongs to either
        x0, x1 = _first(corners[n, :, 0].min() - 1e-9), _last(corners[n, :, 0].max() + 1e-9, width)
        y0, y1 = _first(corners[n, :, 1].min() - 1e-9), _last(corners[n, :, 1].max() + 1e-9, height)
        z0, z1 = _first(corners[n, :, 2].min() - 1e-9), _last(corners[n, :, 2].max() + 1e-9, depth)
        for z in range(z0, z1):
            for y in range(y0, y1):
                for x in range(x0, x1):
                    if inside[z, y, x]:
                        continue
                    d0, d1, d2 = x + 0.5 - a[0], y + 0.5 - a[1], z + 0.5 - a[2]
                    share[1] = (
                        d0 * (q[1] * r[2] - q[2] * r[1])
                        - d1 * (q[0] * r[2] - q[2] * r[0])
                        + d2 * (q[0] * r[1] - q[1] * r[0])
                    ) / volume
                    share[2] = (
                        p[0] * (d1 * r[2] - d2 * r[1])
                        - p[1] * (d0 * r[2] - d2 * r[0])
                        + p[2] * (d0 * r[1] - d1 * r[0])
                    ) / volume
                    share[3] = (
                        p[0] * (q[1] * d2 - q[2] * d1)
                        - p[1] * (q[0] * d2 - q[2] * d0)
                        + p[2] * (q[0] * d1 - q[1] * d0)
                    ) / volume
                    share[0] = 1 - share[1] - share[2] - share[3]
                    if share.min() < -1e-9:
                        continue
                    inside[z, y, x] = True
                    for c in range(found.shape[3]):
                        total = 0.0
                        for k in range(4):
                            total += share[k] * values[n, k, c]
                        found[z, y, x, c] = total
