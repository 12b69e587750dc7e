"""`trabecula doctor`: what this machine and this installation have, and a self-check."""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import importlib.util
import os
import platform
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from trabecula.cli import terminal

BASE = {
    "numpy": "numpy",
    "numba": "numba",
    "zarr": "zarr",
    "tifffile": "tifffile",
    "pillow": "PIL",
    "nibabel": "nibabel",
    "pynrrd": "nrrd",
    "threadpoolctl": "threadpoolctl",
    "filelock": "filelock",
    "psutil": "psutil",
}
"""Packages of the base install, each with its module."""

EXTRAS = {
    "learn": ("torch",),
    "cluster": ("dask", "distributed"),
    "mesh": ("trimesh",),
    "completion": ("shtab",),
    "remote": ("fsspec", "s3fs"),
    "napari": ("napari",),
    "dicom": ("pydicom",),
    "hdf5": ("h5py",),
}
"""Packages of every extra; their modules have the same names."""

_SAID = {
    "same": "the same voxels",
    "other": "other voxels than on the machine of the release: recipes of other machines may not "
    "replay here, results are as good",
    "unfinished": "not finished in 10 s: kernels are compiled at their first use, and kept; run "
    "doctor again",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the form of the output."""
    parser.add_argument("--json", action="store_true", help="print as JSON, sizes in bytes")


def run(options: argparse.Namespace) -> int:
    """Print the findings; status 2 where the base install lacks something."""
    found = examine()
    if options.json:
        terminal.show_json(found)
    else:
        terminal.show_rows(_rows(found))
    if found["missing"]:
        terminal.fail(f"missing: {'; '.join(found['missing'])}")
        return 2
    return 0


def examine() -> dict[str, Any]:
    """Return versions, resources, folders, the self-check, and what is missing."""
    from trabecula import __version__

    packages = {name: _base_package(name, module) for name, module in BASE.items()}
    missing = [
        f"{name} ({one['problem']}): pip install --upgrade trabecula"
        for name, one in packages.items()
        if one["problem"]
    ]
    temporary = _folder(Path(tempfile.gettempdir()))
    if not temporary["writable"]:
        missing.append(
            f"a temporary folder that can be written, for {temporary['folder']}: set TMPDIR"
        )
    found: dict[str, Any] = {
        "trabecula": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "packages": packages,
        "extras": {extra: _extra(extra, names) for extra, names in EXTRAS.items()},
        "cores": os.cpu_count(),
        "temporary": temporary,
    }
    if not any(one["problem"] for one in packages.values()):
        found |= _with_base()
        missing += [
            f"a run of {name} ({said}): reinstall trabecula"
            for name, said in found["self_check"].items()
            if said.startswith("failed")
        ]
    return {**found, "missing": missing}


def _with_base() -> dict[str, Any]:
    """Return what only a whole base install can find."""
    from trabecula.engine.memory import available_memory
    from trabecula.engine.parallel import thread_count
    from trabecula.pipeline.self_check import self_check

    return {
        "threads": thread_count(),
        "memory": available_memory(),
        "cache": _kernel_cache(),
        "self_check": self_check(),
    }


def _base_package(name: str, module: str) -> dict[str, str | None]:
    """Return version and problem of a package, which is imported."""
    try:
        importlib.import_module(module)
    except ModuleNotFoundError as error:
        problem = "not installed" if error.name == module else f"cannot be imported: {error}"
        return {"version": _version(name), "problem": problem}
    except Exception as error:  # noqa: BLE001 - whatever a broken package raises is the finding
        return {"version": _version(name), "problem": f"cannot be imported: {error}"}
    return {"version": _version(name), "problem": None}


def _extra(extra: str, names: tuple[str, ...]) -> dict[str, Any]:
    """Return the packages of an extra, which are not imported: PyTorch takes seconds."""
    versions = {name: _version(name) for name in names if importlib.util.find_spec(name)}
    return {
        "installed": len(versions) == len(names),
        "packages": versions,
        "install": f"pip install 'trabecula[{extra}]'",
    }


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _kernel_cache() -> dict[str, Any]:
    """Return the folder in which Numba keeps the kernels of one module."""
    from trabecula.engine import gaussian_random

    stats = (getattr(value, "stats", None) for value in vars(gaussian_random).values())
    paths = (getattr(one, "cache_path", None) for one in stats)
    path = next((found for found in paths if found), None)
    return _folder(Path(path)) if path else {"folder": None, "writable": False, "free": None}


def _folder(path: Path) -> dict[str, Any]:
    """Return if a file can be written into a folder, and its free space; the folder may not be
    there yet.
    """
    there = next((folder for folder in (path, *path.parents) if folder.exists()), path)
    try:
        with tempfile.TemporaryFile(dir=there) as file:
            file.write(b"x")
        return {"folder": str(path), "writable": True, "free": shutil.disk_usage(there).free}
    except OSError:
        return {"folder": str(path), "writable": False, "free": None}


def _rows(found: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the lines for a person."""
    rows = [(name, str(found[name])) for name in ("trabecula", "python", "platform")]
    rows += [
        (name, one["problem"] or one["version"] or "installed")
        for name, one in found["packages"].items()
    ]
    for extra, one in found["extras"].items():
        there = ", ".join(
            f"{name} {version or ''}".strip() for name, version in one["packages"].items()
        )
        said = there if one["installed"] else f"not installed: {one['install']}"
        rows.append((f"extra {extra}", said))
    rows.append(("cores", str(found["cores"])))
    if "self_check" in found:
        from trabecula.engine.memory import format_bytes

        rows.append(("threads used", str(found["threads"])))
        rows.append(("free memory", format_bytes(found["memory"])))
        rows.append(("compiled kernels", _said_folder(found["cache"])))
        rows.append(("temporary folder", _said_folder(found["temporary"])))
        rows += [
            (f"self-check {name}", _SAID.get(said, said))
            for name, said in found["self_check"].items()
        ]
    else:
        rows.append(("self-check", "left out: the base install is not whole"))
    return rows


def _said_folder(one: Mapping[str, Any]) -> str:
    if one["folder"] is None:
        return "not kept: they are compiled in every run (NUMBA_CACHE_DIR names a folder)"
    return one["folder"] if one["writable"] else f"{one['folder']}: cannot be written"
