"""What can carry load: parts of the solid that meet themselves again across the faces of the
periodic box.
"""

from __future__ import annotations

import numpy as np

from trabecula.measure.labelling import label_components


def load_bearing(inside: np.ndarray) -> np.ndarray:
    """The components (through faces of voxels) that wrap around the periodic box along some
    direction, (Z, Y, X) bool.

    All others are islands: an overall strain moves them, and they carry nothing.
    """
    labels, sizes = label_components(inside)
    count = len(sizes)
    parent = list(range(count + 1))
    # of a component's box, seen from its parent's
    offset: list[tuple[int, ...]] = [(0, 0, 0)] * (count + 1)
    wraps = np.zeros(count + 1, bool)
    for axis in range(3):
        step = tuple(int(axis == k) for k in range(3))
        pairs = np.stack(
            [labels.take(-1, axis=axis).ravel(), labels.take(0, axis=axis).ravel()], axis=1
        )
        for low, high in np.unique(pairs[(pairs > 0).all(axis=1)], axis=0).tolist():
            _join(parent, offset, wraps, low, high, step)
    roots = np.array([_root(parent, offset, k)[0] for k in range(count + 1)])
    bears = np.zeros(count + 1, bool)
    np.logical_or.at(bears, roots, wraps)
    carries = bears[roots]
    carries[0] = False
    return carries[labels]


def _root(parent: list[int], offset: list[tuple[int, ...]], k: int) -> tuple[int, tuple[int, ...]]:
    total: tuple[int, ...] = (0, 0, 0)
    path = []
    while parent[k] != k:
        path.append(k)
        k = parent[k]
    for member in reversed(path):  # from the root's child down, so that each one's parent is done
        total = tuple(a + b for a, b in zip(total, offset[member], strict=True))
        parent[member], offset[member] = k, total
    return k, total


def _join(
    parent: list[int],
    offset: list[tuple[int, ...]],
    wraps: np.ndarray,
    a: int,
    b: int,
    step: tuple[int, ...],
) -> None:
    """b, one `step` of boxes on, touches a."""
    root_a, from_a = _root(parent, offset, a)
    root_b, from_b = _root(parent, offset, b)
    gap = tuple(p + s - q for p, s, q in zip(from_a, step, from_b, strict=True))
    if root_a != root_b:
        parent[root_b], offset[root_b] = root_a, gap
    elif any(gap):
        wraps[root_a] = True
