"""`export_bricks`: voxels as bricks for a solver, streamed into a file."""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.brief import brief
from trabecula.core.checks import as_number, as_path_text, check_name, quote
from trabecula.core.errors import FileError, InputError
from trabecula.core.image import Image, as_image
from trabecula.core.progress import notify
from trabecula.engine.files import replacing
from trabecula.engine.lazy_volume import Slabs, as_slabs
from trabecula.mesh.bricks.context import ExportContext
from trabecula.mesh.bricks.faces import AXES, collect_faces
from trabecula.mesh.bricks.formats import CASES, FLOW, FORMATS, BrickFormat, brick_format
from trabecula.mesh.bricks.grid import BrickGrid
from trabecula.mesh.bricks.load_case import build_case
from trabecula.mesh.bricks.selection import Bearing, choose_bearing, choose_phases
from trabecula.mesh.elements import file_size

Moduli = tuple[float, float] | Mapping[str, tuple[float, float]]
DEFAULT_MODULI = (1.0, 0.3)
"""Young's modulus and Poisson's ratio: stresses are then in units of the modulus."""

_STRAIN = 0.01
_IN_CORE = 3
"""Bytes a voxel of a volume in memory, before a load case needs more."""


@dataclass(frozen=True)
class BrickExport:
    """What was written.

    Attributes
    ----------
    nodes : int
        Reference nodes of the periodic case are not among them.
    bricks : dict
        By phase.
    volume : float
        Of all bricks, in the cube of the unit of length.
    edge_contacts, node_contacts : int
        Edges and nodes at which bricks touch that share no face there (at nodes no edge either).
    left_out : int
        Voxels of the phases that the load case does not reach, and that are no bricks.
    pairs : int
        Nodes that depend on a partner by periodic equations.
    size : int
        Bytes of the file, or of all files of the folder.
    """

    nodes: int
    bricks: dict[str, int]
    volume: float
    edge_contacts: int
    node_contacts: int
    left_out: int
    pairs: int
    size: int

    __repr__ = brief


def export_bricks(
    volume: Image | Slabs | ArrayLike,
    path: str | os.PathLike[str],
    *,
    phases: str | int | Sequence[str | int] | None = None,
    case: str | None = None,
    axis: str = "z",
    strain: float = _STRAIN,
    moduli: Moduli = DEFAULT_MODULI,
    memory: int | None = None,
) -> BrickExport:
    """Write the voxels of some phases as bricks for a solver, plane by plane.

    Parameters
    ----------
    volume : Image or array of labels, (Z, Y, X), or Slabs
        Of `Slabs` no more than some planes are in memory; a load case, and .foam, need the labels
        of all voxels as well, 10 to 18 bytes each.
    path : path
        `.inp` (Abaqus, CalculiX), `.vtu` (ParaView, meshio), `.msh` (Gmsh, FEniCSx, MFEM), or
        `.foam`, a folder with an OpenFOAM case. It appears whole or not at all.
    phases : str, int or sequence of them, optional
        Phases that become bricks. Default: every phase but "void"; of .foam "void".
    case : {"compression", "shear", "periodic"}, optional
        A load case, of .inp (see `mesh.bricks.load_case`). Bricks that no load reaches through
        shared faces are left out and counted. Default: none, and all voxels are bricks.
    axis : {"z", "y", "x"}
        Along which it is loaded, or flows; of shear the normal of the faces that move.
    strain : float
        Of the load case, 1e-9 .. 1.
    moduli : (E, nu), or mapping from the name of a phase to (E, nu)
        Young's modulus (any unit, > 0) and Poisson's ratio (-0.99 .. 0.49) of every phase.
    memory : int, optional
        Bytes that may be used. Default: what is available.

    Returns
    -------
    BrickExport

    Raises
    ------
    UnknownNameError
        A suffix, phase, case or axis that does not exist.
    InputError
        A picture; no voxel of the phases; a phase that does not percolate along the axis of the
        load case or flow; more bricks than the format counts; a case that the format has not;
        moduli out of range.
    MemoryBudgetError
        The labels of a load case do not fit into memory.
    FileError
        The file cannot be written, or would not fit on the disk.

    Examples
    --------
    >>> import tempfile, numpy as np
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     found = export_bricks(np.ones((2, 3, 4), np.uint8), f"{folder}/block.inp")
    >>> found.nodes, found.bricks, found.volume
    (60, {'solid': 24}, 24.0)
    """
    path = Path(as_path_text(path))
    form = brick_format(path)
    slabs = volume if isinstance(volume, Slabs) else as_slabs(as_image(volume))
    check_name(axis, tuple(AXES), name="axis")
    along = AXES.index(axis)
    strain = as_number(strain, name="strain", low=1e-9, high=1.0)
    case = _as_case(form, path, case)
    if isinstance(phases, (str, int)):
        phases = [phases]
    grid = choose_phases(slabs, phases if phases is not None else _default_phases(form))
    _check_bricks(grid, form, path)
    bearing = Bearing(grid, (), 0)
    if case:
        bearing = choose_bearing(
            grid,
            along,
            periodic=case == "periodic",
            held=case in ("compression", "periodic"),
            memory=memory,
        )
        grid = bearing.grid
    count = grid.count
    given = as_moduli(moduli, grid.names)
    recipe = slabs.recipe
    faces = collect_faces(grid) if path.suffix.lower() == ".inp" else None
    load = None
    if case and case != FLOW:
        assert faces is not None
        young = max(pair[0] for pair in given.values())
        load = build_case(case, bearing, faces, axis=along, strain=strain, young=young)
        if case == "periodic" and not _repeats(slabs):
            notify(
                "the volume was not made periodic: what its faces cut counts as cut there, and it "
                "comes out too soft"
            )
    suffix = path.suffix.lower()
    context = ExportContext(slabs.unit, recipe, given, faces, load, along, suffix)
    _check_room(path, form, sum(count.bricks))
    with replacing(path) as temporary:
        form.load()(grid, temporary, context)
        size = file_size(temporary)
    return BrickExport(
        count.nodes,
        dict(zip(grid.names, count.bricks, strict=True)),
        sum(count.bricks) * math.prod(slabs.spacing),
        count.edge_contacts,
        count.node_contacts,
        bearing.left_out,
        0 if load is None or load.pairs is None else len(load.pairs.nodes),
        size,
    )


