"""napari's door to our formats: `get_reader`, `write_layer`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.io.files import holds_slices, read, write
from trabecula.io.formats import suffix_of
from trabecula.io.lazy import level_that_fits
from trabecula.io.readers import reader_of, recognise
from trabecula.mesh.bricks.formats import FORMATS as BRICKS
from trabecula.mesh.formats import FORMATS as SURFACES
from trabecula.napari.layers import image_of, layer_data
from trabecula.pipeline.outputs import export

Layer = tuple[np.ndarray, dict[str, Any], str]


def get_reader(path: str | Sequence[str]) -> Callable[[str | Sequence[str]], list[Layer]] | None:
    """Return a function that reads a path into layers; None where no format of ours has it."""
    paths = [path] if isinstance(path, str) else list(path)
    return read_layers if paths and all(_is_ours(Path(one)) for one in paths) else None


def _is_ours(path: Path) -> bool:
    if suffix_of(path) or reader_of(path):
        return True
    if not path.is_dir():
        return False
    return (path / "zarr.json").exists() or holds_slices(path) or recognise(path) is not None


def read_layers(path: str | Sequence[str]) -> list[Layer]:
    """Read files, each into one layer; of a Zarr store the finest level that fits into memory."""
    found = []
    for one in [path] if isinstance(path, str) else list(path):
        level = level_that_fits(one, need=lambda shape, size: 2 * size * prod(shape))
        found.append(layer_data(read(one, level=level), Path(one).name.partition(".")[0]))
    return found


def write_layer(path: str, data: Any, options: dict[str, Any]) -> list[str]:
    """Write a layer in the format of the suffix: voxels, or the surface or bricks of labels."""
    suffix = Path(path).suffix.lower()
    surface = suffix in SURFACES or suffix in BRICKS
    values = np.asarray(data)
    labels = "rgb" not in options
    image = image_of(values, options, "labels" if labels else "image")
    return [str(export(image, path) if surface else write(image, path))]
