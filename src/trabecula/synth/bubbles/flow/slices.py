"""A form as bubbles see it: slices across the principal axis, with their centres of mass, sizes and
outlines, and the room below its crust; each on demand.

A slice is (rows, columns) of voxels; its x runs along the columns, its y along the rows.

To follow an outline, the slice is blurred; its gradient turned by 90 degrees runs along the border.
The blur is the mean over a disc, whose radius is the thickness of the zone: deeper than that the
gradient is exactly 0 and the zone ends (section 3.4: the kernel's size is the thickness of the
border). All sums are whole numbers. Thick zones are found on cells of several voxels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from trabecula.core.errors import InputError
from trabecula.engine.blocks import Box, slices_of
from trabecula.measure.distance import distance_transform
from trabecula.measure.labelling import label_components
from trabecula.synth.bubbles.flow.systems import pack_int8, unit

_FINE = 8  # cells that a zone is thick, at least, where it is not thinner in voxels


def along_outline(plane: np.ndarray, thickness: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Return vectors along the border of a slice, 0 where none is near.

    Parameters
    ----------
    plane : (V, U) bool array
        Nothing of the form lies beyond it.
    thickness : float
        Voxels from the border up to which it is followed, above 0.

    Returns
    -------
    rows, columns : float64 arrays, one value a cell
        Whole numbers, of no particular length; the sense is that of x' = -y, y' = x about a place
        inside.
    every : int
        Voxels along the edge of a cell.
    """
    every, cells = cell_of(thickness)
    counts = _counts(plane, every)
    rows, columns = np.zeros((2, *counts.shape))
    held = bounding_slices(counts)
    smooth = _disc_sums(np.pad(counts[held], cells), cells - 1)
    rows[held] = -(smooth[1:-1, 2:] - smooth[1:-1, :-2])
    columns[held] = smooth[2:, 1:-1] - smooth[:-2, 1:-1]
    return rows, columns, every


def cell_of(thickness: float) -> tuple[int, int]:
    """Return the voxels along the edge of a cell, and the thickness of a zone in cells."""
    every = max(1, int(thickness / _FINE))
    return every, max(1, round(thickness / every))


