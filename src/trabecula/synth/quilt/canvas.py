"""The growing output: codes of its voxels, the grid of its patches, windows read and written, its
start and end, and the targets at every place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from trabecula.core.request import Request
from trabecula.core.seeds import generator
from trabecula.core.target import OF_A_PHASE, Target
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs, sum_slabs
from trabecula.synth.quilt.patch_library import MOST_LABELS, PatchLibrary, void_label

EMPTY = 255
"""Not made yet."""

OUT = 254
"""Outside the volume, or outside the form."""

FIXED = MOST_LABELS
"""Added to the label of a measured voxel; labels run below it."""

_MARGIN = 4
"""Voxels around a box in which ways around it are seen."""


@dataclass(frozen=True)
class PatchGrid:
    """A grid of boxes in an output of `shape`: `patch` voxels a side, every `step`, the first at
    `start` (0 or before).
    """

    shape: tuple[int, ...]
    wraps: tuple[bool, ...]
    patch: tuple[int, ...]
    step: tuple[int, ...]
    start: tuple[int, ...]

    @cached_property
    def margin(self) -> tuple[int, ...]:
        """Return the voxels around a box in its window: none along an axis of one voxel, and no
        voxel twice.
        """
        return tuple(
            0 if side == 1 else min(_MARGIN, (side - patch) // 2) if wrap else _MARGIN
            for side, patch, wrap in zip(self.shape, self.patch, self.wraps, strict=True)
        )

    @cached_property
    def counts(self) -> tuple[int, ...]:
        """Return the number of boxes along every axis that covers all voxels."""
        counts = []
        for side, wrap, patch, step, start in zip(
            self.shape, self.wraps, self.patch, self.step, self.start, strict=True
        ):
            reach = side - start if wrap else side - start - (patch - step)
            counts.append(max(1, -(-reach // step)))
        return tuple(counts)

    def corner(self, number: int) -> tuple[int, ...]:
        """Return the first voxel of a box; boxes are numbered in raster order."""
        at = np.unravel_index(number, self.counts)
        return tuple(
            int(a) * step + start for a, step, start in zip(at, self.step, self.start, strict=True)
        )

    def indices(self, corner: tuple[int, ...]) -> tuple[np.ndarray, ...]:
        """Return the coordinates of a box's voxels along every axis, without those outside."""
        axes = []
        for first, size, side, wrap in zip(corner, self.patch, self.shape, self.wraps, strict=True):
            at = np.arange(first, first + size)
            axes.append(at % side if wrap else at[(at >= 0) & (at < side)])
        return tuple(axes)

    def read_window(
        self, canvas: np.ndarray, corner: tuple[int, ...], window: np.ndarray, beyond: int
    ) -> None:
        """Copy a box with its margin into `window`; voxels outside the volume are `beyond`."""
        first = tuple(at - margin for at, margin in zip(corner, self.margin, strict=True))
        _read_window(canvas, first, self.wraps, window, beyond)

    def write_box(self, canvas: np.ndarray, corner: tuple[int, ...], window: np.ndarray) -> None:
        """Write the box of a window."""
        _write_box(canvas, corner, self.wraps, self.margin, window)


def grid_start(
    shape: tuple[int, ...], to_make: Sequence[np.ndarray], step: tuple[int, ...], lead: int
) -> tuple[int, ...]:
    """Return starts (0 or before) of boxes that begin `lead` voxels before the first layer with
    voxels `to_make`, along every axis.
    """
    starts = []
    for side, by, made in zip(shape, step, to_make, strict=True):
        used = int(np.argmax(made))
        first = 0 if side == 1 or used == 0 else used - lead
        starts.append(-(-first % by))
    return tuple(starts)


def inner_box(window: np.ndarray, margin: tuple[int, ...]) -> np.ndarray:
    """Return the box in a window, as a view."""
    return window[tuple(slice(m, side - m) for m, side in zip(margin, window.shape, strict=True))]


def near_empty(box: np.ndarray, reach: int) -> np.ndarray:
    """Mark the voxels of a box that are made and have a voxel to make within `reach` along every
    axis.
    """
    found = box == EMPTY
    for axis, side in enumerate(box.shape):
        rows, grown = np.moveaxis(found, axis, 0), np.moveaxis(found.copy(), axis, 0)
        for by in range(1, min(reach, side - 1) + 1):
            grown[by:] |= rows[:-by]
            grown[:-by] |= rows[by:]
        found = np.moveaxis(grown, 0, axis)
    return np.ascontiguousarray(found & (box < OUT))


