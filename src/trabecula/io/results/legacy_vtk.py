"""Legacy VTK (.vtk) of unstructured grids and structured points, text or binary (big-endian).

Format: VTK File Formats, "Simple Legacy Formats"; versions up to 4.2 store cells as rows of counts
and points, 5.1 as offsets and connectivity.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np

from trabecula.core.errors import InputError
from trabecula.io.guard import check_claim
from trabecula.io.results.content import RegularGrid, ResultArray, SolverResult, group_cells

_TYPES = {
    "unsigned_char": "u1",
    "char": "i1",
    "unsigned_short": "u2",
    "short": "i2",
    "unsigned_int": "u4",
    "int": "i4",
    "unsigned_long": "u8",
    "long": "i8",
    "vtktypeint64": "i8",
    "vtktypeuint64": "u8",
    "float": "f4",
    "double": "f8",
}


@dataclass
class _LegacyText:
    """The bytes of a file and the place up to which they are read."""

    path: Path
    raw: bytes
    binary: bool = False
    at: int = 0

    def line(self) -> list[str]:
        """Return the words of the next line that has any; none at the end."""
        while self.at < len(self.raw):
            end = self.raw.find(b"\n", self.at)
            end = len(self.raw) if end < 0 else end
            words = self.raw[self.at : end].decode("latin-1").split()
            self.at = end + 1
            if words:
                return words
        return []

    def numbers(self, count: int, name: str) -> np.ndarray:
        """Return the next numbers of a type."""
        dtype = np.dtype(_TYPES[name.lower()]).newbyteorder(">")
        room = len(self.raw) * (1 if self.binary else 4)
        if not count:
            return np.zeros(0, dtype)
        check_claim(self.path, (count,), dtype, stored=room)
        if self.binary:
            size = count * dtype.itemsize
            found = np.frombuffer(self.raw[self.at : self.at + size], dtype)
            self.at += size
            if len(found) != count:
                raise ValueError(f"it ends within {count} numbers")
            return found
        words: list[str] = []
        while len(words) < count:
            more = self.line()
            if not more:
                raise ValueError(f"it ends within {count} numbers")
            words += more
        if len(words) != count:
            raise ValueError(f"it holds {len(words)} numbers where {count} belong")
        return np.array(words, np.float64 if dtype.kind == "f" else np.int64)


def open_result(path: Path) -> SolverResult:
    """Open a legacy .vtk (see `io.results.open_result`)."""
    text = _LegacyText(path, path.read_bytes())
    if not text.raw.startswith(b"# vtk DataFile"):
        raise ValueError("it does not begin with '# vtk DataFile'")
    text.at = text.raw.index(b"\n", text.raw.index(b"\n") + 1) + 1  # version and title
    text.binary = text.line() == ["BINARY"]
    words = text.line()
    kind = words[1].upper() if len(words) > 1 and words[0].upper() == "DATASET" else ""
    if kind == "UNSTRUCTURED_GRID":
        return _open_mesh(text)
    if kind == "STRUCTURED_POINTS":
        return _open_grid(text)
    raise InputError(
        f"{path} holds {kind or 'no data set'}: UNSTRUCTURED_GRID and STRUCTURED_POINTS are read"
    )


def _open_mesh(text: _LegacyText) -> SolverResult:
    points = connectivity = offsets = types = None
    while words := text.line():
        head = words[0].upper()
        if head == "FIELD":
            _skip_field(text, int(words[2]))
        elif head == "POINTS":
            points = text.numbers(3 * int(words[1]), words[2]).reshape(-1, 3).astype(np.float64)
        elif head == "CELLS":
            connectivity, offsets = _read_cells(text, int(words[1]), int(words[2]))
        elif head == "CELL_TYPES":
            types = text.numbers(int(words[1]), "int")
        elif head in ("POINT_DATA", "CELL_DATA"):
            break
    if points is None or connectivity is None or offsets is None or types is None:
        raise ValueError("it holds no points, cells or types of cells")
    blocks = group_cells(connectivity, offsets, types, len(points))
    arrays = _read_arrays(text, words)
    return SolverResult(text.path, "legacy VTK", arrays, points=points, blocks=blocks)


def _read_cells(text: _LegacyText, count: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of all cells, and where each cell ends among them."""
    start = text.at
    words = text.line()
    if words and words[0].upper() == "OFFSETS":
        # version 5.1: one offset more than cells
        offsets = text.numbers(count, words[1]).astype(np.int64)
        words = text.line()
        return text.numbers(size, words[1]).astype(np.int64), offsets[1:]
    text.at = start
    rows = text.numbers(size, "int").astype(np.int64)
    starts, at = np.empty(count, np.int64), 0
    for cell in range(count):  # each row says how long it is
        if at >= len(rows) or rows[at] < 0:
            raise ValueError("its cells are longer than their list")
        starts[cell] = at
        at += int(rows[at]) + 1
    keep = np.ones(len(rows), bool)
    keep[starts] = False
    return rows[keep], np.append(starts[1:], at) - np.arange(1, count + 1)


