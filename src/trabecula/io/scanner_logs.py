"""Sizes of voxels that a scanner writes beside its slices: Bruker's .log, Nikon's .xtekct.

Bruker (SkyScan): an INI file, whose section Reconstruction has "Pixel Size (um)"; where only the
projections' "Image Pixel Size (um)" is there, that is taken. Nikon: "VoxelSizeX" .. "VoxelSizeZ" in
mm, 0 where they are as wide as the others. Voxels are cubes in Bruker's reconstructions.
"""

from __future__ import annotations

import re
from pathlib import Path

from trabecula.core.errors import FileError
from trabecula.io.guard import report_damage
from trabecula.io.resolution import Calibration

_SUFFIXES = (".log", ".xtekct")
_MOST = 1 << 20
"""Bytes of a log that are read: longer ones are other programs'."""


def find_calibration(folder: Path) -> Calibration:
    """Return the spacing of the slices in a folder by the scanner's log beside them.

    Raises
    ------
    FileError
        Logs that differ, or one that is damaged.
    """
    found: dict[str, Calibration] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in _SUFFIXES and path.is_file() and path.stat().st_size <= _MOST:
            one = read_log(path)
            if one.spacing is not None:
                found[path.name] = one
    kinds = {one.spacing for one in found.values()}
    if len(kinds) > 1:
        sizes = ", ".join(
            f"{name} {one.spacing[0]:g}" for name, one in found.items() if one.spacing
        )
        raise FileError(f"the logs in {folder} state different voxels ({sizes} um): keep one")
    return next(iter(found.values())) if found else Calibration()


def read_log(path: Path) -> Calibration:
    """Return the spacing that a log states along z, y, x; none where it states none."""
    with report_damage(path, "a scanner's log"):
        entries = _entries(path.read_text(encoding="latin-1"))
        if path.suffix.lower() == ".xtekct":
            return _nikon(entries, path.name)
        return _bruker(entries, path.name)


def _entries(text: str) -> dict[str, str]:
    """Return values by "section/name", both in lower case without spaces."""
    section, found = "", {}
    for line in text.splitlines():
        title = re.fullmatch(r"\s*\[(.*)\]\s*", line)
        if title:
            section = "".join(title[1].lower().split())
        name, sign, value = line.partition("=")
        if sign and not line.lstrip().startswith(";"):
            found[f"{section}/{''.join(name.lower().split())}"] = value.strip()
    return found


def _bruker(entries: dict[str, str], name: str) -> Calibration:
    keys = ["reconstruction/pixelsize(um)", "reconstruction/imagepixelsize(um)"]
    keys += ["acquisition/imagepixelsize(um)"]
    for key in keys:
        if key in entries:
            edge = _positive(entries[key].replace(",", "."), key)
            return Calibration((edge,) * 3, "um", f"{name} ({key.partition('/')[2]})")
    return Calibration()


def _nikon(entries: dict[str, str], name: str) -> Calibration:
    sizes = {
        key.partition("/")[2]: value
        for key, value in entries.items()
        if key.partition("/")[2].startswith("voxelsize")
    }
    if "voxelsizex" not in sizes:
        return Calibration()
    x = _positive(sizes["voxelsizex"], "VoxelSizeX")
    edges = tuple(float(sizes.get(f"voxelsize{axis}", "0")) or x for axis in "zyx")
    if min(edges) <= 0:
        raise ValueError("its voxels have sizes below 0")
    return Calibration(edges, "mm", f"{name} (VoxelSize)")


def _positive(text: str, name: str) -> float:
    value = float(text)
    if not 0 < value < 1e9:
        raise ValueError(f"its {name} is {text}")
    return value
