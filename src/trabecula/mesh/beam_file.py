"""Beam lattices as 3MF (beam lattice extension 1.2): a few MB that one can edit."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from trabecula.core.errors import InputError
from trabecula.engine.files import replacing
from trabecula.mesh.beams import BeamLattice
from trabecula.mesh.sizes import notify_size
from trabecula.mesh.text import format_rows
from trabecula.mesh.threemf import BEAMS, opened_model

_EXTENSION = f' xmlns:b="{BEAMS[1:-1]}" requiredextensions="b"'
_SHORTEST = 1e-6  # of the longest side: shorter beams may be left out by a reader


def write_beams(lattice: BeamLattice, path: str | os.PathLike[str]) -> Path:
    """Write beams with balls at their ends; the file appears whole or not at all.

    Parameters
    ----------
    lattice : BeamLattice
    path : path
        `.3mf`.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        Another suffix, or no beams.
    FileError
        The file cannot be written.

    References
    ----------
    3MF Consortium, Beam Lattice Extension, version 1.2.0, sections 2.1 to 2.3.
    """
    path = Path(path)
    if path.suffix.lower() != ".3mf":
        raise InputError(f"{path}: beams are written as .3mf; name it so")
    if not len(lattice.beams):
        raise InputError("there are no beams to write")
    extent = np.ptp(lattice.vertices, axis=0)
    with (
        replacing(path) as temporary,
        opened_model(temporary, lattice.unit, lattice.recipe, _EXTENSION) as (file, factor),
    ):
        file.write('<object id="1" type="model">\n<mesh>\n<vertices>\n')
        rows = lattice.vertices * factor
        file.writelines(format_rows('<vertex x="%.7g" y="%.7g" z="%.7g"/>\n', rows))
        least = max(float(extent.max()), float(lattice.radii.max())) * factor * _SHORTEST
        usual = float(np.median(lattice.radii)) * factor
        file.write(
            "</vertices>\n<triangles/>\n"
            f'<b:beamlattice minlength="{least:.6g}" radius="{usual:.6g}" cap="sphere">\n'
            "<b:beams>\n"
        )
        for (v1, v2), (r1, r2) in zip(lattice.beams, lattice.radii * factor, strict=True):
            file.write(f'<b:beam v1="{v1}" v2="{v2}" r1="{r1:.6g}" r2="{r2:.6g}"/>\n')
        file.write("</b:beams>\n</b:beamlattice>\n</mesh>\n</object>\n")
    notify_size(extent[::-1] + 2 * float(lattice.radii.max()), lattice.unit)
    return path
