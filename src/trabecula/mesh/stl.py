"""STL: 80 bytes of header, a count, 50 bytes a triangle; or its text form.

The format has no unit; slicers take millimetres.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Self

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.recipe import Recipe
from trabecula.mesh.base import Mesh
from trabecula.mesh.text import metres, parse_unit, recipe_digest
from trabecula.mesh.weld import weld

_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_CHUNK = 1 << 18  # triangles at a time: the records of the whole mesh would double the memory
_HEADER = 84


def write(mesh: Mesh, path: Path) -> None:
    """Write `mesh` in millimetres where its unit is a length, else unscaled; the header has it."""
    with Writer(path) as writer:
        writer.add(mesh)
        writer.finish(mesh.unit, mesh.recipe)


class Writer:
    """An STL that is written chunk by chunk: the surface is never in memory as a whole."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._file.write(bytes(_HEADER))
        self._count = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    @staticmethod
    def memory(faces: int) -> int:
        """Return the bytes needed to write so many triangles: corners, normals and records."""
        return 250 * min(faces, _CHUNK)

    @staticmethod
    def check_count(faces: int) -> None:
        """Raise where there are more triangles than the header can count."""
        if faces >= 2**32:
            raise InputError(
                f"the surface has {faces} triangles, an STL counts 2**32 - 1: export a crop, or a "
                "coarser level"
            )

    def add(self, mesh: Mesh) -> None:
        """Append the triangles of a mesh."""
        factor = _file_unit(mesh.unit)[1]
        for start in range(0, len(mesh.faces), _CHUNK):
            self._file.write(_records(mesh, mesh.faces[start : start + _CHUNK], factor).tobytes())
        self._count += len(mesh.faces)

    def finish(self, unit: str, recipe: Recipe) -> None:
        """Write the header, now that it is known: the count, the unit, the recipe's digest."""
        self.check_count(self._count)
        # A header that began with "solid" would be taken for the text form of STL.
        header = f"trabecula, unit={_file_unit(unit)[0]}, recipe={recipe_digest(recipe)}"
        self._file.seek(0)
        self._file.write(
            header.encode("ascii", "replace")[:80].ljust(80) + np.uint32(self._count).tobytes()
        )


def _file_unit(unit: str) -> tuple[str, float]:
    """Return the unit of the coordinates in the file, and their factor."""
    size = metres(unit)
    return (unit, 1.0) if size is None else ("mm", size * 1000)


def _records(mesh: Mesh, faces: np.ndarray, factor: float) -> np.ndarray:
    corners = mesh.vertices[faces] * factor
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).astype(
        np.float64
    )
    length = np.sqrt(np.einsum("ij,ij->i", normal, normal))[:, None]
    records = np.zeros(len(faces), _TRIANGLE)
    records["normal"] = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    records["corners"] = corners
    return records


def read(path: Path) -> Mesh:
    """Read either form; corners at the same place become one vertex.

    The unit is known only where this package wrote it.
    """
    raw = path.read_bytes()
    count = int.from_bytes(raw[80:_HEADER], "little") if len(raw) >= _HEADER else -1
    # The size decides, not the first word: binary files of some programs begin with "solid" too.
    if len(raw) != _HEADER + count * _TRIANGLE.itemsize:
        if b"facet" in raw[:4096]:
            return _read_text(raw)
        raise ValueError(
            f"{len(raw)} bytes do not hold the {max(count, 0)} triangles that its header claims"
        )
    unit = re.search(rb"unit=(\w+)", raw[:80])
    corners = np.frombuffer(raw, _TRIANGLE, offset=_HEADER)["corners"]
    return Mesh(*weld(corners), parse_unit(unit[1].decode("ascii") if unit else None))


def _read_text(raw: bytes) -> Mesh:
    numbers = re.findall(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)", raw)
    if len(numbers) != 3 * raw.count(b"endfacet") or b"endsolid" not in raw:
        raise ValueError(f"{len(numbers)} corners in {raw.count(b'endfacet')} closed facets")
    return Mesh(*weld(np.array(numbers).astype(np.float64).reshape(-1, 3, 3)))
