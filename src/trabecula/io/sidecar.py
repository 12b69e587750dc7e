"""Our JSON in a file beside one whose format has no place for it: `x.npy.json`, `x.bmp.json`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.errors import FileError
from trabecula.core.recipe import digest
from trabecula.engine.files import replacing
from trabecula.io.guard import check_there, report_damage
from trabecula.io.metadata import decode


def sidecar_path(path: Path) -> Path:
    """Return the path of the JSON of `path`."""
    return path.with_name(f"{path.name}.json")


@contextmanager
def write_sidecar(path: Path, values: np.ndarray, text: str) -> Iterator[None]:
    """Write the JSON of a file that is written inside the block; both appear, or neither.

    The file's own `replacing` ends first, so it is in place before its JSON is; the digest tells
    the two apart should a machine stop between the two.
    """
    with replacing(sidecar_path(path)) as temporary:
        whole = json.dumps({**json.loads(text), "sha256": digest(values)})
        temporary.write_text(whole + "\n", encoding="ascii")
        yield


def read_sidecar(path: Path, values: np.ndarray) -> dict[str, Any] | None:
    """Read the fields beside `path`; None where there are none.

    Raises
    ------
    FileError
        They are damaged, or belong to other voxels.
    """
    beside = sidecar_path(path)
    if not beside.exists():
        return None
    check_there(beside)
    with report_damage(beside, "metadata"):
        text = beside.read_text(encoding="utf-8")
        fields = decode(text)
        if fields is None:
            raise ValueError("not written by this package")
        same = json.loads(text).get("sha256") == digest(values)
    if not same:
        raise FileError(
            f"{beside} describes other voxels than {path} holds: one was replaced; remove the old "
            "one"
        )
    return fields
