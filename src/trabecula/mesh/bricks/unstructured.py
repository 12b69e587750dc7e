"""Bricks as elements of formats that take any cells: .vtu and .msh."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from trabecula.mesh.bricks.context import ExportContext
from trabecula.mesh.bricks.grid import BrickGrid
from trabecula.mesh.elements import Elements
from trabecula.mesh.gmsh import write_msh
from trabecula.mesh.vtu import write_vtu


def write(grid: BrickGrid, path: Path, context: ExportContext) -> None:
    """Write the bricks: a pass over the voxels for each array."""
    writers = {".vtu": write_vtu, ".msh": write_msh}
    elements = Elements(
        grid.count.nodes,
        sum(grid.count.bricks),
        8,
        lambda: (grid.coordinates(k, numbers) for k, numbers in grid.node_layers()),
        lambda: (layer.nodes() for layer in grid.layers()),
        lambda: _labels(grid),
        tuple(grid.volume.phases),
        context.unit,
        context.recipe,
        grid.volume.shape,
        grid.volume.spacing,
    )
    writers[context.suffix](elements, path)


def _labels(grid: BrickGrid) -> Iterator[np.ndarray]:
    """Yield the label of every brick in the volume."""
    labels = np.array([grid.volume.phases.index(name) for name in grid.names], np.uint8)
    for layer in grid.layers():
        yield labels[layer.members[layer.members >= 0]]