def in_core_bytes(shape: tuple[int, ...]) -> int:
    """Return about the memory of an export from a volume in memory."""
    return _IN_CORE * math.prod(shape)


def _default_phases(form: BrickFormat) -> list[str] | None:
    return None if form.phase is None else [form.phase]


def _as_case(form: BrickFormat, path: Path, case: str | None) -> str | None:
    if case is None:
        return FLOW if FLOW in form.cases else None
    check_name(case, (*CASES, FLOW), name="case")
    if case not in form.cases:
        able = [suffix for suffix, one in FORMATS.items() if case in one.cases]
        raise InputError(
            f"{path.name} holds no load case {quote(case)}: write {' or '.join(able)}, or leave "
            "--case out"
        )
    return case


def _check_bricks(grid: BrickGrid, form: BrickFormat, path: Path) -> None:
    """Raise where there is nothing to write, or more than the format counts."""
    bricks = sum(grid.count.bricks)
    if not bricks:
        raise InputError(
            f"no voxel is {' or '.join(map(quote, grid.names)) or 'solid'}: there is nothing to "
            f"write; the phases are {', '.join(grid.volume.phases)} (--phase)"
        )
    if bricks > form.most:
        raise InputError(
            f"{bricks} bricks are more than the {form.most} that {path.suffix} counts: export a "
            "crop, or a coarser level"
        )


def as_moduli(moduli: Moduli, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    given = moduli if isinstance(moduli, Mapping) else dict.fromkeys(names, moduli)
    for name in given:
        check_name(name, tuple(names), name="phase of the moduli")
    found = {}
    for name in names:
        pair: Any = given.get(name, DEFAULT_MODULI)
        if np.shape(pair) != (2,):
            raise InputError(f"moduli of {quote(name)} are {quote(pair)}: give E and nu")
        young = as_number(pair[0], name=f"Young's modulus of {name}", low=1e-300, high=1e300)
        poisson = as_number(pair[1], name=f"Poisson's ratio of {name}", low=-0.99, high=0.49)
        found[name] = (float(young), float(poisson))
    return found


def _repeats(volume: Slabs) -> bool:
    """Return whether the recipe says that the volume was made periodic."""
    return any(
        bool(np.all(step.get("periodic", step.get("request", {}).get("periodic", False))))
        for step in volume.recipe.steps
        if isinstance(step.get("request", {}), dict)
    )


def _check_room(path: Path, form: BrickFormat, bricks: int) -> None:
    folder = path.absolute().parent
    while not folder.exists():
        folder = folder.parent
    size, free = bricks * form.bytes_a_brick, shutil.disk_usage(folder).free
    if size > free:
        raise FileError(
            f"cannot write {path}: about {size >> 20} MiB are needed, {free >> 20} MiB are free in "
            f"{folder}"
        )
