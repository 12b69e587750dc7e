"""`read` and `write`: any format in the table, by the path's suffix."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, as_path_text
from trabecula.core.errors import FileError, InputError
from trabecula.core.image import Image, as_image
from trabecula.engine.storage import Remote, path_or_remote
from trabecula.io.formats import SLICES, ZARR, Format, format_of, suffix_of, suffixes
from trabecula.io.guard import check_there
from trabecula.io.meaning import interpret
from trabecula.io.readers import Reader, reader_of, recognise


def read(
    path: str | os.PathLike[str],
    *,
    kind: str | None = None,
    spacing: float | Sequence[float] | None = None,
    unit: str | None = None,
    phases: Sequence[str] | None = None,
    level: int = 0,
    dataset: str | None = None,
) -> Image:
    """Read a volume or a picture.

    What is not given comes from the metadata that this package wrote into the file; else from the
    file's own format; else from its content: pictures in red, green, blue are colour; integers of
    at most 8 levels are labels, the levels in rising order becoming 0..n-1; everything else is
    grey.

    Parameters
    ----------
    path : path or address
        A file of a known suffix (`trabecula.io.formats.suffixes`, `trabecula.io.readers`), a Zarr
        store, a folder of slices or of a DICOM series; of a Zarr store also an address that fsspec
        knows, such as s3://bucket/rock.zarr (needs the extra remote).
    kind : {"labels", "grey", "colour"}, optional
    spacing : float or sequence of float, optional
        Edge of a voxel, one number or one per axis (z, y, x).
    unit : str, optional
        Of the spacing, in any usual spelling. A file that states a spacing without a unit leaves it
        "voxel".
    phases : sequence of str, optional
        Names of the labels 0..n-1.
    level : int
        Of a Zarr store with coarser levels beside the voxels: 0 the finest, each further one of
        half the voxels along an axis.
    dataset : str, optional
        Of a file that holds several arrays (HDF5, .vti, .vtu, a folder of DICOM series): the name
        of one. Default: the only one, or the one that the file marks.

    Returns
    -------
    Image
        With the recipe that the file carries, or a new one whose first step is this reading.

    Raises
    ------
    FileError
        Missing, empty, truncated or damaged, or not what its suffix says.
    UnknownNameError
        A suffix, kind or unit that does not exist.
    InputError
        Values that are not what `kind` says, NaN, wrong dimensions; a level that is not there.
    MemoryBudgetError
        A header that claims more than the available memory.

    Examples
    --------
    >>> import tempfile, numpy as np, trabecula as tb
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = tb.write(np.eye(4, dtype=np.uint8), f"{folder}/eye.png")
    ...     tb.read(path, spacing=0.5, unit="micron")
    <Image 4x4 labels, voxel 0.5x0.5 um, phases void/solid>
    """
    place = path_or_remote(path)
    check_there(place)
    form = _format_to_read(place)
    given = {"kind": kind, "spacing": spacing, "unit": unit, "phases": phases}
    options = {name: value for name, value in given.items() if value is not None}
    if dataset is not None:
        if not form.datasets:
            raise InputError(f"{path} is {form.name}, which holds one array: leave the dataset out")
        content = form.read(place, str(dataset))
        options["dataset"] = str(dataset)
        return interpret(content, source=os.fspath(path), options=options)
    if level == 0:
        return interpret(form.read(place), source=os.fspath(path), options=options)
    if not form.lazy:
        raise InputError(
            f"{path} is {form.name}, which has no coarser levels: leave the level out, "
            "or write a .zarr"
        )
    content = form.read(place, as_number(level, name="level", low=0, high=64, whole=True))
    return interpret(content, source=os.fspath(path), options={**options, "level": level})


def _format_to_read(path: Path | Remote) -> Format | Reader:
    if isinstance(path, Remote):
        return ZARR
    if not path.is_dir():
        reader = reader_of(path) or (None if suffix_of(path) else recognise(path))
        if reader is not None:
            return reader
        form = format_of(path)
        if form.folder:
            raise FileError(
                f"cannot read {path} as {form.name}: it is a file, a {form.name} store is a folder"
            )
        return form
    if suffix_of(path) is None:
        if (path / "zarr.json").exists():
            return ZARR
        return SLICES if holds_slices(path) else recognise(path) or SLICES
    form = format_of(path)
    if not form.folder:
        raise FileError(
            f"cannot read {path} as {form.name}: it is a folder; name a file in it, "
            "or rename the folder"
        )
    return form


def holds_slices(folder: Path) -> bool:
    """Return whether a folder holds pictures."""
    known = tuple(suffix for suffix, form in suffixes().items() if form.picture)
    return any(entry.name.lower().endswith(known) for entry in folder.iterdir())


def write(image: Image | ArrayLike, path: str | os.PathLike[str]) -> Path | Remote:
    """Write an Image with its spacing, unit, phases and recipe; the file appears whole or not at
    all.

    Parameters
    ----------
    image : Image or array
        Plain arrays of bool or of labels 0..n-1 as they are; others need a kind first.
    path : path or address
        The suffix chooses the format; a path that ends in "/" is a folder of PNG slices. At an
        address (as for `read`) what is there is not replaced.

    Returns
    -------
    Path, or Remote at an address
        The file that was written (the header, where the voxels are in a file of their own).

    Raises
    ------
    FileError
        The place cannot be written, or is taken by something of another sort.
    UnknownNameError
        An unknown suffix.
    InputError
        Voxels that the format cannot hold.
    """
    image = as_image(image)
    text, place = as_path_text(path), path_or_remote(path)
    if isinstance(place, Remote):
        return check_stored(place).write(image, place)
    form = SLICES if text.endswith(("/", os.sep)) and suffix_of(text) is None else format_of(text)
    if form.folder and place.exists() and not place.is_dir():
        raise FileError(
            f"cannot write {place}: a file of that name is there, a {form.name} is a folder; "
            "remove it first"
        )
    if not form.folder and place.is_dir():
        raise FileError(
            f"cannot write {place}: a folder of that name is there; choose another name"
        )
    return form.write(image, place)


def check_stored(address: Remote) -> Format:
    """Return the format that is written to an address.

    Raises
    ------
    InputError
        The suffix is not that of a Zarr store.
    """
    if suffix_of(address) not in ZARR.suffixes:
        raise InputError(
            f"cannot write {address}: only a .zarr is written to an address; write a file, "
            "and copy it there"
        )
    return ZARR
