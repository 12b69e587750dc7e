"""The one table of formats of volumes and pictures; surfaces have their own (`trabecula.mesh`).

A format declares itself in one row of `FORMATS`; its module has `read` and `write`, and is loaded
when one of its suffixes is first met. Another distribution adds a format by an entry point that
names a `Format`, and checks it with `trabecula.testing.check_format`:

    [project.entry-points."trabecula.formats"]
    slab = "slab_package:FORMAT"
"""

from __future__ import annotations

import importlib
import os
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol, cast

from trabecula.core.checks import check_name
from trabecula.core.errors import UnknownNameError
from trabecula.core.image import Image
from trabecula.core.progress import notify
from trabecula.io.metadata import FileContent

GROUP = "trabecula.formats"
"""Group of the entry points of formats."""


class FormatModule(Protocol):
    """The functions of a format's module. Both take the place of the file, or of the folder."""

    def read(self, path: Path, /) -> FileContent:
        """Read a file; `FileError` where it is damaged (`trabecula.io.guard.report_damage`).

        A format that is `lazy` takes a second argument, the level.
        """
        ...

    def write(self, image: Image, path: Path, /) -> Path:
        """Write a file, whole or not at all (`trabecula.engine.files.replacing`), with the JSON of
        `trabecula.io.metadata.encode`; `InputError` for voxels that the format cannot hold.
        """
        ...


@dataclass(frozen=True)
class Format:
    """A format of file, as a row of the table.

    Parameters
    ----------
    name : str
        As messages call it.
    suffixes : tuple of str
        In lower case, with their dot; the first is the usual one.
    module : str
        Dotted name of the module with `read` and `write` (a `FormatModule`).
    note : str
        One line for the docs and the command line.
    ndim : tuple of int
        Axes of what it holds: 2 pictures, 3 volumes.
    folder : bool
        It is a folder instead of a file.
    lazy : bool
        Planes are read when they are needed (`open_slabs`), and coarser levels may be stored beside
        the voxels, so that `read(path, level)` takes one.
    picture : bool
        Its files may be the slices of a folder.
    resolution : bool
        The format has fields of its own for the edge of a voxel, which other programs read.
    lossy : bool
        It changes voxels, so that a recipe in it does not describe them.
    datasets : bool
        A file may hold several arrays, and `read(path, name)` takes one.
    """

    name: str
    suffixes: tuple[str, ...]
    module: str
    note: str
    ndim: tuple[int, ...] = (2, 3)
    folder: bool = False
    lazy: bool = False
    picture: bool = False
    resolution: bool = True
    lossy: bool = False
    datasets: bool = False

    def load(self) -> FormatModule:
        """Import the format's module."""
        return cast(FormatModule, importlib.import_module(self.module))

    def read(self, *arguments: Any) -> FileContent:
        """Read a path, of a `lazy` format also a level of it."""
        return self.load().read(*arguments)

    def write(self, image: Image, path: Any) -> Any:
        """Write an image, and return what was written."""
        return self.load().write(image, path)


ZARR = Format(
    "Zarr",
    (".zarr",),
    "trabecula.io.omezarr",
    "version 3, sharded, zstd; OME-Zarr 0.5 axes, scale and levels",
    folder=True,
    lazy=True,
)
SLICES = Format(
    "folder of slices",
    (),
    "trabecula.io.slices",
    "one picture per z in natural order; a path that ends in /",
    ndim=(3,),
    folder=True,
    resolution=False,
)
FORMATS = (
    Format(
        "TIFF",
        (".tif", ".tiff"),
        "trabecula.io.tiff",
        "pages along z; ImageJ and OME metadata; deflate",
        picture=True,
    ),
    ZARR,
    Format(
        "NumPy",
        (".npy",),
        "trabecula.io.npy",
        "plain array; its metadata are in NAME.npy.json beside it",
        resolution=False,
    ),
    Format(
        "MetaImage",
        (".mhd", ".raw"),
        "trabecula.io.metaimage",
        "text header with .raw voxels beside it",
    ),
    Format(
        "MetaImage", (".mha",), "trabecula.io.metaimage", "header and compressed voxels in one file"
    ),
    Format("NRRD", (".nrrd",), "trabecula.io.nrrd", "gzip"),
    Format("NIfTI", (".nii",), "trabecula.io.nifti", "as medical tools read it"),
    Format("NIfTI", (".nii.gz",), "trabecula.io.nifti", "the same, gzip"),
    Format(
        "VTK ImageData",
        (".vti",),
        "trabecula.io.vti",
        "voxels as cells, zlib, for ParaView",
        datasets=True,
    ),
    Format(
        "PNG",
        (".png",),
        "trabecula.io.raster",
        "2-D; labels are spread from black to white",
        ndim=(2,),
        picture=True,
    ),
    Format(
        "JPEG",
        (".jpg", ".jpeg"),
        "trabecula.io.raster",
        "2-D grey or colour; lossy, so it starts a new recipe",
        ndim=(2,),
        picture=True,
        lossy=True,
    ),
    Format(
        "BMP",
        (".bmp",),
        "trabecula.io.raster",
        "2-D; its metadata are in NAME.bmp.json beside it",
        ndim=(2,),
        picture=True,
        resolution=False,
    ),
)


@cache
def suffixes() -> dict[str, Format]:
    """Return every suffix that is read and written, with its format.

    A folder of slices has none. An entry point that cannot be loaded, or whose suffix is taken, is
    reported and left out.
    """
    found = {suffix: form for form in FORMATS for suffix in form.suffixes}
    for point in sorted(entry_points(group=GROUP), key=lambda point: (point.name, point.value)):
        try:
            form = point.load()
            taken = [suffix for suffix in form.suffixes if suffix in found]
        except Exception as error:  # noqa: BLE001  # another distribution's code
            notify(
                f"the format {point.name} ({point.value}) cannot be loaded "
                f"({type(error).__name__}: {error}): update or remove its package"
            )
            continue
        if taken:
            notify(f"the format {point.name} ({point.value}) is left out: {taken[0]} is taken")
            continue
        found |= dict.fromkeys(form.suffixes, form)
    return found


@cache
def _longest_first() -> tuple[str, ...]:
    return tuple(sorted(suffixes(), key=len, reverse=True))  # ".nii.gz" before ".gz"


def suffix_of(path: str | os.PathLike[str]) -> str | None:
    """Return the known suffix of a path in lower case, or None."""
    name = Path(path).name.lower()
    return next((suffix for suffix in _longest_first() if name.endswith(suffix)), None)


def format_of(path: str | os.PathLike[str]) -> Format:
    """Return the format that a path's suffix stands for.

    Raises
    ------
    UnknownNameError
        The suffix is in no row of the table, or there is none.
    """
    suffix = suffix_of(path) or Path(path).suffix.lower()
    if not suffix:
        raise UnknownNameError(
            f"{path} has no suffix to tell its format: known are {', '.join(suffixes())}; "
            "a folder of slices ends in '/'"
        )
    check_name(suffix, suffixes(), name="suffix")
    return suffixes()[suffix]
