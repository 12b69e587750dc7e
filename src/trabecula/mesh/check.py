"""`check`: closedness, orientation and size of a surface."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from trabecula.core.errors import InputError
from trabecula.mesh import kernels
from trabecula.mesh.base import Mesh


@dataclass(frozen=True)
class MeshCheck:
    """Findings on a mesh; lengths in `unit`.

    Parameters
    ----------
    watertight : bool
        Every edge is in exactly two faces, which run through it in opposite directions.
    open_edges, crowded_edges, twisted_edges : int
        Edges of one face; of more than two; of two faces in the same direction.
    degenerate_faces : int
        Faces that name a vertex twice or have no area.
    components : int
        Connected components of the surface (a hollow part has two: outside and inside).
    volume, area : float
        Enclosed volume in unit**3 (meaningful where watertight), surface in unit**2.
    bounds : ((x, y, z), (x, y, z))
        Lowest and highest coordinates.
    """

    vertices: int
    faces: int
    watertight: bool
    open_edges: int
    crowded_edges: int
    twisted_edges: int
    degenerate_faces: int
    components: int
    volume: float
    area: float
    bounds: tuple[tuple[float, ...], tuple[float, ...]]
    unit: str

    def to_json(self) -> dict[str, Any]:
        """Return the findings as plain JSON."""
        return asdict(self)


def check(mesh: Mesh) -> MeshCheck:
    """Check closedness, orientation, components, volume and area of a mesh.

    Parameters
    ----------
    mesh : Mesh

    Returns
    -------
    MeshCheck
    """
    single, crowded, twisted = _edge_faults(mesh.faces, len(mesh.vertices))
    volume, area, flat = _extent(mesh)
    used = np.zeros(len(mesh.vertices), bool)
    used[mesh.faces] = True
    points = mesh.vertices[used].astype(np.float64) if used.any() else np.zeros((1, 3))
    return MeshCheck(
        vertices=len(mesh.vertices),
        faces=len(mesh.faces),
        watertight=len(mesh.faces) > 0 and not single and not crowded and not twisted,
        open_edges=single,
        crowded_edges=crowded,
        twisted_edges=twisted,
        degenerate_faces=flat,
        components=_components(mesh, used),
        volume=volume,
        area=area,
        bounds=(tuple(points.min(axis=0).tolist()), tuple(points.max(axis=0).tolist())),
        unit=mesh.unit,
    )


def _edge_faults(faces: np.ndarray, count: int) -> tuple[int, int, int]:
    """Count the edges of one face, of more than two, and of two in the same direction."""
    ends = np.concatenate([faces[:, (0, 1)], faces[:, (1, 2)], faces[:, (2, 0)]]).astype(np.int64)
    # One integer an edge: its ends, sorted, and in the last bit the direction. Integers sort far
    # faster than rows.
    keys = (ends.min(axis=1) * count + ends.max(axis=1)) * 2 + (ends[:, 0] > ends[:, 1])
    keys.sort()
    if not len(keys):
        return 0, 0, 0
    starts = np.flatnonzero(np.concatenate([[True], np.diff(keys >> 1) != 0]))
    uses = np.diff(np.append(starts, len(keys)))
    backward = np.add.reduceat(keys & 1, starts)
    return int(np.sum(uses == 1)), int(np.sum(uses > 2)), int(np.sum((uses == 2) & (backward != 1)))


def _extent(mesh: Mesh) -> tuple[float, float, int]:
    """Return volume (divergence theorem), area, and the number of faces without area."""
    if not len(mesh.faces):
        return 0.0, 0.0, 0
    # Relative to the middle, so that far-off coordinates do not cancel.
    points = mesh.vertices.astype(np.float64) - mesh.vertices.mean(axis=0, dtype=np.float64)
    a, b, c = points[mesh.faces[:, 0]], points[mesh.faces[:, 1]], points[mesh.faces[:, 2]]
    normal = np.cross(b - a, c - a)
    double = np.sqrt(np.einsum("ij,ij->i", normal, normal))
    return (
        float(np.einsum("ij,ij->", a, normal) / 6),
        float(double.sum() / 2),
        int(np.sum(double == 0)),
    )


def _components(mesh: Mesh, used: np.ndarray) -> int:
    """Count the connected components of the surface."""
    parent = np.arange(len(mesh.vertices), dtype=np.int32)
    kernels.unite(mesh.faces, parent)
    return int(np.sum(used & (parent == np.arange(len(parent)))))


def check_closed(mesh: Mesh) -> None:
    """Raise where a mesh has no inside: faces run through an edge more often in one direction.

    Less strict than watertight: solids that touch along an edge are closed.

    Raises
    ------
    InputError
        The mesh is not closed; names the faults and the remedy.
    """
    ends = np.concatenate(
        [mesh.faces[:, (0, 1)], mesh.faces[:, (1, 2)], mesh.faces[:, (2, 0)]]
    ).astype(np.int64)
    edges = ends.min(axis=1) * len(mesh.vertices) + ends.max(axis=1)
    order = np.argsort(edges, kind="stable")
    starts = np.flatnonzero(np.diff(edges[order], prepend=-1))
    if not np.add.reduceat(np.where(ends[:, 0] < ends[:, 1], 1, -1)[order], starts).any():
        return
    found = check(mesh)
    faults = [
        f"{count} {what}"
        for count, what in (
            (found.open_edges, "edges of one face only (holes)"),
            (found.crowded_edges, "edges of more than two faces"),
            (found.twisted_edges, "edges whose two faces disagree on which side is outside"),
        )
        if count
    ]
    raise InputError(
        f"the mesh is not watertight, so it has no inside: {', '.join(faults)} of {len(starts)}; "
        "fill the holes and make the faces point outwards (repair it in a mesh editor or a "
        "slicer), or give the form as a volume"
    )
