"""The table of suffixes. A format is a module of this folder, loaded when one of its suffixes is
first met.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from trabecula.core.checks import check_name
from trabecula.core.errors import UnknownNameError


@dataclass(frozen=True)
class Format:
    """A format of file.

    Parameters
    ----------
    name : str
        As messages call it.
    home : str
        The module of this folder with `read(path) -> Content` and `write(image, path) -> Path`.
    note : str
        One line for the docs and the command line.
    folder : bool
        Whether it is a folder instead of a file.
    levels : bool
        Whether coarser levels may lie beside the voxels, so that `read(path, level)` takes one.
    """

    name: str
    home: str
    note: str
    folder: bool = False
    levels: bool = False

    def function(self, verb: str) -> Callable[..., Any]:
        """The format's "read" or "write"."""
        return getattr(importlib.import_module(f"trabecula.io.{self.home}"), verb)


_TIFF = Format("TIFF", "tiff", "pages along z; ImageJ and OME metadata; deflate")
_META = Format("MetaImage", "metaimage", "text header with .raw voxels beside it")
_JPEG = Format("JPEG", "raster", "2-D grey or colour; lossy, so it starts a new recipe")

FORMATS: dict[str, Format] = {
    ".tif": _TIFF,
    ".tiff": _TIFF,
    ".zarr": Format(
        "Zarr",
        "omezarr",
        "version 3, sharded, zstd; OME-Zarr 0.5 axes, scale and levels",
        folder=True,
        levels=True,
    ),
    ".npy": Format("NumPy", "npy", "plain array; what it means lies in NAME.npy.json beside it"),
    ".mhd": _META,
    ".raw": _META,
    ".mha": Format("MetaImage", "metaimage", "header and compressed voxels in one file"),
    ".nrrd": Format("NRRD", "nrrd", "gzip"),
    ".nii": Format("NIfTI", "nifti", "as medical tools read it"),
    ".nii.gz": Format("NIfTI", "nifti", "the same, gzip"),
    ".vti": Format("VTK ImageData", "vti", "voxels as cells, zlib, for ParaView"),
    ".png": Format("PNG", "raster", "2-D; labels are spread from black to white"),
    ".jpg": _JPEG,
    ".jpeg": _JPEG,
    ".bmp": Format("BMP", "raster", "2-D; what it means lies in NAME.bmp.json beside it"),
}

SLICES = Format(
    "folder of slices",
    "slices",
    "one picture per z in natural order; a path that ends in /",
    folder=True,
)


def suffixes() -> dict[str, Format]:
    """Every suffix that is read and written, with its format (a folder of slices has none)."""
    return dict(FORMATS)


def suffix_of(path: str | os.PathLike[str]) -> str | None:
    """The known suffix of a path, lower case (".nii.gz" before ".gz"), or None."""
    name = Path(path).name.lower()
    return next(
        (suffix for suffix in sorted(FORMATS, key=len, reverse=True) if name.endswith(suffix)), None
    )


def format_of(path: str | os.PathLike[str]) -> Format:
    """The format that a path's suffix stands for.

    Raises
    ------
    UnknownNameError
        The suffix is in no row of the table, or there is none.
    """
    suffix = suffix_of(path) or Path(path).suffix.lower()
    if not suffix:
        known = ", ".join(FORMATS)
        raise UnknownNameError(
            f"{path} has no suffix to tell its format: known are {known}; a folder of slices ends in '/'"
        )
    check_name(suffix, FORMATS, name="suffix")
    return FORMATS[suffix]
