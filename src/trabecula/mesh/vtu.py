"""VTK UnstructuredGrid (.vtu): bricks or tetrahedra, with the phase of each as cell data.

Cell data "phase" are labels; "material" are labels + 1, the attributes that MFEM reads: it takes
the first array, and only if that is the one named as scalars.
Appended raw bytes, part by part: no array is in memory as a whole. Format: VTK File Formats,
https://docs.vtk.org/en/latest/vtk_file_formats/.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from trabecula.mesh.elements import Elements, write_parts

_TYPES = {8: 12, 4: 10}  # hexahedron, tetrahedron
_AT_ONCE = 1 << 20


def write_vtu(elements: Elements, path: Path) -> None:
    """Write elements: points, cells and phases are read once each, phases twice."""
    nodes, cells, corners = elements.nodes, elements.cells, elements.corners
    index = np.dtype("<i4" if nodes < 2**31 else "<i8")
    blocks: list[tuple[int, Callable[[], Iterator[np.ndarray]]]] = [
        (nodes * 24, lambda: (part.astype("<f8") for part in elements.points())),
        (
            cells * corners * index.itemsize,
            lambda: (part.astype(index) for part in elements.members()),
        ),
        (cells * 8, lambda: _offsets(cells, corners)),
        (cells, lambda: _types(cells, corners)),
        (cells * 4, lambda: (1 + part.astype("<i4") for part in elements.labels())),
        (cells, elements.labels),
    ]
    starts = np.cumsum([0, *(8 + size for size, _ in blocks)]).tolist()
    with path.open("wb") as file:
        file.write(_head(elements, starts, index).encode("ascii"))
        for size, parts in blocks:
            file.write(np.uint64(size).astype("<u8").tobytes())
            write_parts(file, size, parts())
        file.write(b"\n  </AppendedData>\n</VTKFile>\n")


def _head(elements: Elements, starts: list[int], index: np.dtype) -> str:
    # A comment, not field data: of these some readers (meshio) know no text.
    about = {
        "unit": elements.unit,
        **({"shape": elements.shape, "spacing": elements.spacing} if elements.shape else {}),
        "phases": elements.phases,
        "recipe": elements.recipe.to_json(),
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
        f'    <Piece NumberOfPoints="{elements.nodes}" NumberOfCells="{elements.cells}">\n'
        "      <Points>\n"
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


def _offsets(cells: int, corners: int) -> Iterator[np.ndarray]:
    for start in range(0, cells, _AT_ONCE):
        yield corners * np.arange(start + 1, min(start + _AT_ONCE, cells) + 1, dtype="<i8")


def _types(cells: int, corners: int) -> Iterator[np.ndarray]:
    for start in range(0, cells, _AT_ONCE):
        yield np.full(min(_AT_ONCE, cells - start), _TYPES[corners], np.uint8)
