"""The table of formats that networks and bodies are written in.

What is written is a mapping from names, as of OpenPNM, to arrays: of points ("pore.coords", or
another first word for bodies) and of the lines between them ("throat.conns").
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from trabecula.core.checks import check_name
from trabecula.engine.files import replacing
from trabecula.io.networks import columns, statoil, vtp

Tables = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class NetworkFormat:
    """A format: what it is, and what writes it."""

    suffix: str
    about: str
    write: Callable[[Tables, Path], list[Path]]


def write_tables(tables: Tables, path: str | PathLike[str]) -> list[Path]:
    """Write the tables; the suffix chooses the format. Return what was written.

    Raises
    ------
    UnknownNameError
        A suffix of no format.
    FileError
        The place cannot be written.
    """
    place = Path(path)
    suffix = place.suffix.lower()
    check_name(suffix, tuple(FORMATS), name="format of a network")
    return FORMATS[suffix].write(tables, place)


def _write_npz(tables: Tables, path: Path) -> list[Path]:
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **tables)  # type: ignore[arg-type]
    return [path]


def _write_json(tables: Tables, path: Path) -> list[Path]:
    with replacing(path) as temporary:
        text = json.dumps({name: values.tolist() for name, values in tables.items()})
        temporary.write_text(text + "\n", encoding="utf-8")
    return [path]


FORMATS = {
    one.suffix: one
    for one in (
        NetworkFormat(".npz", "arrays by the names of OpenPNM and PoreSpy", _write_npz),
        NetworkFormat(".csv", "a table as OpenPNM reads and writes", columns.write),
        NetworkFormat(".json", "lists by the same names", _write_json),
        NetworkFormat(".vtp", "points and lines for ParaView", vtp.write),
        NetworkFormat(".dat", "Statoil: _link1, _link2, _node1 and _node2", statoil.write),
    )
}
"""Formats of networks by suffix."""
