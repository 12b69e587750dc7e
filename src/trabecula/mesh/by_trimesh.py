"""Surfaces that trimesh reads, with the extra `mesh`; nothing is written through it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trabecula.core.optional import need
from trabecula.mesh.base import Mesh
from trabecula.mesh.text import parse_unit


def read(path: Path) -> Mesh:
    """Read every body of a scene, each at its place; points and lines are left out."""
    trimesh = need("trimesh", extra="mesh", purpose=f"reading {path}")
    scene = trimesh.load_scene(path, process=False)
    surface = scene.to_mesh()
    return Mesh(np.array(surface.vertices), np.array(surface.faces), parse_unit(scene.units))
