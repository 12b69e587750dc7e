"""Abaqus and CalculiX input (.inp): nodes, C3D8 bricks, sets, materials, equations and a step.

Numbers begin at 1. Sets: every phase by its name, EALL, NALL, the nodes of the six faces X_LOW ..
Z_HIGH; of the periodic case REF_X, REF_Y, REF_Z. Keywords as both programs read them (Abaqus
Keywords Reference Guide; Dhondt, CalculiX CrunchiX USER'S MANUAL 2.20).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TextIO

import numpy as np

from trabecula.mesh.bricks.context import ExportContext
from trabecula.mesh.bricks.faces import AXES
from trabecula.mesh.bricks.grid import BrickGrid
from trabecula.mesh.bricks.load_case import LoadCase, reference_name
from trabecula.mesh.text import format_rows, recipe_lines

_BRICK = "%d, %d, %d, %d, %d, %d, %d, %d, %d\n"
_ACROSS = 10
"""Numbers in a line of a set: 16 is the most."""


def write(grid: BrickGrid, path: Path, context: ExportContext) -> None:
    """Write the bricks, and the load case where there is one; three passes over the voxels, and one
    for each further phase.
    """
    with path.open("w", encoding="ascii", newline="\n") as file:
        _write_head(file, grid, context)
        _write_nodes(file, grid, context)
        names = set_names(grid.names)
        for number, name in enumerate(names):
            _write_bricks(file, grid, number, name)
        file.write("*ELSET, ELSET=EALL\n" + "".join(f"{name}\n" for name in names))
        _write_faces(file, context)
        for phase, name in zip(grid.names, names, strict=True):
            write_material(file, name, context.moduli[phase])
        if context.case:
            _write_case(file, grid, context.case)


def set_names(phases: tuple[str, ...]) -> list[str]:
    """Return names of sets for phases: letters, digits and underscores, each once, at most 60
    characters, none of those that this file uses itself.
    """
    own = {"EALL", "NALL", *(f"{a}_{e}" for a in "XYZ" for e in ("LOW", "HIGH"))}
    own |= {reference_name(axis) for axis in AXES}
    found: list[str] = []
    for phase in phases:
        name = re.sub(r"\W", "_", phase, flags=re.ASCII)[:60].upper()
        name = name if name[:1].isalpha() else f"P_{name}"
        trial, count = name, 1
        while trial in own or trial in found:
            count += 1
            trial = f"{name}_{count}"
        found.append(trial)
    return found


def write_material(file: TextIO, name: str, moduli: tuple[float, float]) -> None:
    """Write the constants of a phase, and that its elements are made of it."""
    young, poisson = moduli
    file.write(f"*MATERIAL, NAME={name}\n*ELASTIC\n{young:.9g}, {poisson:.9g}\n")
    file.write(f"*SOLID SECTION, ELSET={name}, MATERIAL={name}\n")


def _write_head(file: TextIO, grid: BrickGrid, context: ExportContext) -> None:
    sides = " x ".join(map(str, grid.volume.shape))
    edges = " x ".join(f"{edge:.9g}" for edge in grid.volume.spacing)
    lines = [
        f"trabecula: {sides} voxels (z, y, x) of {edges} {context.unit}",
        f"coordinates in {context.unit}, axes x, y, z",
    ]
    if context.case:
        lines += _reading(grid, context.case)
    file.write("*HEADING\ntrabecula\n" + "".join(f"** {line}\n" for line in lines))
    file.write("** recipe\n" + "".join(f"**  {line}\n" for line in recipe_lines(context.recipe)))


def _reading(grid: BrickGrid, case: LoadCase) -> list[str]:
    """Return how to read the result, for the comments."""
    sides = {
        axis: side * edge
        for axis, side, edge in zip(AXES, grid.volume.shape, grid.volume.spacing, strict=True)
    }
    area = float(np.prod([side for axis, side in sides.items() if axis != case.axis]))
    strain, length = abs(case.extension) / sides[case.axis], sides[case.axis]
    about = f"load case: {case.name} along {case.axis}"
    if case.pull:
        return [
            f"{about}, mean stress {case.pull / area:.9g}, force {case.pull:.9g}",
            f"Young's modulus = {case.pull / area:.9g} x {length:.9g} / displacement U{case.dof}",
            f"of the set {case.loaded.upper()}, in units of *ELASTIC",
        ]
    what = "shear modulus" if case.name == "shear" else "Young's modulus"
    return [
        f"{about}, strain {strain:.9g}",
        f"{what} = force / ({area:.9g} x {strain:.9g}), the force being the sum of the",
        f"reactions RF{case.dof} of the set {case.loaded.upper()}, in units of *ELASTIC",
    ]


def _write_nodes(file: TextIO, grid: BrickGrid, context: ExportContext) -> None:
    file.write("*NODE, NSET=NALL\n")
    for k, numbers in grid.node_layers():
        points = grid.coordinates(k, numbers)
        rows = np.column_stack([numbers[numbers >= 0] + 1, points])
        file.writelines(format_rows("%d, %.9g, %.9g, %.9g\n", rows))
    if context.case:
        # beside the box, apart from each other: they stand for periods and belong to no brick
        for n in range(len(context.case.references)):
            place = ", ".join(f"{-(n + 1) * edge:.9g}" for edge in grid.volume.spacing[::-1])
            file.write(f"{grid.count.nodes + 1 + n}, {place}\n")
        for n, name in enumerate(context.case.references):
            write_set(file, name, np.array([grid.count.nodes + n]))


def _write_bricks(file: TextIO, grid: BrickGrid, number: int, name: str) -> None:
    file.write(f"*ELEMENT, TYPE=C3D8, ELSET={name}\n")
    for layer in grid.layers():
        kinds = layer.members[layer.members >= 0]
        mine = np.flatnonzero(kinds == number)
        if len(mine):
            rows = np.column_stack([layer.first + mine, layer.nodes()[mine]])
            file.writelines(format_rows(_BRICK, rows, offset=1))


def _write_faces(file: TextIO, context: ExportContext) -> None:
    if context.faces is None:
        return
    for name in context.faces.faces:
        nodes = context.faces.nodes(name)
        if len(nodes):
            write_set(file, name.upper(), nodes)


def write_set(file: TextIO, name: str, nodes: np.ndarray) -> None:
    """Write a set of nodes, whose numbers are from 0 here."""
    file.write(f"*NSET, NSET={name}\n")
    numbers = (nodes + 1).tolist()
    for start in range(0, len(numbers), _ACROSS):
        file.write(", ".join(map(str, numbers[start : start + _ACROSS])) + "\n")


def _write_case(file: TextIO, grid: BrickGrid, case: LoadCase) -> None:
    first = grid.count.nodes + 1  # of the reference nodes
    if case.pairs is not None and len(case.pairs.nodes):
        file.write("*EQUATION\n")
        rows = zip(case.pairs.nodes, case.pairs.partners, case.pairs.periods, strict=True)
        for node, partner, (z, y, x) in rows:
            terms = [(node + 1, 1.0), (partner + 1, -1.0)]
            terms += [(first + n, -float(p)) for n, p in enumerate((x, y, z)) if p]
            for dof in (1, 2, 3):
                parts = [f"{number}, {dof}, {factor:g}" for number, factor in terms]
                lines = [", ".join(parts[n : n + 4]) for n in range(0, len(parts), 4)]
                file.write(f"{len(terms)}\n" + ",\n".join(lines) + "\n")
    file.write("*STEP\n*STATIC\n*BOUNDARY\n")
    for held in case.held:
        where = held.where.upper() if isinstance(held.where, str) else str(held.where + 1)
        file.write(f"{where}, {held.dof}, {held.dof}, {held.value:.12g}\n")
    if case.pull:
        number = first + case.references.index(case.loaded)
        file.write(f"*CLOAD\n{number}, {case.dof}, {case.pull:.12g}\n")
    file.write(f"*NODE PRINT, NSET={case.loaded.upper()}, TOTALS=YES\nU, RF\n")
    file.write("*NODE FILE\nU\n*EL FILE\nS, E\n*END STEP\n")
