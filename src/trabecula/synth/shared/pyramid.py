"""Coarser and finer grids by a factor of two, with cells aligned: coarse cell i covers fine cells
2i and 2i + 1.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.engine import memmap
from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs
from trabecula.synth.shared.content.fields import FULL
from trabecula.synth.shared.slabs import for_plane_groups, make_by_slabs


def halve(field: np.ndarray) -> np.ndarray:
    """Average over 2 x 2 x 2 cells of (C, Z, Y, X) float32; an odd side is continued by its last
    cell.
    """
    count, *sides = field.shape
    shape = (count, *(-(-side // 2) for side in sides))

    def mean(start: int, stop: int) -> np.ndarray:
        part = field[:, 2 * start : 2 * stop]
        pads = [(0, 0)] + [(0, side % 2) for side in part.shape[1:]]
        part = np.pad(part, pads, mode="edge") if any(pad for _, pad in pads) else part
        for axis in (1, 2, 3):
            even = [slice(None)] * 4
            odd = [slice(None)] * 4
            even[axis], odd[axis] = slice(0, None, 2), slice(1, None, 2)
            part = (part[tuple(even)] + part[tuple(odd)]) * np.float32(0.5)
        return part

    return make_by_slabs(mean, shape, np.result_type(field.dtype, np.float32))


def double(
    field: np.ndarray,
    wraps: Sequence[bool] = (False, False, False),
    *,
    shape: Sequence[int] | None = None,
    factors: Sequence[int] = (),
) -> np.ndarray:
    """Upsample int8 (C, Z, Y, X) by two, trilinearly and in integers: weights 3/4 and 1/4 along
    every axis.

    Beyond a face its last cell is repeated, or where the axis `wraps` the cell at the other end.
    With a `shape` the result is cropped, or continued by its last cells, to that; with `factors`,
    one a channel, it is multiplied by them, and clipped to -127 .. 127.
    """
    sides = tuple(2 * side for side in field.shape[1:]) if shape is None else tuple(shape)
    fine = memmap.empty((len(field), *sides), np.int8)
    scales = np.array(factors or [1] * len(field), np.int64)
    around = (bool(wraps[0]), bool(wraps[1]), bool(wraps[2]))

    def work(start: int, stop: int) -> None:
        _double(field, around, scales, fine, start, stop)

    for_slabs(work, sides[0])
    return fine


def fit_to(field: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Crop (C, Z, Y, X) at the far ends, or continue it by the last cell, to `shape`; return it
    itself where there is nothing to do.
    """
    if field.shape[1:] == tuple(shape):
        return np.ascontiguousarray(field)
    _, Z, Y, X = field.shape
    y, x = min(Y, shape[1]), min(X, shape[2])
    fitted = memmap.empty((len(field), *shape), field.dtype)

    def work(start: int, stop: int) -> None:
        part = fitted[:, start:stop]
        part[:, :, :y, :x] = field[:, np.minimum(np.arange(start, stop), Z - 1), :y, :x]
        part[:, :, y:, :x] = part[:, :, y - 1 : y, :x]
        part[:, :, :, x:] = part[:, :, :, x - 1 : x]

    for_plane_groups(work, shape)
    return fitted


@inline
def _pair(k, side, wrap):
    """Return the coarse cells around fine cell k: the one that holds it, and the other."""
    k = min(k, 2 * side - 1)
    near = k // 2
    far = near + (1 if k % 2 else -1)
    return near, (far % side if wrap else min(max(far, 0), side - 1))


@inline
def _scale_back(sixty_fourths, factor):
    value = ((sixty_fourths + 32) >> 6) * factor
    return np.int8(min(max(value, -FULL), FULL) if factor > 1 else value)


@kernel
def _double(field, wraps, factors, fine, start, stop):
    """Upsample fine planes start..stop. Weights along y and z are summed first, on coarse lines."""
    C, Z, Y, X = field.shape
    line = np.empty(X, np.int32)
    for c in range(C):
        factor = factors[c]
        for z in range(start, stop):
            z0, z1 = _pair(z, Z, wraps[0])
            for y in range(fine.shape[2]):
                y0, y1 = _pair(y, Y, wraps[1])
                a, b, d, e = field[c, z0, y0], field[c, z0, y1], field[c, z1, y0], field[c, z1, y1]
                for x in range(X):
                    line[x] = (
                        3 * (3 * np.int32(a[x]) + np.int32(b[x]))
                        + 3 * np.int32(d[x])
                        + np.int32(e[x])
                    )
                to = fine[c, z, y]
                for x in range(min(X, (len(to) + 1) // 2)):
                    before = line[x - 1] if x > 0 else line[X - 1 if wraps[2] else 0]
                    after = line[x + 1] if x < X - 1 else line[0 if wraps[2] else X - 1]
                    to[2 * x] = _scale_back(3 * line[x] + before, factor)
                    if 2 * x + 1 < len(to):
                        to[2 * x + 1] = _scale_back(3 * line[x] + after, factor)
                for x in range(2 * X, len(to)):
                    to[x] = to[2 * X - 1]
