"""OpenFOAM: a folder with the voxels as polyMesh and the dictionaries of a flow (.foam).

Files of the mesh as the User Guide has them: points, faces, owner, neighbour, boundary.
Inner faces come first, by their owner and then by their neighbour, which is the higher number; then
the faces of one patch after the other. Normals point out of the owner. Voxels are numbered in
raster order, so all of it is written plane by plane.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Self, TextIO

import numpy as np

from trabecula.mesh.bricks.context import ExportContext
from trabecula.mesh.bricks.faces import AXES
from trabecula.mesh.bricks.grid import BrickGrid, BrickLayer
from trabecula.mesh.bricks.openfoam_case import WALLS, FoamPatch, foam_header, write_case
from trabecula.mesh.text import format_rows, metres

_COUNT = 12
"""Characters for a count that is known at the end."""

_CHUNK = 1 << 20

_SIDES = {
    "x_high": ((0, 0, 1), (0, 1, 1), (1, 1, 1), (1, 0, 1)),
    "y_high": ((0, 1, 0), (1, 1, 0), (1, 1, 1), (0, 1, 1)),
    "z_high": ((1, 0, 0), (1, 0, 1), (1, 1, 1), (1, 1, 0)),
    "x_low": ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)),
    "y_low": ((0, 0, 0), (0, 0, 1), (1, 0, 1), (1, 0, 0)),
    "z_low": ((0, 0, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1)),
}
"""Corners (z, y, x) of the faces of a voxel; the normal points out of it."""

_INNER = ("x_high", "y_high", "z_high")
"""Faces to neighbours of a higher number, in the order of these numbers."""


def write(grid: BrickGrid, path: Path, context: ExportContext) -> None:
    """Write the case: two passes over the voxels."""
    mesh = path / "constant" / "polyMesh"
    mesh.mkdir(parents=True)
    scale = metres(context.unit)
    _write_points(grid, mesh, 1.0 if scale is None else scale)
    patches = _write_faces(grid, mesh, context.axis)
    write_case(grid, path, patches, context, 1.0 if scale is None else scale)


def _write_points(grid: BrickGrid, mesh: Path, scale: float) -> None:
    with FoamList(mesh / "points", "vectorField") as points:
        for k, numbers in grid.node_layers():
            points.add("(%.9g %.9g %.9g)\n", grid.coordinates(k, numbers, scale))


def _write_faces(grid: BrickGrid, mesh: Path, axis: int) -> list[FoamPatch]:
    """Write faces, owners and neighbours; return the patches."""
    names = patch_names(axis)
    with ExitStack() as stack:
        faces, owner, neighbour = (
            stack.enter_context(FoamList(mesh / name, kind))
            for name, kind in (
                ("faces", "faceList"),
                ("owner", "labelList"),
                ("neighbour", "labelList"),
            )
        )
        outer = {
            name: [stack.enter_context(FoamPart(mesh / f"{file}.{name}")) for file in _OUTER]
            for name in (*names.values(), WALLS)
        }
        for layer, around in _with_neighbours(grid):
            nodes, inner, others = _inner_faces(layer, around)
            faces.add(_FACE, nodes)
            owner.add("%d\n", inner)
            neighbour.add("%d\n", others)
            for side, beyond in around.items():
                nodes, cells, on_box = _outer_faces(layer, side, beyond)
                for name, chosen in ((names[side], on_box), (WALLS, ~on_box)):
                    outer[name][0].add(_FACE, nodes[chosen])
                    outer[name][1].add("%d\n", cells[chosen])
        patches = []
        for name, (face_part, owner_part) in outer.items():
            patches.append(FoamPatch(name, faces.count, face_part.count))
            faces.append(face_part)
            owner.append(owner_part)
    return patches


_FACE = "4(%d %d %d %d)\n"
_OUTER = ("faces", "owner")
_BOX = -2
"""Beyond the box, where a cell has no neighbour; -1 stands for a voxel that is no cell."""


def patch_names(axis: int) -> dict[str, str]:
    """Return the patch of every face of the box: the flow enters at the lower end of its axis."""
    found = {side: f"side_{side}" for side in _SIDES}
    return found | {f"{AXES[axis]}_low": "inlet", f"{AXES[axis]}_high": "outlet"}


def _with_neighbours(grid: BrickGrid) -> Iterator[tuple[BrickLayer, dict[str, np.ndarray]]]:
    """Yield every layer, and by side the numbers of the cells beyond that side, (Y, X)."""
    layers = grid.layers()
    here: BrickLayer | None = next(layers)
    shape = (grid.volume.shape[1], grid.volume.shape[2])
    below = np.full(shape, _BOX, np.int64)
    while here is not None:
        above = next(layers, None)
        cells = _cells(here)
        framed = np.pad(cells, 1, constant_values=_BOX)
        upper = np.full(shape, _BOX, np.int64) if above is None else _cells(above)
        yield (
            here,
            {
                "x_high": framed[1:-1, 2:],
                "y_high": framed[2:, 1:-1],
                "z_high": upper,
                "x_low": framed[1:-1, :-2],
                "y_low": framed[:-2, 1:-1],
                "z_low": below,
            },
        )
        here, below = above, cells


def _cells(layer: BrickLayer) -> np.ndarray:
    """Return the numbers of the cells of a layer, (Y, X), -1 where there is none."""
    found = np.full(layer.members.shape, -1, np.int64)
    inside = layer.members >= 0
    found[inside] = np.arange(layer.first, layer.first + np.count_nonzero(inside))
    return found


def _corner_nodes(layer: BrickLayer, side: str, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the nodes of one face of cells, (cells, 4)."""
    return np.stack([(layer.low, layer.high)[k][y + j, x + i] for k, j, i in _SIDES[side]], axis=1)


