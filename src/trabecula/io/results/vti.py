"""VTK ImageData (.vti) with any arrays on points or cells."""

from __future__ import annotations

from math import prod
from pathlib import Path

from trabecula.core.errors import InputError
from trabecula.io.results.content import RegularGrid, SolverResult
from trabecula.io.results.vtu import list_arrays, preferred
from trabecula.io.vtk_xml import parse


def open_result(path: Path) -> SolverResult:
    """Open a .vti of one piece (see `io.results.open_result`)."""
    whole = parse(path)
    grid = whole.root.find("ImageData")
    pieces = [] if grid is None else grid.findall("Piece")
    if grid is None or len(pieces) != 1:
        raise InputError(
            f"{path} holds {len(pieces)} pieces of ImageData, one is read: merge them in ParaView"
        )
    words = pieces[0].get("Extent", grid.get("WholeExtent", "")).split()
    low_high = [int(word) for word in words]
    low = low_high[::2]
    cells = [high - start for start, high in zip(low, low_high[1::2], strict=True)]
    if len(cells) != 3 or min(cells) < 1:
        raise InputError(
            f"{path} has the extent {' '.join(words)}: a volume is needed, three axes of cells"
        )
    spacing = [abs(float(edge)) for edge in grid.get("Spacing", "1 1 1").split()]
    zero = [float(edge) for edge in grid.get("Origin", "0 0 0").split()]
    origin = [at + start * edge for at, start, edge in zip(zero, low, spacing, strict=True)]
    if min(spacing) <= 0:
        raise ValueError("its spacing is not positive")
    sizes = {"points": prod(side + 1 for side in cells), "cells": prod(cells)}
    return SolverResult(
        path,
        "VTK ImageData",
        list_arrays(whole, pieces[0], sizes),
        lattice=RegularGrid(
            (origin[0], origin[1], origin[2]),
            (spacing[0], spacing[1], spacing[2]),
            (cells[2], cells[1], cells[0]),
        ),
        scalars=preferred(pieces[0]),
    )
