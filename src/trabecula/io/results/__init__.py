"""Results of solvers on meshes: points, cells and the arrays on them, one module a format."""

from __future__ import annotations

import importlib
from pathlib import Path

from trabecula.core.checks import check_name
from trabecula.io.guard import check_there, report_damage
from trabecula.io.results.content import SolverResult

FORMATS = {
    ".vtu": ("vtu", "VTK UnstructuredGrid"),
    ".vti": ("vti", "VTK ImageData"),
    ".vtk": ("legacy_vtk", "legacy VTK"),
    ".frd": ("frd", "CalculiX result"),
}
"""Suffix -> module of this folder with `open_result(path)`, and the format's name."""


def open_result(path: Path) -> SolverResult:
    """Open a result; its arrays are read when they are asked for.

    Raises
    ------
    UnknownNameError
        A suffix that no format has.
    FileError, MemoryBudgetError
        Missing, truncated or damaged; a header that claims more than the memory.
    """
    check_there(path)
    suffix = path.suffix.lower()
    check_name(suffix, FORMATS, name="format of results")
    module, form = FORMATS[suffix]
    with report_damage(path, form):
        found: SolverResult = importlib.import_module(f"{__name__}.{module}").open_result(path)
        return found
