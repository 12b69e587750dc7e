"""`decimate`: fewer triangles, nowhere farther from the surface than a tolerance.

Edges collapse into the point with the least squared distance to the planes of the triangles that
went into them (Garland and Heckbert 1997, doi:10.1145/258734.258849), the cheapest first, in passes
of rising cost. A collapse is done only if

- the surface stays closed and of its topology (Dey, Edelsbrunner, Guha and Nekhayev 1999: the ends
  have two neighbours in common and no more),
- no triangle turns over or becomes a needle,
- samples of the new triangles lie within the tolerance of the surface, and every vertex of the
  surface that was next to the old ones lies within it of the new ones (Klein, Liebich and Strasser
  1996, doi:10.1109/VISUAL.1996.568124).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.progress import report
from trabecula.engine.memory import Plan, check_budget
from trabecula.mesh.base import Mesh
from trabecula.mesh.check import check
from trabecula.mesh.collapse import Surface, collapse_edges, compact, limits_of
from trabecula.mesh.triangle_grid import distances_to, sample_triangles, triangle_grid

# of the squared tolerance: the most that a collapse may cost, in the passes one after the other
_COSTS = (1e-4, 3e-3, 0.02, 0.06, 0.15, 0.4)
_WORTH = 0.02  # of the faces that a pass has to take away for another one at the same cost
_INNER = 0.75  # of the tolerance: between samples the distance may be larger
_BYTES = 400  # a face


@dataclass(frozen=True)
class SurfaceDistance:
    """Distances between two surfaces, measured at samples of both, in the unit of the mesh.

    Attributes
    ----------
    there, back : float
        Largest distance of the first surface to the second, and of the second to the first.
    mean : float
        Of all samples of both.
    """

    there: float
    back: float
    mean: float


def decimate(mesh: Mesh, tolerance: float) -> Mesh:
    """Return a surface of fewer triangles.

    Parameters
    ----------
    mesh : Mesh
        Closed, as `tb.mesh` makes it.
    tolerance : float
        Largest distance from the surface, in the mesh's unit, above 0.

    Returns
    -------
    Mesh
        Closed, with the components and holes of the surface; the same for any number of threads.

    Raises
    ------
    InputError
        A surface that is not closed, or a tolerance that is not above 0.
    MemoryBudgetError
        The work would not fit into memory.

    Notes
    -----
    Triangles of opposite sides of a wall that is thinner than twice the tolerance may cross.
    """
    limit = as_number(tolerance, name="tolerance", low=1e-300, high=1e300)
    if not check(mesh).watertight:
        raise InputError("the surface is not closed, so it cannot be decimated: mend it first")
    check_budget(Plan({"faces": len(mesh.faces) * _BYTES}), advice="mesh a crop")
    vertices = mesh.vertices.astype(np.float64)
    faces = mesh.faces.astype(np.int32)
    edge = float(np.median(np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=1)))
    grid = triangle_grid(vertices, faces, max(limit, edge))
    surface = Surface.of(vertices, faces)
    limits = limits_of(grid, vertices, _INNER * limit)
    for number, cost in enumerate(_COSTS):
        while True:
            before = len(surface.faces)
            gone = collapse_edges(surface, limits, cost * limit**2)
            surface = compact(surface)
            report("decimating", (number + 1) / len(_COSTS))
            if gone < _WORTH * before:
                break
    points = surface.positions.astype(np.float32)
    recipe = mesh.recipe.then("decimate", points, tolerance=limit)
    return Mesh(points, surface.faces, mesh.unit, recipe)


def surface_distance(one: Mesh, other: Mesh, *, spacing: float) -> SurfaceDistance:
    """Measure the distances between two surfaces both ways, at samples `spacing` apart."""
    step = as_number(spacing, name="spacing", low=1e-300, high=1e300)
    ways = []
    for first, second in ((one, other), (other, one)):
        grid = triangle_grid(second.vertices.astype(np.float64), second.faces, 2 * step)
        points = first.vertices.astype(np.float64)
        samples = np.concatenate([points, sample_triangles(points, first.faces, step)])
        ways.append(distances_to(grid, samples))
    mean = float(np.concatenate(ways).mean())
    return SurfaceDistance(float(ways[0].max()), float(ways[1].max()), mean)