def _inner_faces(
    layer: BrickLayer, around: dict[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nodes, owners and neighbours of the faces to cells of higher numbers."""
    y, x = layer.places
    others = np.stack([around[side][y, x] for side in _INNER], axis=1)
    nodes = np.stack([_corner_nodes(layer, side, y, x) for side in _INNER], axis=1)
    owners = np.repeat(layer.first + np.arange(len(y)), 3).reshape(-1, 3)
    inside = others >= 0
    return nodes[inside], owners[inside], others[inside]


def _outer_faces(
    layer: BrickLayer, side: str, beyond: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return nodes and cells of the faces that no other cell has, and which lie on the box."""
    y, x = layer.places
    other = beyond[y, x]
    outer = other < 0
    nodes = _corner_nodes(layer, side, y[outer], x[outer])
    return nodes, layer.first + np.flatnonzero(outer), other[outer] == _BOX


class FoamPart:
    """Rows of a list that are written beside it, and are appended to it at the end."""

    def __init__(self, path: Path) -> None:
        self.path, self.count = path, 0
        self._file = path.open("w", encoding="ascii", newline="\n")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()
        self.path.unlink(missing_ok=True)

    def add(self, template: str, rows: np.ndarray) -> None:
        """Append rows."""
        self._file.writelines(format_rows(template, rows))
        self.count += len(rows)

    def copy_to(self, file: TextIO) -> None:
        """Copy all rows to another file."""
        self._file.close()
        with self.path.open(encoding="ascii") as rows:
            shutil.copyfileobj(rows, file, _CHUNK)


class FoamList:
    """A list of OpenFOAM that is written row by row; its count is filled in at the end."""

    def __init__(self, path: Path, kind: str) -> None:
        self.count = 0
        self._file = path.open("w", encoding="ascii", newline="\n")
        self._file.write(foam_header(kind, path.name, location="constant/polyMesh"))
        self._at = self._file.tell()
        self._file.write(" " * _COUNT + "\n(\n")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.write(")\n")
        self._file.seek(self._at)
        self._file.write(f"{self.count:<{_COUNT}d}")
        self._file.close()

    def add(self, template: str, rows: np.ndarray) -> None:
        """Append rows."""
        self._file.writelines(format_rows(template, rows))
        self.count += len(rows)

    def append(self, part: FoamPart) -> None:
        """Append what was written beside."""
        part.copy_to(self._file)
        self.count += part.count
