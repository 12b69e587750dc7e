"""NumPy's .npy: a plain array, with what it means in a sidecar."""

from __future__ import annotations

from pathlib import Path
from tokenize import TokenError

import numpy as np

from trabecula.core.image import Image
from trabecula.engine.files import replacing
from trabecula.io import sidecar
from trabecula.io.guard import check_claim, report_damage
from trabecula.io.metadata import FileContent, encode


def write(image: Image, path: Path) -> Path:
    """Write .npy and .npy.json (see `trabecula.io.files.write`)."""
    with (
        sidecar.write_sidecar(path, image.values, encode(image)),
        replacing(path) as temporary,
        temporary.open("wb") as file,
    ):
        np.save(file, image.values, allow_pickle=False)
    return path


def read(path: Path) -> FileContent:
    """Read .npy, alone or with its sidecar (see `trabecula.io.files.read`)."""
    with report_damage(path, "NumPy", also=(TokenError,)):
        # The map allocates nothing, so that the header's claim can be weighed first; it fails where
        # the file is short.
        mapped = np.lib.format.open_memmap(path, mode="r")
        check_claim(path, mapped.shape, mapped.dtype)
        values = np.array(mapped, order="C")
    return FileContent(values, fields=sidecar.read_sidecar(path, values))
