"""Results of CalculiX (.frd) as text: nodes, elements, and the last step's values on nodes.

Columns are fixed, so numbers may touch. Every result is a block "-4 NAME components", a "-5" line
for each component, and a "-1" line for each node, which "-2" lines continue. Format: cgx manual,
"Result Format"; https://www.dhondt.de.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from trabecula.core.errors import InputError
from trabecula.io.results.content import CORNERS, CellBlock, ResultArray, SolverResult

_KINDS = {
    1: "hexahedron",
    2: "wedge",
    3: "tetrahedron",
    4: "hexahedron",  # of 20 nodes: corners come first
    5: "wedge",
    6: "tetrahedron",
}
_NODES = {1: 8, 2: 6, 3: 4, 4: 20, 5: 15, 6: 10}
"""Type of an element -> its nodes; other types (shells, beams) have no volume."""

_WIDTH = 12
_ACROSS = 6
"""Characters of a number; numbers in a line."""


@dataclass
class _Frd:
    """What has been read."""

    nodes: dict[str, np.ndarray] = field(default_factory=dict)
    cells: dict[int, tuple[list[int], list[list[int]]]] = field(default_factory=dict)
    results: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)


def open_result(path: Path) -> SolverResult:
    """Open an .frd (see `io.results.open_result`); of several steps the last one counts."""
    found = _Frd()
    with path.open(encoding="ascii", errors="strict", newline="") as file:
        lines = (line.rstrip("\r\n") for line in file)
        for line in lines:
            if line.startswith("    2C"):
                numbers, values = _rows(lines, 3)
                found.nodes = {"numbers": numbers, "points": values}
            elif line.startswith("    3C"):
                _read_elements(lines, found)
            elif line.startswith(" -4"):
                _read_result(line, lines, found)
    if not found.nodes or not found.cells:
        raise InputError(
            f"{path} holds no nodes or no solid elements in text: write it with *NODE FILE, "
            "*EL FILE, not in binary"
        )
    return _as_result(path, found)


def _as_result(path: Path, found: _Frd) -> SolverResult:
    numbers, points = found.nodes["numbers"], found.nodes["points"]
    if not (numbers >= 0).all() or len(numbers) == 0:
        raise ValueError("its nodes have no numbers")
    place = np.full(int(numbers.max()) + 1, -1, np.int64)
    place[numbers] = np.arange(len(numbers))

    def places(given: np.ndarray) -> np.ndarray:
        if given.size and not 0 <= given.min() <= given.max() < len(place):
            raise ValueError("it has a node number that no node has")
        at = place[given]
        if (at < 0).any():
            raise ValueError("it has a node number that no node has")
        return at

    blocks = []
    for kind, (elements, nodes) in found.cells.items():
        name = _KINDS[kind]
        corners = np.array(nodes, np.int64)[:, : CORNERS[name]]
        blocks.append(CellBlock(name, places(corners), np.array(elements, np.int64)))
    # nodes that stand for periods belong to no element, and may have no values
    used = np.unique(np.concatenate([block.nodes.ravel() for block in blocks]))
    outside = np.setdiff1d(np.arange(len(points)), used)

    def load(at: np.ndarray, values: np.ndarray) -> np.ndarray:
        whole = np.full((len(points), values.shape[1]), np.nan)
        whole[places(at)] = values
        whole[outside] = 0
        return whole

    arrays = [
        ResultArray(name, "points", values.shape[1], partial(load, at, values))
        for name, (at, values) in found.results.items()
    ]
    return SolverResult(path, "CalculiX result", tuple(arrays), points=points, blocks=tuple(blocks))


def _read_result(line: str, lines: Iterator[str], found: _Frd) -> None:
    """Read a block of results; a later one of the same name takes its place."""
    name, stored = line[3:13].split()[0], 0
    head: list[str] = []
    for line in lines:
        if not line.startswith(" -5"):
            head = [line]
            break
        words = line[13:].split()
        # a component with a fifth number other than 0 is computed by the viewer, not stored
        stored += not (len(words) > 4 and words[4] != "0")
    if stored and head:
        numbers, values = _rows(lines, stored, head)
        found.results[name] = (numbers, values)


def _rows(
    lines: Iterator[str], count: int, head: list[str] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Read "-1" lines up to "-3": a number and `count` values each."""
    first, rest = (13, 3 + 10)
    numbers: list[int] = []
    texts: list[str] = []
    for line in (*(head or ()), *_until_end(lines)) if head else _until_end(lines):
        mark = line[:3]
        if mark == " -1":
            numbers.append(int(line[3:first]))
            texts.append(line[first:])
        elif mark == " -2" and texts:
            texts[-1] += line[rest:]
        else:
            raise ValueError(f"it has a line {line[:20]!r} among its values")
    values = np.array(
        [float(text[k : k + _WIDTH]) for text in texts for k in range(0, count * _WIDTH, _WIDTH)]
    )
    return np.array(numbers, np.int64), values.reshape(len(numbers), count)


def _until_end(lines: Iterator[str]) -> Iterator[str]:
    """Yield lines up to "-3"; ValueError where the file ends before it."""
    for line in lines:
        if line.startswith(" -3"):
            return
        yield line
    raise ValueError("it ends within a block")


def _read_elements(lines: Iterator[str], found: _Frd) -> None:
    """Read elements of the kinds that have a volume."""
    kind = number = 0
    nodes: list[int] = []
    for line in _until_end(lines):
        if line.startswith(" -1"):
            words = line[3:].split()
            number, kind, nodes = int(words[0]), int(words[1]), []
        else:
            nodes.extend(int(word) for word in line[3:].split())
        if kind in _KINDS and len(nodes) == _NODES[kind]:
            members = found.cells.setdefault(kind, ([], []))
            members[0].append(number)
            members[1].append(nodes)
            nodes = []
