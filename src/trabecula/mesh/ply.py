"""Binary little-endian PLY; unit and recipe stand in comments."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trabecula.mesh.base import Mesh
from trabecula.mesh.formats import recipe_json

_FACE = np.dtype([("count", "u1"), ("vertices", "<i4", 3)])


def write(mesh: Mesh, path: Path) -> None:
    """Write `mesh` in its unit."""
    double = mesh.vertices.dtype == np.float64
    axes = "".join(f"property {'double' if double else 'float'} {axis}\n" for axis in "xyz")
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"comment unit {mesh.unit}\ncomment trabecula recipe {recipe_json(mesh)}\n"
        f"element vertex {len(mesh.vertices)}\n{axes}"
        f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(mesh.faces), _FACE)
    faces["count"], faces["vertices"] = 3, mesh.faces
    with path.open("wb") as file:
        file.write(header.encode("ascii", "replace"))
        file.write(mesh.vertices.astype("<f8" if double else "<f4", copy=False).tobytes())
        file.write(faces.tobytes())
