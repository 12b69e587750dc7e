"""From corners and polygons, as files hold them, to vertices and triangles."""

from __future__ import annotations

import numpy as np


def weld(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners (F, 3, 3) as vertices (V, 3), every place once, and faces (F', 3); faces of fewer
    than three places go.
    """
    # which makes -0 a 0: places are compared as bytes
    points = np.ascontiguousarray(corners.reshape(-1, 3)) + 0.0
    rows = points.view(np.dtype((np.void, points.dtype.itemsize * 3))).ravel()
    _, first, number = np.unique(rows, return_index=True, return_inverse=True)
    # In the order of their first use, not of their bytes: neighbours in the file stay neighbours.
    order = np.argsort(first, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return points[first[order]], without_slivers(rank[number].reshape(-1, 3))


def without_slivers(faces: np.ndarray) -> np.ndarray:
    """The faces that name three vertices."""
    a, b, c = faces[:, 0], faces[:, 1], faces[:, 2]
    keep = (a != b) & (b != c) & (c != a)
    return faces if keep.all() else faces[keep]


def fans(counts: np.ndarray, indices: np.ndarray) -> np.ndarray:
    """Triangles (F, 3) of polygons: `counts` corners each, one after another in `indices`; each a
    fan from its first.
    """
    starts = np.cumsum(counts) - counts
    per = np.maximum(counts - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), per)
    step = np.arange(int(per.sum())) - np.repeat(np.cumsum(per) - per, per)
    base = starts[polygon]
    return np.stack([indices[base], indices[base + step + 1], indices[base + step + 2]], axis=1)
