"""Surfaces that trimesh reads, with the extra `mesh`; nothing is written through it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trabecula.core.errors import FileError
from trabecula.core.optional import need
from trabecula.mesh.base import Mesh
from trabecula.mesh.text import parse_unit


def read(path: Path) -> Mesh:
    """Read every body of a scene, each at its place; points and lines are left out.

    Raises
    ------
    MissingExtraError
        trimesh is not installed.
    FileError
        A body without extent: trimesh leaves zeros where it cannot decode.
    """
    trimesh = need("trimesh", extra="mesh", purpose=f"reading {path}")
    scene = trimesh.load_scene(path, process=False)
    for name, body in scene.geometry.items():
        if len(getattr(body, "faces", ())) and not np.ptp(body.vertices, axis=0).any():
            raise FileError(
                f"cannot read {path}: all vertices of {name!r} are at one place; if it is "
                "compressed (Draco), export it without compression"
            )
    surface = scene.to_mesh()
    return Mesh(np.array(surface.vertices), np.array(surface.faces), parse_unit(scene.units))
