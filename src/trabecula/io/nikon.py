"""Nikon's and Volume Graphics' volumes: a text header .vgi beside voxels .vol."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trabecula.core.errors import FileError
from trabecula.io.guard import check_claim, report_damage
from trabecula.io.metadata import FileContent

_TYPES = {
    ("unsigned integer", 8): "u1",
    ("unsigned integer", 16): "u2",
    ("unsigned integer", 32): "u4",
    ("signed integer", 16): "i2",
    ("signed integer", 32): "i4",
    ("float", 32): "f4",
}
_ALIASES = {"unsigned_integer": "unsigned integer", "signed_integer": "signed integer"}


def read(path: Path) -> FileContent:
    """Read a .vgi and its .vol (see `trabecula.io.files.read`)."""
    with report_damage(path, "Nikon volume"):
        words = _entries(path)
        sides = [int(word) for word in words["size"].split()]
        name = words["datatype"].lower()
        kind = (_ALIASES.get(name, name), int(words["bitsperelement"]))
        if len(sides) != 3 or kind not in _TYPES:
            raise ValueError(f"it claims voxels of {words['datatype']}, {kind[1]} bits")
        dtype = np.dtype("<" + _TYPES[kind])
        edges = [float(word) for word in words.get("resolution", "").split()]
        skip = int(words.get("skipheader", "0"))
        voxels = _voxels(path, words.get("name", ""))
        shape = tuple(sides[::-1])
        check_claim(voxels, shape, dtype, stored=voxels.stat().st_size - skip)
        count = int(np.prod(shape, dtype=np.int64))
        values = np.fromfile(voxels, dtype, count, offset=skip).reshape(shape)
        if not edges:
            return FileContent(values)
        unit = words.get("unit", "mm")
        return FileContent(values, spacing=tuple(edges[::-1]), unit=unit, origin="the .vgi")


def _entries(path: Path) -> dict[str, str]:
    """Return the first value of every entry "name = value", names in lower case."""
    found: dict[str, str] = {}
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        name, sign, value = line.partition("=")
        if sign:
            found.setdefault(name.strip().lower(), value.strip())
    return found


def _voxels(path: Path, name: str) -> Path:
    """Return the file of voxels: beside the header, as it names it or as the header is named."""
    near = [path.with_suffix(suffix) for suffix in (".vol", ".VOL", ".raw")]
    wanted = [path.with_name(Path(name.replace("\\", "/")).name)] if name else []
    for one in (*wanted, *near):
        if one.is_file() and one != path:
            return one
    raise FileError(f"the voxels of {path} are not beside it: copy {near[0].name} there")
