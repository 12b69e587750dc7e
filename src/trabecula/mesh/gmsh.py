"""Gmsh mesh (.msh), version 2.2 in binary: bricks or tetrahedra, a physical group for each phase.

Version 2.2 rather than 4: MFEM reads no other, and Gmsh, and FEniCSx by it, still do. Format:
https://gmsh.info/doc/texinfo/gmsh.html, section "MSH file format version 2".
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path

import numpy as np

from trabecula.mesh.elements import Elements, write_parts

_TYPES = {8: 5, 4: 4}  # hexahedron, tetrahedron


def write_msh(elements: Elements, path: Path) -> None:
    """Write elements; the group of a phase is its label + 1. Numbers of nodes are 32-bit."""
    tag = [
        f'3 {number + 1} "{name}"\n'.replace("\\", "_")
        for number, name in enumerate(elements.phases)
    ]
    node = np.dtype([("number", "<i4"), ("place", "<f8", 3)])
    cell = np.dtype([("number", "<i4"), ("tags", "<i4", 2), ("nodes", "<i4", elements.corners)])
    with path.open("wb") as file:
        file.write(b"$MeshFormat\n2.2 1 8\n" + np.array(1, "<i4").tobytes() + b"\n$EndMeshFormat\n")
        file.write(f"$PhysicalNames\n{len(tag)}\n{''.join(tag)}$EndPhysicalNames\n".encode())
        file.write(f"$Nodes\n{elements.nodes}\n".encode())
        write_parts(file, elements.nodes * node.itemsize, _nodes(elements, node))
        file.write(f"\n$EndNodes\n$Elements\n{elements.cells}\n".encode())
        head = np.array([_TYPES[elements.corners], elements.cells, 2], "<i4")
        file.write(head.tobytes())  # one block: all cells are of one type and have two tags
        write_parts(file, elements.cells * cell.itemsize, _cells(elements, cell))
        file.write(b"\n$EndElements\n")


def _nodes(elements: Elements, kind: np.dtype) -> Iterator[np.ndarray]:
    count = 0
    for points in elements.points():
        part = np.empty(len(points), kind)
        part["number"] = np.arange(count + 1, count + len(points) + 1)
        part["place"] = points
        count += len(points)
        yield part


def _cells(elements: Elements, kind: np.dtype) -> Iterator[np.ndarray]:
    count = 0
    for members, labels in zip_longest(elements.members(), elements.labels()):
        part = np.empty(len(members), kind)
        part["number"] = np.arange(count + 1, count + len(members) + 1)
        part["tags"] = labels[:, None].astype(np.int32) + 1
        part["nodes"] = members + 1
        count += len(members)
        yield part
