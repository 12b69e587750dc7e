"""PLY: written little-endian, unit and recipe as comments; read as text and in both byte orders."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from trabecula.mesh.base import Mesh
from trabecula.mesh.text import parse_unit, recipe_json
from trabecula.mesh.weld import fan_triangles

_FACE = np.dtype([("count", "u1"), ("vertices", "<i4", 3)])

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"}
_TYPES |= {
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
}
_TYPES |= {"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def write(mesh: Mesh, path: Path) -> None:
    """Write `mesh` in its unit."""
    double = mesh.vertices.dtype == np.float64
    axes = "".join(f"property {'double' if double else 'float'} {axis}\n" for axis in "xyz")
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"comment unit {mesh.unit}\ncomment trabecula recipe {recipe_json(mesh.recipe)}\n"
        f"element vertex {len(mesh.vertices)}\n{axes}"
        f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(mesh.faces), _FACE)
    faces["count"], faces["vertices"] = 3, mesh.faces
    with path.open("wb") as file:
        file.write(header.encode("ascii", "replace"))
        file.write(mesh.vertices.astype("<f8" if double else "<f4", copy=False).tobytes())
        file.write(faces.tobytes())


@dataclass
class _Element:
    """A table of the file: rows, and columns (name, type, type of the count if it is a list)."""

    name: str
    rows: int
    columns: list[tuple[str, str, str | None]] = field(default_factory=list)


def read(path: Path) -> Mesh:
    """Read any form; polygons become fans of triangles."""
    raw = path.read_bytes()
    order, elements, unit, body = _header(raw)
    source: _Binary | _Text = (
        _Text(raw[body:]) if order == "ascii" else _Binary(raw, body, _ORDERS[order])
    )
    tables = {element.name: source.table(element) for element in elements}
    vertex = tables["vertex"]
    points = np.stack([vertex[axis] for axis in "xyz"], axis=1)
    points = points.astype(
        np.float32 if points.dtype.itemsize <= 4 and points.dtype.kind == "f" else np.float64
    )
    face = tables["face"]
    counts, indices = face["vertex_indices" if "vertex_indices" in face else "vertex_index"]
    return Mesh(points, fan_triangles(counts, indices), unit)


def _header(raw: bytes) -> tuple[str, list[_Element], str, int]:
    """Return the form, the tables, the unit, and the offset of the body."""
    end = raw.find(b"end_header")
    body = raw.find(b"\n", end) + 1
    if not raw.startswith(b"ply") or end < 0 or body == 0:
        raise ValueError("it has no header of PLY")
    order, unit, elements = "", "voxel", list[_Element]()
    for words in (line.split() for line in raw[:end].decode("latin-1").splitlines()):
        match words:
            case ["format", order, *_]:
                pass
            case ["comment", "unit", unit]:
                pass
            case ["element", name, rows]:
                elements.append(_Element(name, int(rows)))
            case ["property", "list", counts, values, name]:
                elements[-1].columns.append((name, _TYPES[values], _TYPES[counts]))
            case ["property", values, name]:
                elements[-1].columns.append((name, _TYPES[values], None))
    if order not in _ORDERS or any(element.rows < 0 for element in elements):
        raise ValueError(f"its header has the format {order!r}")
    for element in elements:
        if element.rows > len(raw):
            raise ValueError(f"its header claims {element.rows} rows, it has {len(raw)} bytes")
    return order, elements, parse_unit(unit), body


class _Binary:
    """The tables of a binary body, one after another. A list is (counts, all values)."""

    def __init__(self, raw: bytes, at: int, order: str) -> None:
        self.raw, self.at, self.order = raw, at, order

    def table(self, element: _Element) -> dict:
        """Return the columns by name.

        Read at once where all lists of a column are as long as its first, else row by row.
        """
        lengths = self._first_lengths(element)
        parts: list[tuple] = []
        for k, (_, values, counts) in enumerate(element.columns):
            parts += [(f"count{k}", self.order + counts)] if counts else []
            parts += [
                (f"value{k}", self.order + values, (lengths[k],))
                if counts
                else (f"value{k}", self.order + values)
            ]
        dtype = np.dtype(parts)
        if self.at + element.rows * dtype.itemsize <= len(self.raw):
            rows = np.frombuffer(self.raw, dtype, element.rows, self.at)
            lists = [k for k, column in enumerate(element.columns) if column[2]]
            if all((rows[f"count{k}"] == lengths[k]).all() for k in lists):
                self.at += rows.nbytes
                return {
                    name: (rows[f"count{k}"].astype(np.int64), rows[f"value{k}"].ravel())
                    if counts
                    else rows[f"value{k}"]
                    for k, (name, _, counts) in enumerate(element.columns)
                }
        return self._row_by_row(element)

    def _first_lengths(self, element: _Element) -> list[int]:
        at, lengths = self.at, []
        for _, values, counts in element.columns:
            length = 1
            if counts and element.rows:
                length = int(np.frombuffer(self.raw, self.order + counts, 1, at)[0])
                at += np.dtype(counts).itemsize
            lengths.append(length)
            at += length * np.dtype(values).itemsize
        return lengths

    def _row_by_row(self, element: _Element) -> dict:
        counts_of: list[list[int]] = [[] for _ in element.columns]
        chunks: list[list[np.ndarray]] = [[] for _ in element.columns]
        for _ in range(element.rows):
            for k, (_, values, counts) in enumerate(element.columns):
                length = int(self._take(counts, 1)[0]) if counts else 1
                counts_of[k].append(length)
                chunks[k].append(self._take(values, length))
        return {
            name: (np.array(counts_of[k], np.int64), np.concatenate(chunks[k]))
            if counts
            else np.concatenate(chunks[k])
            for k, (name, _, counts) in enumerate(element.columns)
        }

    def _take(self, kind: str, count: int) -> np.ndarray:
        found = np.frombuffer(self.raw, self.order + kind, count, self.at)
        self.at += found.nbytes
        return found


class _Text:
    """The tables of a text body: the numbers of the binary form, separated by white space."""

    def __init__(self, body: bytes) -> None:
        self.numbers = np.array(body.split(), dtype=object)
        self.at = 0

    def table(self, element: _Element) -> dict:
        """Return the columns by name."""
        found: list[list] = [[] for _ in element.columns]
        counts_of: list[list[int]] = [[] for _ in element.columns]
        for _ in range(element.rows):
            for k, (_, _, counts) in enumerate(element.columns):
                length = 1
                if counts:
                    length = int(self.numbers[self.at])
                    self.at += 1
                if self.at + length > len(self.numbers):
                    raise ValueError(f"its {element.name} table ends early")
                counts_of[k].append(length)
                found[k].extend(self.numbers[self.at : self.at + length])
                self.at += length
        columns = {}
        for k, (name, values, counts) in enumerate(element.columns):
            column = np.array(found[k], dtype="S").astype(values if values[0] == "f" else "i8")
            columns[name] = (np.array(counts_of[k], np.int64), column) if counts else column
        return columns
