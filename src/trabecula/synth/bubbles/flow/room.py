"""Room for bubbles: the form without its crust."""

from __future__ import annotations

import math

import numpy as np

from trabecula.core.errors import InputError
from trabecula.engine.blocks import Box, slices_of
from trabecula.measure.distance import distance_transform

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