@kernel
def _read_window(canvas, first, wraps, window, beyond):
    """Copy a window; coordinates beyond a side wrap around where the axis does."""
    depth, height, width = canvas.shape
    for k in range(window.shape[0]):
        z = first[0] + k
        z = z % depth if wraps[0] else z
        for j in range(window.shape[1]):
            y = first[1] + j
            y = y % height if wraps[1] else y
            inside = 0 <= z < depth and 0 <= y < height
            for i in range(window.shape[2]):
                x = first[2] + i
                x = x % width if wraps[2] else x
                window[k, j, i] = canvas[z, y, x] if inside and 0 <= x < width else beyond


@kernel
def _write_box(canvas, corner, wraps, margin, window):
    """Write the box of a window where it is inside the volume."""
    depth, height, width = canvas.shape
    for k in range(window.shape[0] - 2 * margin[0]):
        z = corner[0] + k
        z = z % depth if wraps[0] else z
        if not 0 <= z < depth:
            continue
        for j in range(window.shape[1] - 2 * margin[1]):
            y = corner[1] + j
            y = y % height if wraps[1] else y
            if not 0 <= y < height:
                continue
            for i in range(window.shape[2] - 2 * margin[2]):
                x = corner[2] + i
                x = x % width if wraps[2] else x
                if 0 <= x < width:
                    canvas[z, y, x] = window[k + margin[0], j + margin[1], i + margin[2]]


def patch_grid(library: PatchLibrary, request: Request) -> PatchGrid:
    """Return the grid of a request: from the first voxel; where only a part is made, from that part
    on, with an overlap into its surroundings.
    """
    shape = shape_3d(request)
    wraps = (False,) * (3 - len(request.periodic)) + tuple(request.periodic)
    start: tuple[int, ...] = (0, 0, 0)
    if request.fixed is not None or request.mask is not None:
        lead = library.overlap if request.fixed is not None else 0
        start = grid_start(shape, _layers_to_fill(shape, request), library.step, lead)
    return PatchGrid(shape, wraps, library.box, library.step, start)


def shape_3d(request: Request) -> tuple[int, int, int]:
    """Return the request's shape with one layer along z for a picture."""
    shape = (1,) * (3 - len(request.shape)) + tuple(request.shape)
    return (shape[0], shape[1], shape[2])


def fill_canvas(canvas: np.ndarray, request: Request) -> None:
    """Fill the canvas before the first patch: measured voxels, and `OUT` outside the form."""
    shape = canvas.shape
    mask, known = (
        None if part is None else part.reshape(shape) for part in (request.mask, request.known)
    )
    fixed = None if request.fixed is None else request.fixed.values.reshape(shape)

    def fill(first: int, last: int) -> None:
        part, here = canvas[first:last], slice(first, last)
        part[...] = EMPTY
        if fixed is not None and known is not None:
            np.add(fixed[here], np.uint8(FIXED), out=part, where=known[here])
        if mask is not None:
            np.copyto(part, np.uint8(OUT), where=~mask[here])

    for_slabs(fill, shape[0])


def _layers_to_fill(shape: tuple[int, ...], request: Request) -> list[np.ndarray]:
    """Mark the layers with a voxel to make along every axis, (side,) bool."""
    mask, known = (
        None if part is None else part.reshape(shape) for part in (request.mask, request.known)
    )
    along = [np.zeros(side, np.bool_) for side in shape]
    for z in range(shape[0]):
        plane = np.ones(shape[1:], np.bool_) if mask is None else mask[z]
        if known is not None:
            plane = plane & ~known[z]
        along[0][z] = plane.any()
        along[1] |= plane.any(axis=1)
        along[2] |= plane.any(axis=0)
    return along


def paint_islands(
    canvas: np.ndarray,
    numbers: np.ndarray,
    islands: np.ndarray,
    classes: np.ndarray,
    *,
    void: int,
    solid: int,
) -> int:
    """Turn islands of solid into void, and enclosed void into `solid`; return their voxels.

    Parameters
    ----------
    canvas : (Z, Y, X) uint8
        Is written into.
    numbers : (Z, Y, X) int32
        The component of every voxel.
    islands : bool
        By number, the components to paint over.
    classes : (256,) uint8
        Class of every value of a voxel; 0 is left alone.
    void, solid : int
        Labels.
    """

    def paint(first: int, last: int) -> int:
        part = slice(first, last)
        return int(_paint_over(canvas[part], numbers[part], islands, classes, void, solid))

    return sum_slabs(paint, len(canvas))


