"""`voxelise`: the voxels of a grid that are inside a surface.

1. For every row of voxels along x, find the crossings of its centre line with the surface, and
   their directions. A line crosses a triangle where the triangle winds around it in the plane
   (y, z). The test of an edge takes its ends in a fixed order, so both triangles at the edge decide
   alike, and the crossings of a row sum to 0, whatever the rounding: no ray can leak through an
   edge or a vertex, and none needs to be displaced.
2. Sum the crossings along the row: the sum is the winding number, and a voxel is inside where it is
   not 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from trabecula.core.checks import as_number, as_shape, as_spacing, check_type, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.recipe import Recipe
from trabecula.engine.memory import Plan, check_budget
from trabecula.engine.parallel import for_slabs
from trabecula.mesh import kernels
from trabecula.mesh.base import Mesh
from trabecula.mesh.check import check_closed
from trabecula.mesh.triangle_grid import sample_triangles
from trabecula.mesh.weld import weld


def voxelise(
    mesh: Mesh,
    *,
    spacing: float | Sequence[float],
    shape: int | Sequence[int] | None = None,
    margin: int = 0,
    origin: Sequence[float] | None = None,
) -> Image:
    """Return the voxels whose centres are inside a closed surface.

    Parameters
    ----------
    mesh : Mesh
        Watertight. Overlapping solids are united; a surface that faces inwards is a cavity.
    spacing : float or sequence of float
        Edge of a voxel along z, y, x, in the mesh's unit.
    shape : int or sequence of int, optional
        Voxels along z, y, x. Default: as many as the mesh needs, plus `margin`.
    margin : int, optional
        Empty voxels around the mesh along every axis, 0..4096. Not beside `shape`. Default 0.
    origin : sequence of float, optional
        z, y, x of the corner of voxel (0, 0, 0) in the mesh's coordinates. Default: the mesh is
        centred.

    Returns
    -------
    Image, (Z, Y, X)
        Labels void and solid, in the mesh's unit.

    Raises
    ------
    InputError
        The mesh has holes or no coherent outside; it does not fit into `shape`; no voxel's centre
        is inside.
    MemoryBudgetError
        More voxels than memory.

    Notes
    -----
    A voxel is inside or outside as a whole. The error of the volume cancels to below 0.1 % where
    the form is 200 voxels wide or more.

    Examples
    --------
    >>> import numpy as np, trabecula as tb
    >>> block = np.zeros((4, 5, 6), np.uint8); block[1:3, 1:4, 1:5] = 1
    >>> again = voxelise(tb.mesh(block, smooth=0), spacing=1, shape=(4, 5, 6), origin=(0, 0, 0))
    >>> bool((again.values == block).all())
    True
    """
    check_type(mesh, Mesh, name="mesh", advice="tb.read_mesh gives one of a file")
    edges = as_spacing(spacing, ndim=3)
    closed = _weld_if_open(mesh)
    low, high = (bound[::-1] for bound in _bounds(closed))
    sides, corner = _grid(low, high, edges, shape, margin, origin)
    check_budget(
        Plan({"voxels": int(np.prod(sides, dtype=np.int64))}),
        advice="use larger voxels, or a smaller mesh",
    )
    points = np.ascontiguousarray((closed.vertices[:, ::-1].astype(np.float64) - corner) / edges)
    values = np.zeros(sides, np.int8)
    faces = np.ascontiguousarray(closed.faces)
    for_slabs(lambda start, stop: kernels.fill_rows(points, faces, values, start, stop), sides[0])
    solid = values.view(np.uint8)
    if not solid.any():
        raise InputError(
            f"no voxel lies inside the mesh of {_size(high - low)} {mesh.unit} (z, y, x) at voxels "
            f"of {_size(edges)}: use smaller voxels, or scale the mesh"
        )
    settings = {"mesh": mesh.recipe, "spacing": edges, "shape": sides, "origin": corner}
    recipe = Recipe().then("voxelise", solid, **settings)
    return Image(solid, "labels", edges, mesh.unit, recipe=recipe)


def mark_surface(
    mesh: Mesh,
    *,
    spacing: float | Sequence[float],
    shape: int | Sequence[int],
    origin: Sequence[float],
) -> np.ndarray:
    """Return the voxels that a surface goes through, closed or not: (Z, Y, X) bool.

    The surface is looked at every quarter of a voxel, so corners that it only grazes may be left.

    Parameters
    ----------
    mesh : Mesh
    spacing, shape, origin
        Of the grid, as of `voxelise`.

    Raises
    ------
    InputError
        The surface lies outside of the grid.
    """
    check_type(mesh, Mesh, name="mesh", advice="tb.read_mesh gives one of a file")
    edges = np.array(as_spacing(spacing, ndim=3))
    sides = as_shape(shape)
    points = (mesh.vertices[:, ::-1].astype(np.float64) - np.array(origin, float)) / edges
    found = np.concatenate(
        [points[np.unique(mesh.faces)], sample_triangles(points, mesh.faces, 0.25)]
    )
    # half a voxel beyond counts as the voxel at the rim, on which the surface then lies
    near = ((found > -0.5) & (found < np.array(sides) + 0.5)).all(axis=1)
    if not near.any():
        raise InputError(
            "the painted mesh lies outside of the part: give both in the same coordinates"
        )
    at = np.clip(np.floor(found[near]).astype(np.int64), 0, np.array(sides) - 1)
    marked = np.zeros(sides, bool)
    marked[tuple(at.T)] = True
    return marked


def scale_mesh(mesh: Mesh, factor: float, *, unit: str | None = None) -> Mesh:
    """Scale the coordinates of a mesh by `factor` (above 0); `unit` replaces its unit."""
    factor = as_number(factor, name="scale", low=1e-18, high=1e18)
    unit = mesh.unit if unit is None else unit
    vertices = mesh.vertices.astype(np.float64) * factor
    recipe = mesh.recipe.then("scale", vertices, factor=factor, unit=unit)
    return replace(mesh, vertices=vertices, unit=unit, recipe=recipe)


def fit_mesh(
    mesh: Mesh,
    *,
    shape: int | Sequence[int],
    spacing: float | Sequence[float],
    unit: str | None = None,
) -> Mesh:
    """Scale a mesh equally along every axis so that it just fits into a box of voxels.

    Parameters
    ----------
    mesh : Mesh
    shape : int or sequence of int
        Voxels of the box along z, y, x.
    spacing : float or sequence of float
        Edge of a voxel along z, y, x.
    unit : str, optional
        Unit of the spacing, and of the result. Default: the mesh's.
    """
    box = np.array(as_shape(shape)) * as_spacing(spacing, ndim=3)
    low, high = _bounds(mesh)
    extent = (high - low)[::-1]
    if not extent.max() > 0:
        raise InputError("the mesh is a single point: it cannot be scaled to a box")
    return scale_mesh(mesh, float(np.min(box[extent > 0] / extent[extent > 0])), unit=unit)


def _weld_if_open(mesh: Mesh) -> Mesh:
    """Return the mesh, its vertices welded where it is closed only then; raise where it stays open.

    Files split vertices, as at the seams of a texture.
    """
    try:
        check_closed(mesh)
    except InputError:
        vertices, faces = weld(mesh.vertices[mesh.faces])
        mesh = replace(mesh, vertices=vertices, faces=faces)
        check_closed(mesh)
    return mesh


def _bounds(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Return lowest and highest x, y, z of the surface, without vertices that no face uses."""
    if not len(mesh.faces):
        raise InputError("the mesh has no faces: there is nothing inside")
    used = mesh.vertices[np.unique(mesh.faces)].astype(np.float64)
    return used.min(axis=0), used.max(axis=0)


