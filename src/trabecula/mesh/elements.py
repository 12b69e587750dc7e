"""Elements of volume as files of other programs take them: nodes, cells, phases, part by part."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.recipe import Recipe

Parts = Callable[[], Iterator[np.ndarray]]


@dataclass(frozen=True, eq=False)
class Elements:
    """Bricks or tetrahedra that are read as often as a format needs.

    Parameters
    ----------
    nodes, cells : int
    corners : int
        Of a cell: 8 of a brick, in the order of VTK, or 4 of a tetrahedron.
    points : callable
        Yields (n, 3) float64: x, y, z.
    members : callable
        Yields (n, corners) numbers of nodes, from 0.
    labels : callable
        Yields (n,) uint8: numbers in `phases`.
    phases : tuple of str
    unit : str
    recipe : Recipe
    shape, spacing : tuple, (z, y, x), optional
        Of the grid that bricks are the voxels of, with a corner at 0.
    """

    nodes: int
    cells: int
    corners: int
    points: Parts
    members: Parts
    labels: Parts
    phases: tuple[str, ...]
    unit: str
    recipe: Recipe
    shape: tuple[int, ...] = ()
    spacing: tuple[float, ...] = ()


def write_parts(file: BinaryIO, size: int, parts: Iterator[np.ndarray]) -> None:
    """Write arrays one after the other.

    Raises
    ------
    InputError
        They are not `size` bytes: what they are read from has changed.
    """
    if sum(file.write(part.tobytes()) for part in parts) != size:
        raise InputError(
            "the volume changed while it was read: export it when nothing writes to it"
        )


def file_size(path: Path) -> int:
    """Return the bytes of a file, or of all files of a folder."""
    files = [path] if path.is_file() else [one for one in path.rglob("*") if one.is_file()]
    return sum(one.stat().st_size for one in files)
