"""Labels -> a smooth field whose zero is the surface.

1. A ramp: HEIGHT in material, -HEIGHT outside.
2. PASSES times: a binomial blur along every axis, then the constraint that no voxel changes sides
   (Whitaker 2000, Reducing aliasing artifacts in iso-surfaces of binary volumes,
   doi:10.1109/SVV.2000.10000). So the terraces of voxels go and a wall of two voxels stays.
3. One blur more takes the kinks out that the constraint leaves; no voxel changes sides by it.

The field falls by at most about one an edge of a voxel, so that it is never more than the distance
to the surface. Values are whole numbers, STEPS of them an edge. Blurs are in place, so that 2 bytes
a voxel are held beside the labels.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs

STEPS = 4096
HEIGHT = 1.5
"""Edges of a voxel beyond which the field is flat."""

PASSES = 4
SIGMA = 1.5
"""Width of a blur, edges of a voxel."""

LEAST, LEAST_THIN = 0.04, 0.3
"""Value that the constraint leaves a voxel's middle, in edges: of most voxels, and of those of
walls (or gaps) of one or two voxels, which would become foils otherwise.
"""


def smooth_surface(labels: np.ndarray, drawn: np.ndarray, *, passes: int = PASSES) -> np.ndarray:
    """Return a smooth field whose zero is the drawn labels' surface.

    Parameters
    ----------
    labels : (Z, Y, X) uint8
    drawn : (256,) uint8
        1 for labels that are material.
    passes : int
        Blurs, each followed by the constraint.

    Returns
    -------
    (Z, Y, X) int16
        STEPS an edge of a voxel, positive in the material, at most HEIGHT edges.
    """
    steps = np.where(drawn > 0, 1, -1).astype(np.int16) * np.int16(HEIGHT * STEPS)
    field = np.empty(labels.shape, np.int16)
    weights = _kernel()
    for_slabs(lambda a, b: np.take(steps, labels[a:b], out=field[a:b], mode="clip"), len(field))
    for number in range(passes + 1):
        _blur(field, weights)
        thin = LEAST_THIN if number < passes else LEAST_THIN / 2
        bounds = (int(LEAST * STEPS), int(thin * STEPS))
        for_slabs(partial(_constrain, labels, drawn, field, *bounds), len(field))
    return field


def _kernel() -> np.ndarray:
    """Return a blur of SIGMA that moves no curved surface, in 1/4096: 2 B - B B has no second
    moment, where the Gaussian B would shrink balls until the constraint holds them, in terraces.
    """
    places = np.arange(-8, 9)
    blur = np.exp(-(places**2) / (2 * SIGMA**2))
    blur /= blur.sum()
    sharp = 2 * np.pad(blur, 8) - np.convolve(blur, blur)
    radius = int(np.abs(np.flatnonzero(np.abs(sharp) > 5e-4) - 16).max())
    weights = np.rint(sharp[16 - radius : 17 + radius] * 4096).astype(np.int32)
    weights[radius] += 4096 - weights.sum()
    return weights


def _blur(field: np.ndarray, weights: np.ndarray) -> None:
    depth, height, width = field.shape
    along_z = field.reshape(1, depth, height * width)
    for_slabs(lambda a, b: _blur_lines(along_z, weights, 0, 1, a, b), height * width, least=4096)
    for_slabs(lambda a, b: _blur_lines(field, weights, a, b, 0, width), depth)
    for_slabs(lambda a, b: _blur_rows(field, weights, a, b), depth)


@kernel
def _blur_lines(field, weights, first, last, left, right):
    """Blur (A, B, C) in place along its middle axis, edge values repeated: the part first..last of
    A and left..right of C.
    """
    count, taps = field.shape[1], len(weights)
    radius, chunk = taps // 2, 2048
    kept = np.empty((radius + 1, chunk), np.int16)
    total = np.empty(chunk, np.int32)
    for a in range(first, last):
        for start in range(left, right, chunk):
            size = min(start + chunk, right) - start
            for k in range(radius + 1):
                for i in range(size):
                    kept[k, i] = field[a, 0, start + i]
            for b in range(count):
                row = kept[b % (radius + 1)]
                for i in range(size):
                    row[i] = field[a, b, start + i]
                    total[i] = 2048
                for k in range(taps):
                    weight, at = weights[k], b + k - radius
                    if at <= b:  # overwritten already: what it was
                        source = (
                            kept[max(at, -1) % (radius + 1)] if at < 0 else kept[at % (radius + 1)]
                        )
                        for i in range(size):
                            total[i] += weight * source[i]
                    else:
                        at = min(at, count - 1)
                        if at == b:
                            for i in range(size):
                                total[i] += weight * row[i]
                        else:
                            for i in range(size):
                                total[i] += weight * field[a, at, start + i]
                for i in range(size):
                    field[a, b, start + i] = total[i] >> 12


@kernel
def _blur_rows(field, weights, first, last):
    """Blur the slices first..last in place along their last axis."""
    width, radius = field.shape[2], len(weights) // 2
    row = np.empty(width + 2 * radius, np.int32)
    total = np.empty(width, np.int32)
    for z in range(first, last):
        for y in range(field.shape[1]):
            for x in range(width):
                row[x + radius] = field[z, y, x]
                total[x] = 2048
            for x in range(radius):
                row[x] = row[radius]
                row[width + radius + x] = row[width + radius - 1]
            for k in range(2 * radius + 1):
                weight = weights[k]
                for x in range(width):
                    total[x] += weight * row[x + k]
            for x in range(width):
                field[z, y, x] = total[x] >> 12


@inline
def _is_thin(labels, drawn, z, y, x, here):
    """Return whether the other kind is on both sides of a voxel along an axis, in a wall of at most
    two voxels.
    """
    depth, height, width = labels.shape
    for axis in range(3):
        length = depth if axis == 0 else height if axis == 1 else width
        at = z if axis == 0 else y if axis == 1 else x
        before, after = 3, 3
        for reach in range(2, 0, -1):
            low, high = at - reach, at + reach
            if low >= 0:
                kind = (
                    labels[low, y, x] if axis == 0 else labels[z, low, x] if axis == 1
                    else labels[z, y, low]
                )  # fmt: skip
                if drawn[kind] != here:
                    before = reach
            if high < length:
                kind = (
                    labels[high, y, x] if axis == 0 else labels[z, high, x] if axis == 1
                    else labels[z, y, high]
                )  # fmt: skip
                if drawn[kind] != here:
                    after = reach
        if before + after <= 3:
            return True
    return False


@kernel
def _constrain(labels, drawn, field, least, thin, first, last):
    """Put voxels that changed sides, or came too near to it, back to the least value."""
    for z in range(first, last):
        for y in range(labels.shape[1]):
            for x in range(labels.shape[2]):
                value = field[z, y, x]
                here = drawn[labels[z, y, x]]
                if here:
                    if value < thin and (value < least or _is_thin(labels, drawn, z, y, x, here)):
                        bound = thin if _is_thin(labels, drawn, z, y, x, here) else least
                        field[z, y, x] = max(value, bound)
                elif value > -thin and (value > -least or _is_thin(labels, drawn, z, y, x, here)):
                    bound = thin if _is_thin(labels, drawn, z, y, x, here) else least
                    field[z, y, x] = min(value, -bound)