def _grid(
    low: np.ndarray,
    high: np.ndarray,
    edges: tuple[float, ...],
    shape: int | Sequence[int] | None,
    margin: int,
    origin: Sequence[float] | None,
) -> tuple[tuple[int, ...], np.ndarray]:
    """Return the voxels along z, y, x, and the corner of voxel (0, 0, 0)."""
    margin = int(as_number(margin, name="margin", low=0, high=4096, whole=True))
    if shape is not None and margin:
        raise InputError("give a shape or a margin, not both: a shape says how much room there is")
    start = None if origin is None else np.array(origin, np.float64)
    if start is not None and (start.shape != (3,) or not np.isfinite(start).all()):
        raise InputError(
            f"origin {quote(origin)} is not made of three finite numbers: give z, y, x"
        )
    # A hair less than the extent: a float32 file turns n voxels into n + 1e-6, which are n.
    hair = 1e-6 * np.maximum(np.abs(low), np.abs(high))
    extent = (high - (low if start is None else start) - hair) / edges
    need = np.maximum(np.ceil(extent - 1e-9), 1) + (2 if start is None else 1) * margin
    sides = as_shape(
        [int(side) for side in need] if shape is None else shape, name="shape of the voxels"
    )
    if start is not None:
        return sides, start
    if any(n > side for n, side in zip(need, sides, strict=True)):
        raise InputError(
            f"the mesh is {_size(high - low)} wide (z, y, x) and needs {_size(need)} voxels, the "
            f"shape is {sides}: request a larger shape, or scale the mesh"
        )
    return sides, (low + high) / 2 - np.array(sides) * edges / 2


def _size(lengths: Sequence[float] | np.ndarray) -> str:
    return " x ".join(f"{length:.6g}" for length in lengths)
