"""The size of a surface in millimetres, the unit of printers, and notices about it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from trabecula.core.progress import notify
from trabecula.mesh.base import Mesh
from trabecula.mesh.text import metres

SMALLEST, LARGEST = 0.1, 2000.0
"""Millimetres: longest sides beyond which the unit is more likely wrong."""


def extent_of(mesh: Mesh) -> tuple[float, ...]:
    """Return the sides of the smallest box around the faces along z, y, x, in the mesh's unit."""
    if not len(mesh.faces):
        return (0.0, 0.0, 0.0)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    # In chunks: the corners of all faces would double the memory.
    for start in range(0, len(mesh.faces), 1 << 18):
        points = mesh.vertices[mesh.faces[start : start + (1 << 18)]]
        low = np.minimum(low, points.min(axis=(0, 1)))
        high = np.maximum(high, points.max(axis=(0, 1)))
    return tuple((high - low)[::-1].tolist())


def size_text(extent: Sequence[float], unit: str) -> str:
    """Return a size in millimetres as text; without a unit one voxel is written as 1 mm."""
    factor = (metres(unit) or 1e-3) * 1000
    return " x ".join(f"{side * factor:.4g}" for side in extent) + " mm (z, y, x)"


def size_notes(extent: Sequence[float], unit: str) -> Iterator[str]:
    """Yield the notices about a part that is written: an unknown unit, an unlikely size."""
    text = size_text(extent, unit)
    if metres(unit) is None:
        known = "give its spacing and unit (--spacing, --unit)"
        yield f"unit unknown: a length of 1 was written as 1 mm, the part is {text}; {known}"
        return
    longest = max(extent) * (metres(unit) or 0) * 1000
    if longest > LARGEST or 0 < longest < SMALLEST:
        much = "more than 2 m" if longest > LARGEST else "less than 0.1 mm"
        yield (
            f"the part is {text}, {much}: is {unit} its unit? give another (--spacing, --unit), or "
            "scale it (--scale)"
        )


def notify_size(extent: Sequence[float], unit: str) -> None:
    """Notify the listeners of what `size_notes` yields."""
    for note in size_notes(extent, unit):
        notify(note)
