"""The table of formats that are read alone: scanners' own files, and results of solvers.

A reader declares itself in one row of `READERS`; its module has `read`, and is loaded when a file
of it is first met. Packages that it needs come with an extra. Another distribution adds a reader by
an entry point that names a `Reader`:

    [project.entry-points."trabecula.readers"]
    rek = "rek_package:READER"
"""

from __future__ import annotations

import importlib
import re
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from trabecula.core.progress import notify
from trabecula.io.formats import suffixes
from trabecula.io.metadata import FileContent

GROUP = "trabecula.readers"
"""Group of the entry points of readers."""


@dataclass(frozen=True)
class Reader:
    """A format of file that is read, not written.

    Parameters
    ----------
    name : str
        As messages call it.
    suffixes : tuple of str
        In lower case, with their dot. Empty where files have none.
    module : str
        Dotted name of the module with `read(path) -> FileContent`; of one with `datasets`
        `read(path, dataset)`, where None is the only one.
    note : str
        One line for the docs.
    extra : str
        That brings the packages it needs; empty where there are none.
    datasets : bool
        A file may hold several arrays, of which `tb.read(..., dataset=NAME)` takes one.
    recognises : bool
        The module has `recognises(path) -> bool`, for folders and for files without a suffix that
        is known. It must not need the packages of the extra.
    """

    name: str
    suffixes: tuple[str, ...]
    module: str
    note: str
    extra: str = ""
    datasets: bool = False
    recognises: bool = False

    # what `files.read` asks of every format
    folder = False
    lazy = False

    def load(self) -> Any:
        """Import the reader's module."""
        return importlib.import_module(self.module)

    def read(self, path: Any, *arguments: Any) -> FileContent:
        """Read a path, of one with `datasets` also the name of an array in it."""
        found: FileContent = self.load().read(path, *arguments)
        return found


READERS = (
    Reader(
        "DICOM",
        (".dcm", ".dicom", ".ima"),
        "trabecula.io.dicom",
        "a series in a folder, or one file; grey values by rescale slope and intercept",
        extra="dicom",
        datasets=True,
        recognises=True,
    ),
    Reader(
        "HDF5",
        (".h5", ".hdf5", ".hdf", ".nxs", ".nx"),
        "trabecula.io.hdf5",
        "one data set of a file; NeXus, Data Exchange, DREAM.3D and Dragonfly-like voxel sizes",
        extra="hdf5",
        datasets=True,
    ),
    Reader(
        "Scanco ISQ",
        (".isq",),
        "trabecula.io.isq",
        "attenuation as the scanner counts it (divide by mu_scaling for 1/cm), with its spacing",
    ),
    Reader(
        "Nikon volume",
        (".vgi",),
        "trabecula.io.nikon",
        "text header beside a .vol of voxels",
    ),
    Reader(
        "VTK UnstructuredGrid",
        (".vtu",),
        "trabecula.io.vtu",
        "bricks of one size back on their grid: what `trabecula export` wrote, or a solver",
        datasets=True,
    ),
)


@cache
def readers() -> tuple[Reader, ...]:
    """Return our readers, then those of other distributions.

    An entry point that cannot be loaded, or whose suffix is taken, is reported and left out.
    """
    found = list(READERS)
    taken = {*suffixes(), *(suffix for one in READERS for suffix in one.suffixes)}
    for point in sorted(entry_points(group=GROUP), key=lambda point: (point.name, point.value)):
        try:
            reader = point.load()
            twice = [suffix for suffix in reader.suffixes if suffix in taken]
        except Exception as error:  # noqa: BLE001  # another distribution's code
            notify(
                f"the reader {point.name} ({point.value}) cannot be loaded "
                f"({type(error).__name__}: {error}): update or remove its package"
            )
            continue
        if twice:
            notify(f"the reader {point.name} ({point.value}) is left out: {twice[0]} is taken")
            continue
        taken |= set(reader.suffixes)
        found.append(reader)
    return tuple(found)


def reader_of(path: Path) -> Reader | None:
    """Return the reader of a path by its suffix; None where none has it."""
    # VMS, on which Scanco's scanners run, numbers the versions of a file: C0001234.ISQ;1
    name = re.sub(r";\d+$", "", path.name.lower())
    return next((one for one in readers() if one.suffixes and name.endswith(one.suffixes)), None)


def recognise(path: Path) -> Reader | None:
    """Return the reader that recognises a folder, or a file without a suffix, by its content."""
    able = (one for one in readers() if one.recognises)
    return next((one for one in able if one.load().recognises(path)), None)
