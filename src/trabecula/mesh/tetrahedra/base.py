"""`Tetrahedra`: a mesh of volume whose phases share the nodes between them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from trabecula.core.brief import brief
from trabecula.core.recipe import Recipe
from trabecula.mesh.elements import Elements
from trabecula.mesh.tetrahedra.quality import dihedral_angles, volumes


class Angles(NamedTuple):
    """Dihedral angles of tetrahedra, in degrees: the least and the largest of all, and the one that
    every hundredth tetrahedron falls below with its least.
    """

    least: float
    largest: float
    hundredth: float


@dataclass(frozen=True, eq=False)
class Tetrahedra:
    """Tetrahedra in space.

    Attributes
    ----------
    points : (N, 3) float64
        x, y, z in `unit`, from the corner of the image.
    cells : (M, 4) int32
        Numbers of points; of positive volume.
    labels : (M,) uint8
        Of every tetrahedron its number in `phases`.
    phases : tuple of str
        Of the image.
    extent : (3,) float64
        Of the image: x, y, z.
    unit : str
    recipe : Recipe
    """

    points: np.ndarray
    cells: np.ndarray
    labels: np.ndarray
    phases: tuple[str, ...]
    extent: np.ndarray
    unit: str = "voxel"
    recipe: Recipe = field(default_factory=Recipe)

    __repr__ = brief

    @cached_property
    def volume(self) -> dict[str, float]:
        """Return the volume of every phase that has tetrahedra, in the cube of the unit."""
        sizes = np.bincount(self.labels, volumes(self.points, self.cells), len(self.phases))
        return {self.phases[n]: float(sizes[n]) for n in np.unique(self.labels)}

    @cached_property
    def angles(self) -> Angles:
        """Return the dihedral angles: of a good tetrahedron between some 10 and 165 degrees."""
        found = dihedral_angles(self.points, self.cells)
        return Angles(
            float(found[:, 0].min()),
            float(found[:, 1].max()),
            float(np.percentile(found[:, 0], 1)),
        )

    def face_nodes(self) -> dict[str, np.ndarray]:
        """Return the nodes on the six faces of the image: "x_low" .. "z_high"."""
        found = {}
        for number, axis in enumerate("xyz"):
            place, end = self.points[:, number], self.extent[number]
            found[f"{axis}_low"] = np.flatnonzero(place <= 1e-9 * end)
            found[f"{axis}_high"] = np.flatnonzero(place >= (1 - 1e-9) * end)
        return found

    def elements(self) -> Elements:
        """Return them as formats take them."""
        return Elements(
            len(self.points),
            len(self.cells),
            4,
            lambda: iter([self.points]),
            lambda: iter([self.cells]),
            lambda: iter([self.labels]),
            self.phases,
            self.unit,
            self.recipe,
        )
