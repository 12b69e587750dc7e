"""Zarr stores with OME-Zarr 0.5 axes and scale; the store itself is the engine's."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from trabecula.core.errors import FileError
from trabecula.core.image import Image, describe_fields
from trabecula.engine import store
from trabecula.engine.storage import Remote
from trabecula.io.guard import check_claim, report_damage
from trabecula.io.metadata import FileContent, check_fields
from trabecula.io.units import long_name


def write(image: Image, path: Path | Remote) -> Path | Remote:
    """Write a Zarr store (see `trabecula.io.files.write`)."""
    store.save(
        path,
        # OME puts channels before space.
        np.moveaxis(image.values, -1, 0) if image.kind == "colour" else image.values,
        scale=image.spacing,
        unit=long_name(image.unit),
        fields=dict(describe_fields(image)),
    )
    return path


def read(path: Path | Remote, level: int = 0) -> FileContent:
    """Read a level of a Zarr store (see `trabecula.io.files.read`)."""
    with report_damage(path, "Zarr"):
        opened = store.open_finished(path, level)
        check_claim(path, opened.array.shape, opened.array.dtype)
        fields = (
            {**check_fields(opened.fields), "spacing": list(opened.scale)}
            if opened.fields
            else None
        )
        values = opened.load()
        if fields is None:
            return FileContent(
                _spatial(path, values, len(opened.scale)),
                spacing=opened.scale or None,
                unit=opened.unit,
            )
        colour = fields["kind"] == "colour"
        values = np.moveaxis(values, 0, -1) if colour else values
        return FileContent(
            values, colour=colour, spacing=opened.scale, unit=opened.unit, fields=fields
        )


def _spatial(path: Path | Remote, values: np.ndarray, axes: int) -> np.ndarray:
    """Remove OME's leading axes of time and channel, which must be of length one."""
    extra = values.ndim - axes if axes else max(0, values.ndim - 3)
    if any(side != 1 for side in values.shape[:extra]):
        raise FileError(
            f"cannot read {path} as Zarr: {values.shape} has times or channels; write one of them "
            "to a store of its own"
        )
    return values.reshape(values.shape[extra:])
