"""How large a surface is in millimetres, in which printers think; and what to say of it where it is
written.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from trabecula.core.progress import notify
from trabecula.mesh.base import Mesh
from trabecula.mesh.formats import metres

SMALLEST, LARGEST = 0.1, 2000.0
"""Millimetres: longest sides beyond which a part is more likely in another unit than meant."""


def extent_of(mesh: Mesh) -> tuple[float, ...]:
    """Return the sides of the smallest box around the faces along z, y, x, in the mesh's unit."""
    if not len(mesh.faces):
        return (0.0, 0.0, 0.0)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    # in pieces: the corners of all faces would double the memory
    for start in range(0, len(mesh.faces), 1 << 18):
        points = mesh.vertices[mesh.faces[start : start + (1 << 18)]]
        low, high = (
            np.minimum(low, points.min(axis=(0, 1))),
            np.maximum(high, points.max(axis=(0, 1))),
        )
    return tuple((high - low)[::-1].tolist())


def size_text(extent: Sequence[float], unit: str) -> str:
    """Return a size in millimetres as words; one without a unit as it is written, one voxel for 1
    mm.
    """
    factor = (metres(unit) or 1e-3) * 1000
    return " x ".join(f"{side * factor:.4g}" for side in extent) + " mm (z, y, x)"


def size_notes(extent: Sequence[float], unit: str) -> Iterator[str]:
    """Yield what there is to say of a part that is written: a unit that is not known, a size that
    is hardly meant.
    """
    text = size_text(extent, unit)
    if metres(unit) is None:
        known = "give its spacing and unit (--spacing, --unit)"
        yield f"unit unknown: a length of 1 was written as 1 mm, the part is {text}; {known}"
        return
    longest = max(extent) * (metres(unit) or 0) * 1000
    if longest > LARGEST or 0 < longest < SMALLEST:
        much = "more than 2 m" if longest > LARGEST else "less than 0.1 mm"
        yield f"the part is {text}, {much}: is {unit} its unit? give another (--spacing, --unit), or scale it (--scale)"


def say_size(extent: Sequence[float], unit: str) -> None:
    """Say what `size_notes` yields to whoever listens."""
    for note in size_notes(extent, unit):
        notify(note)
