"""Sums over small cubes of voxels, plane after plane: local densities of any window add up from
them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.compile import kernel
from trabecula.measure.grey import grey_values

CELL = 4
"""Voxels a side of a cell. Windows are whole numbers of cells, so this is how finely their edges
can be chosen.
"""


@dataclass(frozen=True)
class CellMeans:
    """Sums over the cells of an image; what is left over at the far faces belongs to no cell."""

    edges: tuple[int, int, int]
    """Voxels of a cell along z, y, x; 1 along z in 2-D."""
    spacing: tuple[float, float, float]
    shares: np.ndarray
    """(P, Z, Y, X): fraction of every phase in a cell; of grey and colour images the mean value (P
    = 1).
    """
    faces: np.ndarray
    """(3, Z, Y, X): interface area per volume that faces z, y and x, counted on voxel faces inside
    the cell; of grey and colour images the mean squared difference of neighbours over the edge."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the number of cells along z, y and x."""
        return self.faces.shape[1:]

    @property
    def extents(self) -> tuple[float, ...]:
        """Return the length of the image that the cells cover along z, y and x, in its unit."""
        steps = zip(self.shape, self.edges, self.spacing, strict=True)
        return tuple(count * edge * step for count, edge, step in steps)


class CellSums:
    """Sums of cells, collected from planes given one slab after another.

    Parameters
    ----------
    shape : tuple of int
        Of the whole image, (Z, Y, X) or (Y, X).
    spacing : tuple of float
    phases : int
        Number of labels; 0 for grey and colour images.
    cell : int
        Voxels a side, 2 at least.

    Raises
    ------
    InputError
        A side shorter than a cell.
    """

    def __init__(
        self, shape: tuple[int, ...], spacing: tuple[float, ...], phases: int, *, cell: int = CELL
    ) -> None:
        flat = len(shape) == 2
        self.edges = (1 if flat else cell, cell, cell)
        along = (1.0, *spacing) if flat else tuple(spacing)
        self.spacing = (along[0], along[1], along[2])
        sides = (1, *shape) if flat else shape
        counts = tuple(side // edge for side, edge in zip(sides, self.edges, strict=True))
        if not all(counts):
            raise InputError(
                f"an image of {shape} voxels has no cell of {cell} voxels a side: give a larger one"
            )
        self._phases = phases
        self._shares = np.zeros((max(phases, 1), *counts))
        self._faces = np.zeros((3, *counts))
        self._waiting: np.ndarray | None = None
        self._plane = 0

    def add(self, image: Image) -> None:
        """Take the next planes of the volume, or the one of a 2-D image."""
        values = image.values if self._phases else grey_values(image)
        values = values[None] if image.ndim == 2 else values
        if self._waiting is not None:
            values = np.concatenate([self._waiting, values])
        depth = self.edges[0]
        whole = len(values) // depth
        self._waiting = values[whole * depth :].copy()
        for layer in range(min(whole, self._shares.shape[1] - self._plane)):
            planes = np.ascontiguousarray(values[layer * depth : (layer + 1) * depth])
            shares, faces = self._shares[:, self._plane], self._faces[:, self._plane]
            if self._phases:
                _count_labels(planes, np.array(self.edges), shares, faces)
            else:
                _sum_values(planes.astype(np.float64), np.array(self.edges), shares, faces)
            self._plane += 1

    def result(self) -> CellMeans:
        """Return the cells, once every plane was given."""
        voxels = np.prod(self.edges)
        # A cell of n voxels has n - 1 faces between them along an axis.
        inner = np.array([max(1, voxels // edge * (edge - 1)) for edge in self.edges]).reshape(
            3, 1, 1, 1
        )
        step = np.array(self.spacing).reshape(3, 1, 1, 1)
        return CellMeans(
            self.edges, self.spacing, self._shares / voxels, self._faces / inner / step
        )


def cells_of(image: Image, *, cell: int = CELL) -> CellMeans:
    """Return the cells of an image in memory."""
    sums = CellSums(
        image.shape, image.spacing, len(image.phases) if image.kind == "labels" else 0, cell=cell
    )
    sums.add(image)
    return sums.result()


@kernel
def _count_labels(planes, edges, shares, faces):
    """Add a layer of cells: voxels of every label, and pairs of unlike neighbours inside a cell
    along each axis.
    """
    depth, rows, columns = len(planes), shares.shape[1] * edges[1], shares.shape[2] * edges[2]
    for z in range(depth):
        for y in range(rows):
            row, last_row = y // edges[1], y % edges[1] == edges[1] - 1
            for x in range(columns):
                column, here = x // edges[2], planes[z, y, x]
                shares[here, row, column] += 1
                faces[0, row, column] += (
                    z < depth - 1 and planes[min(z + 1, depth - 1), y, x] != here
                )
                faces[1, row, column] += not last_row and planes[z, min(y + 1, rows - 1), x] != here
                last = x % edges[2] == edges[2] - 1
                faces[2, row, column] += not last and planes[z, y, min(x + 1, columns - 1)] != here


@kernel
def _sum_values(planes, edges, shares, faces):
    """Add a layer of cells: values, and squared differences of neighbours inside a cell along each
    axis.
    """
    depth, rows, columns = len(planes), shares.shape[1] * edges[1], shares.shape[2] * edges[2]
    for z in range(depth):
        for y in range(rows):
            row = y // edges[1]
            for x in range(columns):
                column, here = x // edges[2], planes[z, y, x]
                shares[0, row, column] += here
                if z < depth - 1:
                    faces[0, row, column] += (planes[z + 1, y, x] - here) ** 2
                if y % edges[1] < edges[1] - 1:
                    faces[1, row, column] += (planes[z, y + 1, x] - here) ** 2
                if x % edges[2] < edges[2] - 1:
                    faces[2, row, column] += (planes[z, y, x + 1] - here) ** 2
