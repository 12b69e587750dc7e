"""Fetch a published data set: from a folder, from the cache, or from its address."""

from __future__ import annotations

import os
import sys
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import unquote, urlsplit

from trabecula.core.checks import check_name
from trabecula.core.errors import FileError, TrabeculaError
from trabecula.core.image import Image
from trabecula.core.progress import report
from trabecula.core.recipe import digest
from trabecula.engine.files import replacing
from trabecula.exemplar.crop import crop
from trabecula.exemplar.datasets import DATA_SETS, DataSet
from trabecula.io import files

__all__ = ["cache_folder", "fetch"]

FOLDER = "TRABECULA_DATA"
"""Variable of the environment that names a folder with data."""

_TIMEOUT = 30  # seconds without an answer
_AT_ONCE = 1 << 18  # bytes
_MOST = 1 << 30  # bytes of a file that is downloaded


def fetch(name: str) -> Image:
    """Return a published scan or picture, whose voxels have the hash that is known of them.

    It is looked for in the folder that the variable TRABECULA_DATA names, then in the cache, and
    then downloaded into the cache. The hashes were taken from copies of the files in a folder; the
    addresses themselves have not been tried by us.

    Parameters
    ----------
    name : str
        One of `datasets()`.

    Returns
    -------
    Image
        With spacing, unit and names of phases; its recipe begins with the file.

    Raises
    ------
    UnknownNameError
        No data set of that name.
    FileError
        It is in no folder and has no address, or the address does not answer; its voxels have
        another hash; the cache cannot be written.
    """
    check_name(name, DATA_SETS, name="data set")
    entry = DATA_SETS[name]
    found = _find(entry)
    if found is not None:
        return _read(entry, found)
    if not entry.address:
        raise FileError(
            f"data set {name!r} has no address of a single file (it is from {entry.source}): "
            f"put a copy as {entry.file} into a folder and name that with {FOLDER}=DIR"
        )
    return _read(entry, _download(entry))


def cache_folder() -> Path:
    """Return the user's folder for downloaded data, which may not exist yet."""
    if sys.platform == "win32":
        place = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        place = Path.home() / "Library" / "Caches"
    else:
        place = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(place) / "trabecula"


def _find(entry: DataSet) -> Path | None:
    """Return the file of a data set in the folder that was named, or in the cache."""
    folders = [cache_folder()]
    if os.environ.get(FOLDER):
        folders.insert(0, Path(os.environ[FOLDER]))
    for folder in folders:
        for file in (entry.file, _name_at_source(entry)):
            if file and (folder / file).is_file():
                return folder / file
    return None


def _name_at_source(entry: DataSet) -> str:
    """Return the name that a file has at its address; empty where it has none."""
    return unquote(urlsplit(entry.address).path.rpartition("/")[2])


def _read(entry: DataSet, path: Path) -> Image:
    """Read a file and compare its voxels with what is known of them."""
    try:
        image = files.read(
            path,
            kind=entry.kind,
            spacing=entry.spacing,
            unit=entry.unit,
            phases=entry.phases or None,
        )
        if image.shape != entry.shape and len(image.shape) == len(entry.shape):
            image = crop(image, entry.shape, corner=(0,) * len(entry.shape))
    except TrabeculaError as error:
        raise FileError(f"{path} is not the data set {entry.name!r}: {error}") from error
    found = digest(image.values)
    if found != entry.sha256:
        raise FileError(
            f"{path} is not the data set {entry.name!r}: its voxels have SHA-256 {found[:12]}..., "
            f"{entry.sha256[:12]}... is known; remove it, or read it as it is with tb.read"
        )
    return image


def _download(entry: DataSet) -> Path:
    """Download a file into the cache, whole and with the right voxels or not at all."""
    path = cache_folder() / _name_at_source(entry)
    with replacing(path) as temporary:
        try:
            with (
                urllib.request.urlopen(entry.address, timeout=_TIMEOUT) as source,
                temporary.open("wb") as file,
            ):
                _copy(source, file, entry)
        except (urllib.error.URLError, TimeoutError, ConnectionError) as error:
            why = getattr(error, "reason", None) or error
            raise FileError(
                f"data set {entry.name!r} cannot be downloaded from {entry.address}: {why}; "
                f"fetch that file by other means and put it into {path.parent}, or into a folder "
                f"that {FOLDER}=DIR names"
            ) from error
        _read(entry, temporary)
    return path


def _copy(source: Any, file: BinaryIO, entry: DataSet) -> None:
    """Copy a download, with its progress."""
    size = int(source.headers.get("Content-Length") or 0)
    done = 0
    while part := source.read(_AT_ONCE):
        done += len(part)
        if done > _MOST:
            raise FileError(
                f"data set {entry.name!r}: {entry.address} gives more than {_MOST >> 20} MiB, "
                "which cannot be the file; it was not kept"
            )
        file.write(part)
        report(f"downloading {entry.name}", min(done / size, 1.0) if size else 0.0)
    if done < size:
        raise ConnectionError(f"only {done} of {size} bytes came")
