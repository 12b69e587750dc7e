"""A part to be designed: a mesh as elements, with the painted meshes that its case names."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.fields.topology import Case
from trabecula.mesh.files import READABLE, read_mesh
from trabecula.mesh.voxels import mark_surface, voxelise
from trabecula.pipeline.inputs import load

ELEMENTS = 48
"""Along the longest side of a part whose number is not given."""


@dataclass(frozen=True, eq=False)
class PartElements:
    """The elements of a part."""

    image: Image
    """Labels void and solid, (Z, Y, X), with the spacing of the elements."""
    marks: dict[str, np.ndarray] = field(default_factory=dict)
    """Elements that painted meshes go through, by name."""


def load_part(
    source: str | os.PathLike[str],
    of: Case,
    *,
    elements: int | None = None,
    folders: Sequence[str | os.PathLike[str]] = (".",),
) -> PartElements:
    """Load a part from a closed surface, or from a volume of labels whose voxels are its elements.

    Parameters
    ----------
    source : path
        A surface (the suffixes of `read_mesh`), or a volume.
    of : Case
        Whose painted meshes are read as well; they have the surface's coordinates.
    elements : int, optional
        Along the longest side of a surface, 2 .. 2000. Default: 48.
    folders : sequence of path
        Where painted meshes are looked for.

    Raises
    ------
    InputError
        A surface that is not closed; elements of a volume; painted meshes beside a volume, or
        outside of the part.
    FileError
        As `read_mesh` and `read`; a painted mesh that is nowhere.
    """
    names = painted_meshes(of)
    if Path(source).suffix.lower() not in READABLE:
        if elements is not None or names:
            what = "elements are given" if elements is not None else "the case names meshes"
            raise InputError(
                f"{os.fspath(source)} is a volume, whose voxels are the elements, and {what}: give "
                "the part as a surface, or leave that out"
            )
        return PartElements(load(source))
    surface = read_mesh(source)
    number = as_number(
        ELEMENTS if elements is None else elements, name="elements", low=2, high=2000, whole=True
    )
    used = surface.vertices[np.unique(surface.faces)].astype(np.float64)
    edge = float((used.max(axis=0) - used.min(axis=0)).max()) / int(number)
    image = voxelise(surface, spacing=edge)
    origin = image.recipe.steps[-1]["origin"]
    marks = {
        name: mark_surface(
            read_mesh(_find(name, folders)), spacing=edge, shape=image.shape, origin=origin
        )
        for name in names
    }
    return PartElements(image, marks)


def painted_meshes(of: Case) -> list[str]:
    """Return the names of the meshes that a case picks places by."""
    places = [one.place for one in of.supports]
    places += [one.place for one in (*of.solid, *of.keep_out)]
    places += [load.place for one in of.alone for load in one.loads]
    names = [place.mesh for place in places]
    return list(dict.fromkeys(name for name in names if name is not None))


def _find(name: str, folders: Sequence[str | os.PathLike[str]]) -> Path:
    places = [Path(folder) / name for folder in folders]
    return next((place for place in places if place.is_file()), places[0])
