"""Write tetrahedra for solvers: .vtu, .msh, .inp."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from trabecula.core.checks import check_name
from trabecula.engine.files import replacing
from trabecula.mesh.bricks.abaqus import set_names, write_material, write_set
from trabecula.mesh.bricks.export import DEFAULT_MODULI, Moduli, as_moduli
from trabecula.mesh.gmsh import write_msh
from trabecula.mesh.tetrahedra.base import Tetrahedra
from trabecula.mesh.text import format_rows, recipe_lines
from trabecula.mesh.vtu import write_vtu

SUFFIXES = (".vtu", ".msh", ".inp")


def write_tetrahedra(
    mesh: Tetrahedra, path: str | os.PathLike[str], *, moduli: Moduli = DEFAULT_MODULI
) -> Path:
    """Write tetrahedra; the file appears whole or not at all.

    Parameters
    ----------
    mesh : Tetrahedra
    path : path
        `.vtu` (ParaView, MFEM, meshio), `.msh` (Gmsh, FEniCSx, MFEM) or `.inp` (Abaqus, CalculiX:
        C3D4, a set of elements for each phase, sets of the nodes on the faces of the image).
    moduli : (E, nu), or mapping from the name of a phase to (E, nu)
        Of .inp.

    Raises
    ------
    UnknownNameError
        Another suffix, a phase that has no tetrahedra.
    FileError
        The file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    check_name(suffix, SUFFIXES, name="format of tetrahedra")
    with replacing(path) as temporary:
        if suffix == ".vtu":
            write_vtu(mesh.elements(), temporary)
        elif suffix == ".msh":
            write_msh(mesh.elements(), temporary)
        else:
            _write_inp(mesh, temporary, as_moduli(moduli, list(mesh.volume)))
    return path


def _write_inp(mesh: Tetrahedra, path: Path, moduli: Mapping[str, tuple[float, float]]) -> None:
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write("*HEADING\ntrabecula\n")
        file.write(f"** trabecula: tetrahedra, coordinates in {mesh.unit}, axes x, y, z\n")
        file.write("** recipe\n")
        file.writelines(f"**  {line}\n" for line in recipe_lines(mesh.recipe))
        file.write("*NODE, NSET=NALL\n")
        numbers = np.arange(1, len(mesh.points) + 1)
        file.writelines(
            format_rows("%d, %.9g, %.9g, %.9g\n", np.column_stack([numbers, mesh.points]))
        )
        phases = list(mesh.volume)
        names = set_names(tuple(phases))
        for phase, name in zip(phases, names, strict=True):
            mine = np.flatnonzero(mesh.labels == mesh.phases.index(phase))
            file.write(f"*ELEMENT, TYPE=C3D4, ELSET={name}\n")
            rows = np.column_stack([mine, mesh.cells[mine]])
            file.writelines(format_rows("%d, %d, %d, %d, %d\n", rows, offset=1))
        file.write("*ELSET, ELSET=EALL\n" + "".join(f"{name}\n" for name in names))
        for name, nodes in mesh.face_nodes().items():
            if len(nodes):
                write_set(file, name.upper(), nodes)
        for phase, name in zip(phases, names, strict=True):
            write_material(file, name, moduli[phase])
