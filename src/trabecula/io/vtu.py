"""VTK UnstructuredGrid (.vtu) of voxel bricks: the cells go back into their grid.

What `trabecula export` wrote (`mesh.vtu`) says its unit, shape, spacing and phases in a
comment. Of others the grid is that of their bricks, which must all be boxes of one size, from the
mesh's first corner on. A voxel without a brick is 0, of our labels "void".
"""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.errors import InputError
from trabecula.io.guard import check_claim, report_damage
from trabecula.io.metadata import KEY, FileContent, check_fields
from trabecula.io.results import open_result
from trabecula.io.results.content import SolverResult

_PHASE = "phase"
"""Our cell data with labels."""

_ROUND = 1e-3
"""Share of an edge by which a brick may differ from the grid."""


def read(path: Path, dataset: str | None = None) -> FileContent:
    """Read the bricks of a .vtu as a volume (see `trabecula.io.files.read`).

    Raises
    ------
    InputError
        Cells that are no bricks of one grid, several arrays of which none is named, an array of
        several components or on points.
    """
    result = open_result(path)
    with report_damage(path, "VTK UnstructuredGrid"):
        own = _comment(result.note)
        if dataset is None:
            names = [one.name for one in result.arrays]
            dataset = _PHASE if own and _PHASE in names else result.scalars or None
        array = result.array(dataset)
        if array.components > 1 or array.place != "cells":
            raise InputError(
                f"{path}: {array} is no volume by itself: read a component of it as a field "
                "(tb.fields.import_result, trabecula field import)"
            )
        edges, at = _bricks(result, own)
        sides = [int(side) for side in (own.get("shape") or (at.max(axis=0) + 1)[::-1])]
        shape = (sides[0], sides[1], sides[2])
        if at.min() < 0 or (at.max(axis=0)[::-1] >= shape).any():
            raise ValueError("its bricks lie outside of its grid")
        values = result.values(array)[:, 0]
        check_claim(path, shape, values.dtype)
        labels = own and array.name == _PHASE
        phases = own["phases"] if labels else []
        empty = phases.index("void") if "void" in phases else 0
        volume = np.full(shape, empty, values.dtype.newbyteorder("="))
        numbers = np.concatenate([block.numbers for block in result.blocks])
        volume[at[:, 2], at[:, 1], at[:, 0]] = values[numbers]
    spacing = (float(edges[2]), float(edges[1]), float(edges[0]))
    if not labels:
        return FileContent(volume, spacing=spacing, unit=own.get("unit"))
    fields = {"kind": "labels", "spacing": list(spacing), "unit": own["unit"], "phases": phases}
    return FileContent(
        volume, spacing=spacing, unit=own["unit"], fields=check_fields({**fields, "recipe": []})
    )


def _comment(note: str) -> dict[str, Any]:
    """Return our comment in front of the file; empty where there is none."""
    found = re.search(r"<!-- (\{.*\}) -->", note, re.DOTALL)
    if not found:
        return {}
    try:
        own = json.loads(html.unescape(found[1]))[KEY]
    except (ValueError, LookupError, TypeError):
        return {}
    known = isinstance(own, dict) and isinstance(own.get("unit"), str)
    return own if known and isinstance(own.get("phases"), list) else {}


def _bricks(result: SolverResult, own: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges of a brick, and the place of every brick in the grid, both along x, y, z."""
    assert result.points is not None
    odd = [block.kind for block in result.blocks if block.kind != "hexahedron"]
    if odd:
        raise InputError(
            f"{result.path} holds {odd[0]} cells, no bricks of one size: read it as a field on a "
            "grid that you give (tb.fields.import_result, trabecula field import)"
        )
    nodes = np.concatenate([block.nodes for block in result.blocks])
    low = np.full((len(nodes), 3), np.inf)
    high = -low
    for corner in nodes.T:  # a corner at a time: eight of all bricks would be 200 bytes a brick
        np.minimum(low, result.points[corner], out=low)
        np.maximum(high, result.points[corner], out=high)
    edges = np.median(high - low, axis=0)
    if (edges <= 0).any() or (np.abs(high - low - edges) > _ROUND * edges).any():
        raise InputError(
            f"{result.path} holds cells of several sizes: read it as a field on a grid that you "
            "give (tb.fields.import_result, trabecula field import)"
        )
    if own.get("spacing"):
        edges = np.array(own["spacing"], float)[::-1]
    start = np.zeros(3) if own.get("shape") else low.min(axis=0)
    place = (low - start) / edges
    at = np.rint(place).astype(np.int64)
    if (np.abs(place - at) > 0.01).any():
        raise InputError(f"{result.path} holds bricks that do not lie on one grid")
    return edges, at
