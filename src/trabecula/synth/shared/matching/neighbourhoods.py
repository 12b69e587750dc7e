"""Neighbourhood vectors: cubes of w^3 voxels, or squares of w^2 across the first axis, projected on
their principal components exactly.

The fields are int8 and the basis is rounded to integers small enough that every partial sum of a
projection stays below 2^24, so float32 matrix products are exact: whatever the BLAS, its threads
and the size of the batch, the bits agree. Distances between int16 features then are exact int32.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs

SCALE = 8
"""A feature is SCALE times the projection, so a squared distance is SCALE**2 times the
neighbourhood's (at most 2^31).
"""

_AT_ONCE = 1 << 23  # bytes of features that are made together, more where a plane has more
_ROWS = 1 << 12  # rows a product takes at once: 8 MiB of float32 for 8^3, about the cache
Triple = tuple[int, int, int]


@dataclass(frozen=True)
class Basis:
    """Principal components of the neighbourhoods of an exemplar.

    `vectors` is (C * n, D) float32 holding integers, with n = (w / grain)^3, or its square where
    neighbourhoods are `flat`; `scale` is what an orthonormal vector was multiplied by; `explained`
    the share of variance kept, 0..1. With a `grain` of 2 a neighbourhood is described by the sums
    over its blocks of 2 voxels a side, at an eighth (a quarter) of the work: enough where the field
    is smooth.
    """

    vectors: np.ndarray
    scale: float
    width: int
    explained: float
    grain: int = 1
    flat: bool = False

    @property
    def box(self) -> Triple:
        """Return the sides of a neighbourhood."""
        return box_of(self.width, flat=self.flat)


def box_of(width: int, *, flat: bool) -> Triple:
    """Return the sides (z, y, x) of a cube of `width` voxels, or of a square across z."""
    return (1 if flat else width, width, width)


def steps_of(step: int, *, flat: bool) -> Triple:
    """Return the distance between neighbourhoods along each axis: there are squares in
    every plane.
    """
    return (1 if flat else step, step, step)


def block_sums(field: np.ndarray, grains: Triple) -> np.ndarray:
    """Sum over the blocks of `grains` (1 or 2 voxels along each axis) at each voxel of (C, Z, Y, X)
    int8, in int16.
    """
    if max(grains) == 1:
        return field
    sums = field.astype(np.int16)
    for axis in (axis for axis, grain in enumerate(grains, start=1) if grain == 2):
        near, far = [slice(None)] * 4, [slice(None)] * 4
        near[axis], far[axis] = slice(None, -1), slice(1, None)
        sums = sums[tuple(near)] + sums[tuple(far)]
    return sums


def project(
    field: np.ndarray, basis: Basis, *, step: int, active: np.ndarray | None = None
) -> np.ndarray:
    """Project the neighbourhoods at every `step`-th corner of (C, Z, Y, X) int8, flat ones in every
    plane, to features (gz, gy, gx, D) int16.

    Where `active` (gz, gy, gx) bool is given and False, features are not computed and undefined.
    """
    steps = steps_of(step, flat=basis.flat)
    grid = tuple(
        (side - reach) // t + 1
        for side, reach, t in zip(field.shape[1:], basis.box, steps, strict=True)
    )
    features = memmap.empty((*grid, basis.vectors.shape[1]), np.int16)

    def work(start: int, stop: int) -> None:
        thick = planes_together(features.shape[-1], grid)
        for first in range(start, stop, thick):
            last = min(first + thick, stop)
            planes = field[:, first * steps[0] : (last - 1) * steps[0] + basis.box[0]]
            there = None if active is None else active[first:last]
            project_planes(planes, basis, features[first:last], step=step, active=there)

    for_slabs(work, grid[0], least=2)
    return features


def planes_together(depth: int, grid: Sequence[int]) -> int:
    """Count the planes of a grid of neighbourhoods with `depth` components whose features stay in
    the cache.
    """
    return max(1, _AT_ONCE // (2 * depth * grid[1] * grid[2]))


def project_planes(
    field: np.ndarray,
    basis: Basis,
    features: np.ndarray,
    *,
    step: int,
    active: np.ndarray | None = None,
) -> None:
    """Do `project` in the caller's thread, into `features` (gz, gy, gx, D) int16; the field begins
    with their first plane.
    """
    length, count = basis.vectors.shape
    box, grains = basis.box, box_of(basis.grain, flat=basis.flat)
    steps = steps_of(step, flat=basis.flat)
    # The sum over a block of n equal values has n times their value, but only sqrt(n) times their
    # norm.
    factor = np.float32(SCALE / basis.scale / basis.grain ** (1.0 if basis.flat else 1.5))
    blocks = np.ascontiguousarray(block_sums(field, grains))
    if basis.grain > 1 and step % basis.grain == 0:
        # Only the sums of blocks side by side are needed.
        blocks = np.ascontiguousarray(blocks[:, :: grains[0], :: grains[1], :: grains[2]])
        box, steps = divide_sides(box, grains), divide_sides(steps, grains)
        grains, step = (1, 1, 1), step // basis.grain
    across = features.shape[2]
    rows = np.empty((min(_ROWS, features.shape[1] * across), length), np.float32)
    _, _, Y, X = blocks.shape
    for z in range(len(features)):
        sites = (
            np.arange(features.shape[1] * across) if active is None else np.flatnonzero(active[z])
        )
        plane = features[z].reshape(-1, count)
        for first in range(0, len(sites), _ROWS):
            chosen = sites[first : first + _ROWS]
            y, x = np.divmod(chosen, across)
            gather(blocks, (z * steps[0] * Y + y * step) * X + x * step, box, grains, rows)
            store(rows[: len(chosen)] @ basis.vectors, factor, chosen, plane)


def divide_sides(sides: Triple, by: Triple) -> Triple:
    """Return sides in units of blocks."""
    z, y, x = (side // b for side, b in zip(sides, by, strict=True))
    return z, y, x


@kernel
def store(products, factor, sites, plane):
    """Write products times `factor`, rounded to int16, to the sites' rows; a kernel, so that other
    threads can work meanwhile.
    """
    for n in range(len(sites)):
        to = plane[sites[n]]
        for d in range(products.shape[1]):
            to[d] = np.int16(np.rint(products[n, d] * factor))


def gather(
    blocks: np.ndarray,
    corners: np.ndarray,
    box: Triple,
    grains: Triple,
    rows: np.ndarray,
) -> None:
    """Copy the neighbourhoods of (C, Z, Y, X), contiguous, whose first voxels lie at `corners` (n,)
    of its first channel to the first rows, (n, C * voxels) float32.

    box, grains : the sides of a neighbourhood and of a block of it, of which one value counts.
    """
    depth, height, width = (np.arange(0, b, g) for b, g in zip(box, grains, strict=True))
    _, Z, Y, X = blocks.shape
    channels = np.arange(len(blocks))[:, None, None]
    lines = ((channels * Z + depth[:, None]) * Y + height) * X
    copy_lines(blocks.reshape(-1), corners, lines.ravel(), len(width), grains[2], rows)


@kernel
def copy_lines(values, corners, lines, length, grain, rows):
    """Copy `length` values, `grain` apart, from each corner and line on."""
    for n in range(len(corners)):
        to, at = rows[n], 0
        for line in lines:
            start = corners[n] + line
            if length == 8 and grain == 1:  # the compiler makes one move of a length that it knows
                for x in range(8):
                    to[at + x] = values[start + x]
            elif length == 6 and grain == 1:
                for x in range(6):
                    to[at + x] = values[start + x]
            else:
                for x in range(length):
                    to[at + x] = values[start + x * grain]
            at += length


def block_bytes(basis: Basis, grid: tuple[int, ...]) -> int:
    """Forecast the memory of `project` per thread beyond its result."""
    length, count = basis.vectors.shape
    return min(_ROWS, grid[1] * grid[2]) * (4 * length + 16 * count)


def grid_shape(shape: Sequence[int], *, box: Triple, steps: Triple) -> Triple:
    """Count the neighbourhoods, `steps` apart, that cover `shape`; the last may reach
    past its end.
    """
    z, y, x = (
        -(-(max(side, w) - w) // t) + 1 for side, w, t in zip(shape, box, steps, strict=True)
    )
    return z, y, x


def grid_reach(grid: Sequence[int], *, box: Triple, steps: Triple) -> Triple:
    """Return the voxels that a grid of neighbourhoods covers."""
    z, y, x = ((count - 1) * t + w for count, w, t in zip(grid, box, steps, strict=True))
    return z, y, x
