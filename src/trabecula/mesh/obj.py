"""Wavefront OBJ; unit and recipe are comments."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trabecula.mesh.base import Mesh
from trabecula.mesh.text import format_rows, parse_unit, recipe_json
from trabecula.mesh.weld import fan_triangles


def write(mesh: Mesh, path: Path) -> None:
    """Write `mesh` in its unit; OBJ counts vertices from 1."""
    with path.open("w", encoding="ascii", errors="replace", newline="\n") as file:
        file.write(f"# trabecula\n# unit {mesh.unit}\n# recipe {recipe_json(mesh.recipe)}\n")
        file.writelines(format_rows("v %.7g %.7g %.7g\n", mesh.vertices))
        file.writelines(format_rows("f %d %d %d\n", mesh.faces, offset=1))


def read(path: Path) -> Mesh:
    """Read vertices and faces, and ignore the rest; polygons become fans of triangles."""
    points: list[list[bytes]] = []
    corners: list[int] = []
    counts: list[int] = []
    unit = None
    for line in path.read_bytes().splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == b"v":
            points.append(words[1:4])
        elif words[0] == b"f":
            # vertex/texture/normal; a negative number counts back from the vertices so far.
            numbers = [int(word.split(b"/")[0]) for word in words[1:]]
            if 0 in numbers:
                raise ValueError("a face names vertex 0, the first is 1")
            corners += [number - 1 if number > 0 else len(points) + number for number in numbers]
            counts.append(len(numbers))
        elif words[:2] == [b"#", b"unit"] and len(words) == 3:
            unit = words[2].decode("latin-1")
    vertices = np.array(points).astype(np.float64).reshape(-1, 3)
    faces = fan_triangles(np.array(counts, np.int64), np.array(corners, np.int64))
    return Mesh(vertices, faces, parse_unit(unit))
