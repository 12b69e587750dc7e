"""Binary STL: 80 bytes of header, a count, 50 bytes a triangle. The format knows no unit; slicers take millimetres."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trabecula.mesh.base import Mesh
from trabecula.mesh.formats import metres, recipe_digest

_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_PIECE = 1 << 18  # triangles at a time: the records of the whole mesh would double the memory


def write(mesh: Mesh, path: Path) -> None:
    """Write `mesh` in millimetres where its unit is a length, as it is otherwise; the header says which."""
    size = metres(mesh)
    unit, factor = (mesh.unit, 1.0) if size is None else ("mm", size * 1000)
    # A header that began with "solid" would be taken for the text form of STL.
    header = f"trabecula, unit={unit}, recipe={recipe_digest(mesh)}".encode("ascii", "replace")[:80].ljust(80)
    with path.open("wb") as file:
        file.write(header + np.uint32(len(mesh.faces)).tobytes())
        for start in range(0, len(mesh.faces), _PIECE):
            file.write(_records(mesh, mesh.faces[start : start + _PIECE], factor).tobytes())


def _records(mesh: Mesh, faces: np.ndarray, factor: float) -> np.ndarray:
    corners = mesh.vertices[faces] * factor
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(np.float64)
    length = np.sqrt(np.einsum("ij,ij->i", normal, normal))[:, None]
    records = np.zeros(len(faces), _TRIANGLE)
    records["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    records["corners"] = corners
    return records
