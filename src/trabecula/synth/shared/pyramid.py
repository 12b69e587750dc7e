"""Coarser and finer grids by a factor of two, with cells aligned: coarse cell i covers fine cells 2i and 2i + 1."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def halve(field: np.ndarray) -> np.ndarray:
    """Mean over 2 x 2 x 2 cells of (C, Z, Y, X); an odd side is continued by its last cell."""
    pads = [(0, 0)] + [(0, side % 2) for side in field.shape[1:]]
    padded = np.pad(field, pads, mode="edge") if any(p[1] for p in pads) else field
    for axis in (1, 2, 3):
        even = [slice(None)] * 4
        odd = [slice(None)] * 4
        even[axis], odd[axis] = slice(0, None, 2), slice(1, None, 2)
        padded = (padded[tuple(even)] + padded[tuple(odd)]) * np.float32(0.5)
    return padded


def double(field: np.ndarray, wraps: Sequence[bool] = (False, False, False)) -> np.ndarray:
    """Trilinear up-sampling of int8 (C, Z, Y, X) by two, in integers: weights 3/4 and 1/4 along every axis.

    Beyond a face lies its last cell again, or where the axis `wraps` the cell at the other end.
    """
    fine = field.astype(np.int16)
    for axis, wrap in zip((1, 2, 3), wraps, strict=True):
        cells = np.arange(-1, fine.shape[axis] + 1)
        cells = cells % fine.shape[axis] if wrap else cells.clip(0, fine.shape[axis] - 1)
        before, after = fine.take(cells[:-2], axis), fine.take(cells[2:], axis)
        pair = np.stack([3 * fine + before, 3 * fine + after], axis + 1)
        fine = pair.reshape(*fine.shape[:axis], 2 * fine.shape[axis], *fine.shape[axis + 1 :])
    return ((fine + 32) >> 6).astype(np.int8)


def fit_to(field: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """(C, Z, Y, X) cropped at the far ends, or continued by the last cell, to `shape`."""
    pads = [(0, 0)] + [(0, max(0, want - have)) for want, have in zip(shape, field.shape[1:], strict=True)]
    grown = np.pad(field, pads, mode="edge") if any(p[1] for p in pads) else field
    return np.ascontiguousarray(grown[:, : shape[0], : shape[1], : shape[2]])