def _counts(plane: np.ndarray, every: int) -> np.ndarray:
    """Return the number of True voxels in cells of `every` a side."""
    if every == 1:
        return plane.astype(np.int32)
    whole = np.pad(plane, [(0, -side % every) for side in plane.shape]).view(np.uint8)
    rows, columns = (side // every for side in whole.shape)
    return whole.reshape(rows, every, columns, every).sum(axis=(1, 3), dtype=np.int32)


def bounding_slices(plane: np.ndarray) -> tuple[slice, ...]:
    """Return the bounding box of the values other than 0; an empty one without any."""
    ends = [np.flatnonzero(plane.any(axis=other)) for other in (1, 0)]
    return tuple(
        slice(int(held[0]), int(held[-1]) + 1) if len(held) else slice(0, 0) for held in ends
    )


def _disc_sums(values: np.ndarray, radius: int) -> np.ndarray:
    """Return sums over the disc around every cell.

    Cells nearer than `radius` to the array's faces are left out.
    """
    height, width = (side - 2 * radius for side in values.shape)
    sums = np.zeros((values.shape[0], values.shape[1] + 1), np.int64)
    np.cumsum(values, axis=1, out=sums[:, 1:])
    total = np.zeros((height, width), np.int64)
    for row in range(-radius, radius + 1):
        half = math.isqrt(radius * radius - row * row)
        near = sums[radius + row : radius + row + height]
        total += near[:, radius + half + 1 : radius + half + 1 + width]
        total -= near[:, radius - half : radius - half + width]
    return total


CENTRES = ("slice", "piece", "box")

ORDER = {"z": (0, 1, 2), "y": (1, 0, 2), "x": (2, 0, 1)}
"""Axes of a volume by principal axis: along it, then y and x of a slice; y and x across z, z and x
across y, z and y across x."""

KEPT = 64 << 20  # bytes of slices stored for neighbouring boxes


@dataclass(frozen=True)
class Slice:
    """A slice that holds some of the form.

    Places are voxels from its corner, along rows and columns.

    Attributes
    ----------
    centre : pair of float
        Centre of mass.
    extent : pair of int
        Height and width of the bounding box, voxels.
    centres : pair of (V, U) float32 arrays, or None
        Centre of mass of the connected component around every place.
    outline : (rows, columns, 2) int8 array, or None
        Unit vectors along the border times 127, one a cell; 0 where none is near.
    every : int
        Voxels along the edge of a cell.
    """

    centre: tuple[float, float]
    extent: tuple[int, int]
    centres: tuple[np.ndarray, np.ndarray] | None = None
    outline: np.ndarray | None = None
    every: int = 1

    @property
    def nbytes(self) -> int:
        """Return the memory of the slice."""
        arrays = [*(self.centres or ()), *([] if self.outline is None else [self.outline])]
        return 1000 + sum(array.nbytes for array in arrays)


class MaskSlices:
    """Slices of a mask by their places along the principal axis.

    Parameters
    ----------
    mask : (A, V, U) bool array
        Its axes in the order of `ORDER`.
    edges : two floats
        Of a voxel, along rows and columns.
    by_component : bool
        Whether every connected component has a centre of its own.
    silhouette : float
        Length up to which bubbles follow the outline; 0: not.
    """

    def __init__(
        self, mask: np.ndarray, edges: tuple[float, ...], *, by_component: bool, silhouette: float
    ) -> None:
        self._mask, self._edges, self._by_component, self._silhouette = (
            mask,
            edges,
            by_component,
            silhouette,
        )
        self._known: dict[int, Slice | None] = {}
        self._held = 0

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the number of rows and columns."""
        return self._mask.shape[1:]

    def __getitem__(self, place: int) -> Slice | None:
        """Return the slice at a place; None where nothing of the form is in it."""
        if not 0 <= place < len(self._mask):
            return None
        if place not in self._known:
            found = self._analyse(np.ascontiguousarray(self._mask[place]))
            self._known[place] = found
            self._held += 0 if found is None else found.nbytes
            while self._held > KEPT and len(self._known) > 1:
                oldest = self._known.pop(next(iter(self._known)))
                self._held -= 0 if oldest is None else oldest.nbytes
        return self._known[place]

    def _analyse(self, plane: np.ndarray) -> Slice | None:
        """Return centre, size and outline of a plane; None of an empty one."""
        centre = centre_of(plane)
        if centre is None:
            return None
        centres = component_centres(plane, centre) if self._by_component else None
        if not self._silhouette:
            return Slice(centre, extent_of(plane), centres)
        # Thickness and cells are voxels of the finer axis. A gradient is per length; turned by 90
        # degrees its components change places, and so do the edges.
        rows, columns, every = along_outline(plane, self._silhouette / min(self._edges))
        along = unit((rows * self._edges[0], columns * self._edges[1]))
        return Slice(centre, extent_of(plane), centres, pack_int8(np.stack(along, axis=-1)), every)


def centre_of(plane: np.ndarray) -> tuple[float, float] | None:
    """Return the centre of mass of a slice; None of an empty one.

    It is in voxels from the slice's corner, along rows and columns.

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


def component_centres(
    plane: np.ndarray, around: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the centre of mass of the connected component around every place of a slice.

    Components touch by an edge or a corner.

    Parameters
    ----------
    plane : (V, U) bool array
    around : pair of float
        Centre outside of all components.

    Returns
    -------
    rows, columns : (V, U) float32 arrays
        In voxels from the slice's corner.
    """
    held = bounding_slices(plane)
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
    """Return height and width of the bounding box of a slice, voxels; 0 of an empty one."""
    rows, columns = bounding_slices(plane)
    return rows.stop - rows.start, columns.stop - columns.start


SLAB = 64  # planes along z in one distance transform
MARGIN = 2  # voxels around a part for its distance transform, beside the crust's own


class Room:
    """Voxels of a form below its crust, found slab by slab on demand, and kept in one bit a voxel.

    Parameters
    ----------
    mask : (Z, Y, X) or (Y, X) bool array
        The form; it ends at the faces of the array.
    crust : float
        Depth below the surface, above 0; the surface lies half a voxel before the first centre
        outside.
    spacing : floats
        Edges of the voxels.

    Raises
    ------
    InputError
        The crust leaves nothing of the form.
    """

    def __init__(self, mask: np.ndarray, crust: float, spacing: tuple[float, ...]) -> None:
        self._mask, self._crust, self._spacing = mask, crust, spacing
        self._slab = SLAB if mask.ndim == 3 else len(mask)
        self._known: dict[int, np.ndarray] = {}
        self._check()

    def __call__(self, box: Box) -> np.ndarray:
        """Return a mask of the voxels of a box deeper than the crust, bool of its size.

        The box may reach beyond the mask.
        """
        found = np.zeros([stop - start for start, stop in box], bool)
        inside = [
            (max(a, 0), min(b, side)) for (a, b), side in zip(box, self._mask.shape, strict=True)
        ]
        if any(a >= b for a, b in inside):
            return found
        (first, last), rest = inside[0], tuple(slice(a, b) for a, b in inside[1:])
        target = [
            slice(a - start, b - start) for (a, b), (start, _) in zip(inside, box, strict=True)
        ]
        for number in range(first // self._slab, -(-last // self._slab)):
            low, high = max(first, number * self._slab), min(last, (number + 1) * self._slab)
            planes = slice(low - number * self._slab, high - number * self._slab)
            bits = np.unpackbits(self._bits(number)[planes], axis=-1, count=self._mask.shape[-1])
            target[0] = slice(low - box[0][0], high - box[0][0])
            found[tuple(target)] = bits[(slice(None), *rest)].view(bool)
        return found

    def _check(self) -> None:
        """Raise where the crust leaves nothing of the form."""
        areas = self._mask.reshape(len(self._mask), -1).sum(axis=1)
        # The slab of the fullest slice nearly always decides.
        first = int(areas.argmax()) // self._slab
        count = -(-len(self._mask) // self._slab)
        if not any(self._bits(number).any() for number in (first, *range(count))):
            raise InputError(
                "the mask has no room: no voxel lies deeper in it than its crust of "
                f"{self._crust:g}; take a thinner crust, or a larger form (a shape scales a "
                "surface to it)"
            )

    def _bits(self, number: int) -> np.ndarray:
        """Return the packed room of a slab."""
        if number not in self._known:
            ends = (number * self._slab, min((number + 1) * self._slab, len(self._mask)))
            box = (ends, *((0, side) for side in self._mask.shape[1:]))
            self._known[number] = np.packbits(
                room_of(self._mask, box, self._crust, self._spacing), axis=-1
            )
        return self._known[number]


def room_of(mask: np.ndarray, box: Box, crust: float, spacing: tuple[float, ...]) -> np.ndarray:
    """Return a mask of the voxels of a box deeper in the form than `crust` (see `Room`)."""
    found = np.zeros([stop - start for start, stop in box], bool)
    held = _around(mask, box, crust, spacing)
    if held is not None:
        near, part = held
        found[
            tuple(slice(a - first, b - first) for (a, b), (first, _) in zip(part, box, strict=True))
        ] = near
    return found


def _around(
    mask: np.ndarray, box: Box, crust: float, spacing: tuple[float, ...]
) -> tuple[np.ndarray, Box] | None:
    """Return the room of the smallest part of a box that holds the form in it, and that part.

    None where the box holds nothing of the form.
    """
    form = mask[slices_of(box)]
    part = []
    for axis, (first, _) in enumerate(box):
        held = np.flatnonzero(
            form.any(axis=tuple(other for other in range(mask.ndim) if other != axis))
        )
        if not len(held):
            return None
        part.append((first + int(held[0]), first + int(held[-1]) + 1))
    margin = [math.ceil(crust / edge) + MARGIN for edge in spacing]
    near = cut(mask, [(a - far, b + far) for (a, b), far in zip(part, margin, strict=True)])
    inner = tuple(slice(far, -far) for far in margin)
    # A voxel is kept whose centre lies deeper than the crust; to the next centre outside it is half
    # an edge more.
    return distance_transform(near, spacing=spacing)[inner] > crust + min(spacing) / 2, tuple(part)


def cut(mask: np.ndarray, box: list[tuple[int, int]]) -> np.ndarray:
    """Return a box of a mask, False beyond it."""
    inside = [
        (max(a, 0), max(max(a, 0), min(b, side)))
        for (a, b), side in zip(box, mask.shape, strict=True)
    ]
    found = np.zeros([b - a for a, b in box], bool)
    target = tuple(
        slice(a - first, b - first) for (a, b), (first, _) in zip(inside, box, strict=True)
    )
    if all(b > a for a, b in inside):
        found[target] = mask[tuple(slice(a, b) for a, b in inside)]
    return found
