"""Vertices and triangles from the corners and polygons of files."""

from __future__ import annotations

import numpy as np


def weld(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Merge equal corners (F, 3, 3) into vertices (V, 3) and faces (F', 3).

    Faces with fewer than three different vertices are dropped.
    """
    # Adding 0.0 makes -0.0 a 0.0: positions are compared as bytes.
    points = np.ascontiguousarray(corners.reshape(-1, 3)) + 0.0
    rows = points.view(np.dtype((np.void, points.dtype.itemsize * 3))).ravel()
    _, first, number = np.unique(rows, return_index=True, return_inverse=True)
    # In the order of their first use, not of their bytes: neighbours in the file stay neighbours.
    order = np.argsort(first, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return points[first[order]], drop_degenerate(rank[number].reshape(-1, 3))


def drop_degenerate(faces: np.ndarray) -> np.ndarray:
    """Return the faces with three different vertices."""
    a, b, c = faces[:, 0], faces[:, 1], faces[:, 2]
    keep = (a != b) & (b != c) & (c != a)
    return faces if keep.all() else faces[keep]


def fan_triangles(counts: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Divide polygons into fans of triangles (F, 3), each from the polygon's first corner.

    `counts` (P,) are the corners of each, one polygon after another in `indices`.
    """
    starts = np.cumsum(counts) - counts
    per = np.maximum(counts - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), per)
    step = np.arange(int(per.sum())) - np.repeat(np.cumsum(per) - per, per)
    base = starts[polygon]
    return np.stack([indices[base], indices[base + step + 1], indices[base + step + 2]], axis=1)
