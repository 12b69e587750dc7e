"""VTK UnstructuredGrid (.vtu): bricks as hexahedra, with the phase of each as cell data.

Cell data "phase" are labels; "material" are labels + 1, the attributes that MFEM reads: it takes
the first array, and only if that is the one named as scalars.
Appended raw bytes, plane by plane: no array is in memory as a whole. Format: VTK File Formats,
https://docs.vtk.org/en/latest/vtk_file_formats/.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from trabecula.core.errors import InputError
from trabecula.mesh.bricks.context import ExportContext
from trabecula.mesh.bricks.grid import BrickGrid

_HEXAHEDRON = 12
_AT_ONCE = 1 << 20


def write(grid: BrickGrid, path: Path, context: ExportContext) -> None:
    """Write the bricks: a pass over the voxels for points, cells and phases each."""
    nodes, bricks = grid.count.nodes, sum(grid.count.bricks)
    index = np.dtype("<i4" if nodes < 2**31 else "<i8")
    blocks: list[tuple[int, Callable[[], Iterator[np.ndarray]]]] = [
        (nodes * 24, lambda: _points(grid)),
        (bricks * 8 * index.itemsize, lambda: _cells(grid, index)),
        (bricks * 8, lambda: _offsets(bricks)),
        (bricks, lambda: _types(bricks)),
        (bricks * 4, lambda: (1 + part.astype("<i4") for part in _phases(grid))),
        (bricks, lambda: _phases(grid)),
    ]
    starts = np.cumsum([0, *(8 + size for size, _ in blocks)]).tolist()
    with path.open("wb") as file:
        file.write(_head(grid, context, starts, index).encode("ascii"))
        for size, parts in blocks:
            file.write(np.uint64(size).astype("<u8").tobytes())
            written = sum(file.write(part.tobytes()) for part in parts())
            if written != size:
                raise InputError(
                    "the volume changed while it was read: export it when nothing writes to it"
                )
        file.write(b"\n  </AppendedData>\n</VTKFile>\n")


def _head(grid: BrickGrid, context: ExportContext, starts: list[int], index: np.dtype) -> str:
    nodes, bricks = grid.count.nodes, sum(grid.count.bricks)
    # A comment, not field data: of these some readers (meshio) know no text.
    about = {
        "unit": context.unit,
        "shape": grid.volume.shape,
        "spacing": grid.volume.spacing,
        "phases": grid.volume.phases,
        "recipe": context.recipe.to_json(),
    }
    text = json.dumps({"trabecula": about}).replace("--", "-\\u002d")

    def array(kind: str, name: str, block: int, more: str = "") -> str:
        return (
            f'        <DataArray type="{kind}" Name="{name}"{more} format="appended" '
            f'offset="{starts[block]}"/>\n'
        )

    integer = f"Int{8 * index.itemsize}"
    return (
        f'<?xml version="1.0"?>\n<!-- {text} -->\n<VTKFile type="UnstructuredGrid" version="1.0" '
        'byte_order="LittleEndian" header_type="UInt64">\n  <UnstructuredGrid>\n'
        f'    <Piece NumberOfPoints="{nodes}" NumberOfCells="{bricks}">\n      <Points>\n'
        + array("Float64", "Points", 0, ' NumberOfComponents="3"')
        + "      </Points>\n      <Cells>\n"
        + array(integer, "connectivity", 1)
        + array("Int64", "offsets", 2)
        + array("UInt8", "types", 3)
        + '      </Cells>\n      <CellData Scalars="material">\n'
        + array("Int32", "material", 4)
        + array("UInt8", "phase", 5)
        + "      </CellData>\n    </Piece>\n  </UnstructuredGrid>\n"
        '  <AppendedData encoding="raw">\n   _'
    )


def _points(grid: BrickGrid) -> Iterator[np.ndarray]:
    for k, numbers in grid.node_layers():
        yield grid.coordinates(k, numbers).astype("<f8")


def _cells(grid: BrickGrid, index: np.dtype) -> Iterator[np.ndarray]:
    for layer in grid.layers():
        yield layer.nodes().astype(index)


def _offsets(bricks: int) -> Iterator[np.ndarray]:
    for start in range(0, bricks, _AT_ONCE):
        yield 8 * np.arange(start + 1, min(start + _AT_ONCE, bricks) + 1, dtype="<i8")


def _types(bricks: int) -> Iterator[np.ndarray]:
    for start in range(0, bricks, _AT_ONCE):
        yield np.full(min(_AT_ONCE, bricks - start), _HEXAHEDRON, np.uint8)


def _phases(grid: BrickGrid) -> Iterator[np.ndarray]:
    """Yield the label of every brick in the volume."""
    labels = np.array([grid.volume.phases.index(name) for name in grid.names], np.uint8)
    for layer in grid.layers():
        yield labels[layer.members[layer.members >= 0]]
