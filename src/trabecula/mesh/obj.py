"""Wavefront OBJ; unit and recipe stand in comments."""

from __future__ import annotations

from pathlib import Path

from trabecula.mesh.base import Mesh
from trabecula.mesh.formats import recipe_json
from trabecula.mesh.text import rows


def write(mesh: Mesh, path: Path) -> None:
    """Write `mesh` in its unit; OBJ counts vertices from 1."""
    with path.open("w", encoding="ascii", errors="replace", newline="\n") as file:
        file.write(f"# trabecula\n# unit {mesh.unit}\n# recipe {recipe_json(mesh)}\n")
        file.writelines(rows("v %.7g %.7g %.7g\n", mesh.vertices))
        file.writelines(rows("f %d %d %d\n", mesh.faces, offset=1))
