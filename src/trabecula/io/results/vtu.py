"""VTK UnstructuredGrid (.vtu): what OpenFOAM's foamToVTK, FEniCSx, MFEM and ParaView write."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from functools import partial
from pathlib import Path

import numpy as np

from trabecula.core.errors import InputError
from trabecula.io.guard import check_claim
from trabecula.io.results.content import ResultArray, SolverResult, group_cells
from trabecula.io.vtk_xml import VtkFile, parse

PLACES = {"PointData": "points", "CellData": "cells"}


def open_result(path: Path) -> SolverResult:
    """Open a .vtu of one piece (see `io.results.open_result`)."""
    whole = parse(path)
    grid = whole.root.find("UnstructuredGrid")
    pieces = [] if grid is None else grid.findall("Piece")
    if len(pieces) != 1:
        raise InputError(
            f"{path} holds {len(pieces)} pieces of an UnstructuredGrid, one is read: merge them "
            "in ParaView"
        )
    piece = pieces[0]
    count = int(piece.get("NumberOfPoints", ""))
    cells = int(piece.get("NumberOfCells", ""))
    points = piece.find("Points/DataArray")
    if points is None:
        raise ValueError("it holds no points")
    parts = {array.get("Name"): array for array in piece.findall("Cells/DataArray")}
    offsets = _numbers(whole, parts["offsets"], (cells,)).astype(np.int64)
    if len(offsets) and (offsets[-1] < 0 or (np.diff(offsets) < 0).any()):
        raise ValueError("the offsets of its cells do not rise")
    blocks = group_cells(
        _numbers(whole, parts["connectivity"], (int(offsets[-1]),)),
        offsets,
        _numbers(whole, parts["types"], (cells,)),
        count,
    )
    sizes = {"points": count, "cells": cells}
    return SolverResult(
        path,
        "VTK UnstructuredGrid",
        list_arrays(whole, piece, sizes),
        points=_numbers(whole, points, (count, 3)).astype(np.float64),
        blocks=blocks,
        scalars=preferred(piece),
        note=whole.text,
    )


def list_arrays(
    whole: VtkFile, piece: ElementTree.Element, sizes: dict[str, int]
) -> tuple[ResultArray, ...]:
    """Return the arrays of numbers on the points and cells of a piece."""
    found = []
    for tag, place in PLACES.items():
        for array in piece.findall(f"{tag}/DataArray"):
            channels = int(array.get("NumberOfComponents", "1"))
            if not 1 <= channels <= 81:
                raise ValueError(f"an array claims {channels} components")
            load = partial(_numbers, whole, array, (sizes[place], channels))
            found.append(ResultArray(array.get("Name", "unnamed"), place, channels, load))
    return tuple(found)


def preferred(piece: ElementTree.Element) -> str:
    """Return the name of the scalars that a piece prefers, of cells first; else empty."""
    nodes = [piece.find(tag) for tag in ("CellData", "PointData")]
    return next((name for node in nodes if node is not None if (name := node.get("Scalars"))), "")


def _numbers(whole: VtkFile, array: ElementTree.Element, shape: tuple[int, ...]) -> np.ndarray:
    check_claim(whole.path, shape, whole.dtype(array), stored=whole.room(array))
    return whole.values(array, shape)
