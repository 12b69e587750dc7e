"""Locations of stores: a folder, or an address such as s3://bucket/rock.zarr; one code writes and
reads both.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from urllib.request import url2pathname

from trabecula.core.checks import as_path_text
from trabecula.engine.storage.local import Folder, Location
from trabecula.engine.storage.remote import Remote

__all__ = ["AnyPath", "Folder", "Location", "Remote", "is_address", "location_of", "path_or_remote"]

AnyPath = str | os.PathLike[str]

# two letters: one is a drive of Windows
_ADDRESS = re.compile(r"(?P<protocol>[a-z][a-z0-9+.:-]+)://", re.IGNORECASE)


def is_address(path: AnyPath) -> bool:
    """Return whether a path is an address beyond this machine's folders."""
    found = _ADDRESS.match(as_path_text(path))
    return found is not None and found["protocol"].lower() not in ("file", "local")


def location_of(path: AnyPath) -> Location:
    """Return the location that a path or an address names; file:// is a folder."""
    if isinstance(path, Location):
        return path
    text = as_path_text(path)
    if is_address(text):
        return Remote(text)
    found = _ADDRESS.match(text)
    return Folder(Path(path) if found is None else Path(url2pathname(text[found.end() :])))


def path_or_remote(path: AnyPath) -> Path | Remote:
    """Return the location for callers that read other files as well: a path where it is one."""
    found = location_of(path)
    return found if isinstance(found, Remote) else Path(found)
