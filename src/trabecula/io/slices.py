"""A folder of slices: one picture per z, in natural order (slice2 before slice10)."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.errors import FileError, InputError
from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.engine.files import replacing
from trabecula.io import raster
from trabecula.io.formats import format_of, suffixes
from trabecula.io.guard import check_claim, check_dtype, report_damage
from trabecula.io.metadata import FileContent, decode, encode, greys_of_labels, labels_of_greys
from trabecula.io.scanner_logs import find_calibration

_FIELDS = "trabecula.json"
_OURS = re.compile(r"slice_\d+\.png|trabecula\.json")


def write(image: Image, path: Path) -> Path:
    """Write a folder of PNG slices and one JSON (see `trabecula.io.files.write`)."""
    if image.ndim != 3:
        raise InputError("a folder of slices holds volumes, the image has 2 axes: write .png")
    check_dtype(image.values.dtype, ("uint8", "uint16"), form="a folder of PNG slices")
    _check_replaceable(path)
    values, levels = greys_of_labels(image)
    digits = max(4, len(str(len(values) - 1)))
    with replacing(path) as temporary:
        temporary.mkdir()
        for z, plane in enumerate(track(values, "writing slices", total=len(values))):
            raster.save_png(plane, temporary / f"slice_{z:0{digits}d}.png")
        more = {} if levels is None else {"levels": levels}
        (temporary / _FIELDS).write_text(
            encode(image, shape=list(values.shape), **more) + "\n", encoding="ascii"
        )
    return path


def _check_replaceable(path: Path) -> None:
    """Raise where a folder holds anything that this module did not write: it would be lost."""
    others = (
        [entry.name for entry in path.iterdir() if not _OURS.fullmatch(entry.name)]
        if path.is_dir()
        else []
    )
    if others:
        raise FileError(
            f"cannot write slices to {path}: it holds other files ({others[0]}); name a new folder"
        )


def read(path: Path) -> FileContent:
    """Read a folder of slices (see `trabecula.io.files.read`)."""
    with report_damage(path, "a folder of slices"):
        names = _slices(path)
        first = _plane(names[0])
        shape = (len(names), *first.values.shape)
        check_claim(path, shape, first.values.dtype)
        values = np.empty(shape, first.values.dtype)
        for z, name in enumerate(track(names, "reading slices")):
            values[z] = _alike(_plane(name) if z else first, first, name).values
        fields = _read_fields(path, shape)
        log = find_calibration(path)
        if log.spacing is not None and not fields:
            return FileContent(
                values, first.colour, spacing=log.spacing, unit=log.unit, origin=log.origin
            )
        ignored = first.ignored
        if first.spacing is not None:
            ignored = (
                f"{names[0].name} has a spacing (from {first.origin or 'its metadata'}), which "
                "says nothing of z: ignored; "
                "give the spacing (--spacing, --unit)"
            )
        return FileContent(
            labels_of_greys(values, fields), colour=first.colour, fields=fields, ignored=ignored
        )


def _slices(path: Path) -> list[Path]:
    known = tuple(suffix for suffix, form in suffixes().items() if form.picture)
    names = [
        entry
        for entry in path.iterdir()
        if entry.name.lower().endswith(known) and not entry.name.startswith(".")
    ]
    if not names:
        raise FileError(
            f"the folder {path} holds no slices ({', '.join(known)}): name a file or another folder"
        )
    sorts = Counter(format_of(name).name for name in names)
    if len(sorts) > 1:
        found = ", ".join(f"{count} {form}" for form, count in sorts.most_common())
        raise FileError(f"the folder {path} mixes slices of several formats ({found}): keep one")
    return sorted(
        names,
        key=lambda name: [
            (int(part), "") if part.isdigit() else (-1, part)
            for part in re.split(r"(\d+)", name.name)
        ],
    )


def _plane(name: Path) -> FileContent:
    content = format_of(name).read(name)
    if content.values.ndim - content.colour != 2:
        raise FileError(f"{name} is a stack of its own, not a slice: read it alone")
    return content


def _alike(plane: FileContent, first: FileContent, name: Path) -> FileContent:
    this, that = plane.values, first.values
    if this.shape != that.shape or this.dtype != that.dtype or plane.colour != first.colour:
        raise FileError(
            f"{name} is {this.shape} {this.dtype}, those before it {that.shape} {that.dtype}: all "
            "must be alike"
        )
    return plane


def _read_fields(path: Path, shape: tuple[int, ...]) -> dict[str, Any] | None:
    """Read the JSON in the folder; ValueError where slices are missing."""
    if not (path / _FIELDS).is_file():
        return None
    fields = decode((path / _FIELDS).read_text(encoding="utf-8"))
    if fields is None or list(shape) != fields.get("shape"):
        raise ValueError(f"{_FIELDS} does not describe its {shape[0]} slices")
    return fields