def unmark(canvas: np.ndarray, void: int) -> None:
    """Turn the codes of a canvas into labels; outside is void."""

    def clear(first: int, last: int) -> None:
        _unmark(canvas[first:last], void)

    for_slabs(clear, len(canvas))


@kernel
def _paint_over(canvas, numbers, islands, classes, void, solid):
    painted = 0
    for z in range(canvas.shape[0]):
        for y in range(canvas.shape[1]):
            for x in range(canvas.shape[2]):
                value = canvas[z, y, x]
                if value < FIXED and classes[value] > 0 and islands[numbers[z, y, x]]:
                    canvas[z, y, x] = solid if value == void else void
                    painted += 1
    return painted


@kernel
def _unmark(canvas, void):
    for z in range(canvas.shape[0]):
        for y in range(canvas.shape[1]):
            for x in range(canvas.shape[2]):
                value = canvas[z, y, x]
                canvas[z, y, x] = void if value == OUT else value & (FIXED - 1)


_UNIT = 1 << 20


def targets_at(
    target: Mapping[str, Target],
    grid: PatchGrid,
    corner: tuple[int, ...],
    middle: int,
    mask: np.ndarray | None,
) -> dict[str, float]:
    """Return every target at the centre of a box, the voxel `middle` after its first along every
    axis; where that is outside the volume or the form, the mean over the box.
    """
    centre = tuple(
        at + (middle if side > 1 else 0) for at, side in zip(corner, grid.patch, strict=True)
    )
    inside = np.ones((1, 1, 1), np.bool_) if mask is None else mask
    return {
        name: _centre_mean(value, inside, centre, corner, grid.patch, grid.wraps)
        if isinstance(value, np.ndarray)
        else float(value)
        for name, value in target.items()
    }


@dataclass(frozen=True)
class ExemplarShares:
    """Targets of a run without any: the first exemplar's own shares of phases, patch by patch.

    Without a target the best partners would be those of void, which fits to void anywhere. The
    fields run backwards, and back and forth beyond their ends, so that no place asks for the patch
    beside its neighbour's in the exemplar.
    """

    fields: dict[str, np.ndarray]
    offset: tuple[int, ...]

    @classmethod
    def build(cls, library: PatchLibrary, seed: int) -> ExemplarShares:
        """Measure the fields; they begin at a place that depends on the seed."""
        image = library.images[0]
        void = void_label(image.phases)
        names = [OF_A_PHASE + phase for label, phase in enumerate(image.phases) if label != void]
        found = {name: library.describe_patches(0, name) for name in names}
        deep = {
            name: field.reshape((1,) * (3 - field.ndim) + field.shape)
            for name, field in found.items()
        }
        return cls(
            deep, tuple(int(n) for n in generator(seed, "quilt/own").integers(0, 1 << 20, 3))
        )

    def at(self, corner: tuple[int, ...]) -> dict[str, float]:
        """Return the target shares of a box."""
        place = []
        for first, offset, side in zip(corner, self.offset, _field_shape(self.fields), strict=True):
            at = (offset - first) % max(1, 2 * side - 2)
            place.append(min(at, 2 * side - 2 - at) if side > 1 else 0)
        return {name: float(field[tuple(place)]) for name, field in self.fields.items()}


def _field_shape(fields: Mapping[str, np.ndarray]) -> tuple[int, ...]:
    """Return the shape of the fields."""
    return next(iter(fields.values())).shape


@kernel
def _centre_mean(field, inside, centre, corner, sides, wraps):
    """Return a field at the centre of a box, or its mean over the box; a mask of one voxel stands
    for none.
    """
    total, count = _sum_box(field, inside, centre, (1, 1, 1), wraps)
    if count == 0:
        total, count = _sum_box(field, inside, corner, sides, wraps)
    return total / (np.float64(_UNIT) * max(count, 1))


@inline
def _sum_box(field, inside, corner, sides, wraps):
    """Sum a field over a box as whole numbers, so that all machines agree; return the sum and the
    voxels.
    """
    depth, height, width = field.shape
    masked = inside.size > 1
    total, count = np.int64(0), 0
    for k in range(sides[0]):
        z = corner[0] + k
        z = z % depth if wraps[0] else z
        for j in range(sides[1]):
            y = corner[1] + j
            y = y % height if wraps[1] else y
            if not (0 <= z < depth and 0 <= y < height):
                continue
            for i in range(sides[2]):
                x = corner[2] + i
                x = x % width if wraps[2] else x
                if 0 <= x < width and (not masked or inside[z, y, x]):
                    total += np.int64(np.rint(np.float64(field[z, y, x]) * _UNIT))
                    count += 1
    return total, count