def _open_grid(text: _LegacyText) -> SolverResult:
    given: dict[str, list[str]] = {}
    while (words := text.line()) and words[0].upper() not in ("POINT_DATA", "CELL_DATA"):
        given[words[0].upper()] = words[1:]
    points = [int(word) for word in given["DIMENSIONS"]]
    if len(points) != 3 or min(points) < 1:
        raise ValueError("its dimensions are not three numbers")
    spacing = [float(word) for word in given.get("SPACING", given.get("ASPECT_RATIO", ["1"] * 3))]
    origin = [float(word) for word in given.get("ORIGIN", ["0"] * 3)]
    cells = [side - 1 for side in points]
    if min(cells) < 1:
        raise InputError(f"{text.path} is flat: a volume is needed, three axes of cells")
    sizes = {"points": prod(points), "cells": prod(cells)}
    arrays = _read_arrays(text, words)
    for one in arrays:
        if len(one.load()) != sizes[one.place]:
            raise ValueError(f"{one.name} has another count than its grid")
    lattice = RegularGrid(
        (origin[0], origin[1], origin[2]),
        (spacing[0], spacing[1], spacing[2]),
        (cells[2], cells[1], cells[0]),
    )
    return SolverResult(text.path, "legacy VTK", arrays, lattice=lattice)


def _read_arrays(text: _LegacyText, words: list[str]) -> tuple[ResultArray, ...]:
    """Read the arrays from the line POINT_DATA or CELL_DATA on."""
    found: list[ResultArray] = []
    place, count = "points", 0

    def add(name: str, components: int, kind: str, size: int) -> None:
        values = text.numbers(size * components, kind).reshape(size, components)
        found.append(ResultArray(name, place, components, lambda: values))

    while words:
        head = words[0].upper()
        if head in ("POINT_DATA", "CELL_DATA"):
            place, count = ("points" if head == "POINT_DATA" else "cells"), int(words[1])
        elif head == "SCALARS":
            start = text.at
            if (text.line() or [""])[0].upper() != "LOOKUP_TABLE":
                text.at = start
            add(words[1], int(words[3]) if len(words) > 3 else 1, words[2], count)
        elif head in ("VECTORS", "NORMALS"):
            add(words[1], 3, words[2], count)
        elif head == "TENSORS":
            add(words[1], 9, words[2], count)
        elif head == "FIELD":
            for _ in range(int(words[2])):
                name, components, size, kind = text.line()[:4]
                add(name, int(components), kind, int(size))
        elif head == "METADATA":
            while (start := text.raw.find(b"\n", text.at)) >= 0:
                blank = not text.raw[text.at : start].strip()
                text.at = start + 1
                if blank:
                    break
        elif head != "LOOKUP_TABLE":
            raise ValueError(f"it has a section {words[0][:20]!r} that is not known")
        words = text.line()
    return tuple(found)


def _skip_field(text: _LegacyText, arrays: int) -> None:
    for _ in range(arrays):
        _, components, size, kind = text.line()[:4]
        text.numbers(int(components) * int(size), kind)
