"""Files in parts, for places that take only small ones: NAME.1of4 .. NAME.4of4 are NAME."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

from trabecula.core.errors import FileError
from trabecula.engine.files import replacing

_PART = re.compile(r"\.([1-9][0-9]*)of([1-9][0-9]*)$")


def write_parts(path: Path, data: bytes, most: int) -> list[Path]:
    """Write bytes as files of at most `most` bytes beside `path`; return them in their order.

    Other parts of that name, and a whole file, are removed afterwards.
    """
    count = max(1, -(-len(data) // most))
    names = [path.with_name(f"{path.name}.{n + 1}of{count}") for n in range(count)]
    before = set(_beside(path))
    for number, name in enumerate(names):
        with replacing(name) as temporary:
            temporary.write_bytes(data[number * most : (number + 1) * most])
    for old in before - set(names):
        old.unlink()
    with suppress(FileNotFoundError):
        path.unlink()
    return names


def whole_name(path: Path) -> Path:
    """Return the name of the whole of which `path` is a part; another path as it is."""
    return _stem(path)


def parts_of(path: Path) -> list[Path]:
    """Return the files that hold `path`: itself, or its parts in their order; none where nothing
    is there.

    Raises
    ------
    FileError
        A part is missing, or there are parts of two files.
    """
    if path.exists():
        return [path]
    found = {place: _PART.search(place.name) for place in _beside(path)}
    counts = {int(match[2]) for match in found.values() if match}
    if not counts:
        return []
    if len(counts) > 1:
        raise FileError(
            f"cannot read {path}: there are parts of {len(counts)} files, of {sorted(counts)} "
            "parts each; remove the older ones"
        )
    count = counts.pop()
    names = [path.with_name(f"{path.name}.{n + 1}of{count}") for n in range(count)]
    missing = [name.name for name in names if name not in found]
    if missing:
        raise FileError(f"cannot read {path}: of its {count} parts {missing[0]} is missing")
    return names


def _beside(path: Path) -> list[Path]:
    """List the parts of a file that are there."""
    if not path.parent.is_dir():
        return []
    return [
        place
        for place in path.parent.iterdir()
        if place.name.startswith(f"{path.name}.") and _stem(place) == path
    ]


def _stem(path: Path) -> Path:
    return path.with_name(_PART.sub("", path.name))
