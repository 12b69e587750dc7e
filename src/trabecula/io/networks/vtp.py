"""VTK PolyData (.vtp): pores as points, throats as lines, with every column as an array.

Text, since a network is small. Format: VTK File Formats,
https://docs.vtk.org/en/latest/vtk_file_formats/.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from trabecula.engine.files import replacing


def write(tables: Mapping[str, np.ndarray], path: Path) -> list[Path]:
    """Write points, lines and their arrays."""
    places = next(name for name in tables if name.endswith(".coords"))
    links = next((name for name in tables if name.endswith(".conns")), None)
    points = tables[places]
    lines = np.zeros((0, 2), np.int64) if links is None else tables[links]
    of_points = _group(tables, places)
    of_lines = {} if links is None else _group(tables, links)
    with replacing(path) as temporary, temporary.open("w", encoding="ascii", newline="\n") as file:
        file.write(
            '<?xml version="1.0"?>\n'
            '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian">\n  <PolyData>\n'
            f'    <Piece NumberOfPoints="{len(points)}" NumberOfVerts="{len(points)}" '
            f'NumberOfLines="{len(lines)}" NumberOfStrips="0" NumberOfPolys="0">\n'
        )
        # Cells are the vertices first, then the lines: cell data hold both, so the arrays of pores
        # are repeated as point data, and those of throats are 0 at vertices.
        parts = [
            ("PointData", list(_arrays(of_points))),
            ("CellData", list(_arrays({n: _after(len(points), v) for n, v in of_lines.items()}))),
            ("Points", [_array("Points", points)]),
            ("Verts", _cells(np.arange(len(points))[:, None])),
            ("Lines", _cells(lines)),
        ]
        for name, arrays in parts:
            file.write(f"      <{name}>\n{''.join(arrays)}      </{name}>\n")
        file.write("    </Piece>\n  </PolyData>\n</VTKFile>\n")
    return [path]


def _group(tables: Mapping[str, np.ndarray], member: str) -> dict[str, np.ndarray]:
    """Return the columns with the same first word, besides `member` itself."""
    word = member.partition(".")[0] + "."
    return {name: values for name, values in tables.items() if name.startswith(word)}


def _after(count: int, values: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros((count, *values.shape[1:]), values.dtype), values])


def _arrays(columns: Mapping[str, np.ndarray]) -> Iterator[str]:
    for name, values in columns.items():
        yield _array(name, values)


def _cells(members: np.ndarray) -> list[str]:
    ends = members.shape[1] * np.arange(1, len(members) + 1)
    return [_array("connectivity", members.ravel()), _array("offsets", ends)]


def _array(name: str, values: np.ndarray) -> str:
    kind = {"f": "Float64", "b": "UInt8"}.get(values.dtype.kind, "Int64")
    flat = values.astype(np.uint8) if values.dtype == bool else values
    width = 1 if values.ndim == 1 else values.shape[1]
    text = " ".join(map(repr, flat.ravel().tolist()))
    return (
        f'        <DataArray type="{kind}" Name="{name}" NumberOfComponents="{width}" '
        f'format="ascii">{text}</DataArray>\n'
    )
