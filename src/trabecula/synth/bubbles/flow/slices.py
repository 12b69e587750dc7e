"""Slices of a form across the principal axis: centres of mass, sizes, outlines; each found once
where it is asked for.

A slice is (rows, columns) of voxels; its x runs along the columns, its y along the rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.measure.labelling import label_components
from trabecula.synth.bubbles.flow.outline import along_outline, held_of
from trabecula.synth.bubbles.flow.step import packed, unit

CENTRES = ("slice", "piece", "box")

ORDER = {"z": (0, 1, 2), "y": (1, 0, 2), "x": (2, 0, 1)}
"""Axes of a volume by principal axis: along it, then y and x of a slice. So these are y and x
across z, z and x across y, z and y across x."""

KEPT = 64 << 20  # bytes of slices that are kept for the boxes beside


@dataclass(frozen=True)
class Slice:
    """What is known of a slice that holds some of the form. Places are voxels from its corner,
    along rows and columns.

    Attributes
    ----------
    centre : pair of float
        Centre of mass.
    extent : pair of int
        Height and width of the box around what it holds, voxels.
    pieces : pair of (V, U) float32 arrays, or None
        Of every place the centre of mass of the part that it lies in.
    outline : (rows, columns, 2) int8 array, or None
        Unit vectors along the border times 127, one a cell; 0 where none is near.
    every : int
        Voxels along the edge of a cell.
    """

    centre: tuple[float, float]
    extent: tuple[int, int]
    pieces: tuple[np.ndarray, np.ndarray] | None = None
    outline: np.ndarray | None = None
    every: int = 1

    @property
    def nbytes(self) -> int:
        """Memory that it takes."""
        arrays = [*(self.pieces or ()), *([] if self.outline is None else [self.outline])]
        return 1000 + sum(array.nbytes for array in arrays)


class Slices:
    """Slices of a mask by their places along the principal axis.

    Parameters
    ----------
    mask : (A, V, U) bool array
        Its axes in the order of `ORDER`.
    edges : two floats
        Of a voxel, along rows and columns.
    pieces : bool
        Whether parts that do not touch have centres of their own.
    silhouette : float
        Length up to which the outline is followed; 0: not.
    """

    def __init__(
        self, mask: np.ndarray, edges: tuple[float, ...], *, pieces: bool, silhouette: float
    ) -> None:
        self._mask, self._edges, self._pieces, self._silhouette = mask, edges, pieces, silhouette
        self._known: dict[int, Slice | None] = {}
        self._held = 0

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns."""
        return self._mask.shape[1:]

    def __getitem__(self, place: int) -> Slice | None:
        """The slice at a place; None where nothing of the form is in it."""
        if not 0 <= place < len(self._mask):
            return None
        if place not in self._known:
            found = self._found(np.ascontiguousarray(self._mask[place]))
            self._known[place] = found
            self._held += 0 if found is None else found.nbytes
            while self._held > KEPT and len(self._known) > 1:
                oldest = self._known.pop(next(iter(self._known)))
                self._held -= 0 if oldest is None else oldest.nbytes
        return self._known[place]

    def _found(self, plane: np.ndarray) -> Slice | None:
        centre = centre_of(plane)
        if centre is None:
            return None
        pieces = piece_centres(plane, centre) if self._pieces else None
        if not self._silhouette:
            return Slice(centre, extent_of(plane), pieces)
        # Thickness and cells are voxels of the finer axis. A gradient is per length; turned by 90
        # degrees its components
        # change places, and so do the edges.
        rows, columns, every = along_outline(plane, self._silhouette / min(self._edges))
        along = unit((rows * self._edges[0], columns * self._edges[1]))
        return Slice(centre, extent_of(plane), pieces, packed(np.stack(along, axis=-1)), every)


def centre_of(plane: np.ndarray) -> tuple[float, float] | None:
    """Centre of mass of a slice, in voxels from its corner, along rows and columns; None of an
    empty one.

    Parameters
    ----------
    plane : (V, U) bool array
    """
    rows, columns = plane.sum(axis=1, dtype=np.int64), plane.sum(axis=0, dtype=np.int64)
    count = int(rows.sum())
    if not count:
        return None
    # Twice the place of a voxel's centre is a whole number, and so are the sums.
    down, right = (
        int(sums @ (2 * np.arange(len(sums)) + 1)) / (2 * count) for sums in (rows, columns)
    )
    return down, right


def piece_centres(plane: np.ndarray, around: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Of every place in a slice the centre of mass of the part that it lies in; parts touch by an
    edge or a corner.

    Parameters
    ----------
    plane : (V, U) bool array
    around : pair of float
        Centre of what is no part.

    Returns
    -------
    rows, columns : (V, U) float32 arrays
        In voxels from the slice's corner.
    """
    held = held_of(plane)
    labels, sizes = label_components(np.ascontiguousarray(plane[held]), connectivity=8)
    found = []
    for axis, default in enumerate(around):
        places = np.arange(held[axis].start, held[axis].stop).reshape(
            (-1, 1) if axis == 0 else (1, -1)
        )
        moment = np.bincount(
            labels.ravel(), np.broadcast_to(2 * places + 1, labels.shape).ravel(), len(sizes) + 1
        )
        centre = moment / np.concatenate([[1], 2 * sizes])
        centre[0] = default
        whole = np.full(plane.shape, default, np.float32)
        whole[held] = centre.astype(np.float32)[labels]
        found.append(whole)
    return found[0], found[1]


def extent_of(plane: np.ndarray) -> tuple[int, int]:
    """Height and width of the box around what a slice holds, voxels; 0 of an empty one."""
    rows, columns = held_of(plane)
    return rows.stop - rows.start, columns.stop - columns.start
