"""Contacts of bricks by an edge or a node alone, which bear as hinges do and no mesher likes."""

from __future__ import annotations

from functools import cache
from itertools import combinations

import numpy as np


class ContactTally:
    """Counts of contacts, plane after plane."""

    def __init__(self) -> None:
        self._before: np.ndarray | None = None
        self._edges = 0
        self._blocks = np.zeros(256, np.int64)

    def add(self, inside: np.ndarray) -> None:
        """Take the next plane of voxels, (Y, X) bool."""
        here = np.pad(inside, 1)
        before = np.zeros_like(here) if self._before is None else self._before
        # Edges along z lie within a plane, those along y and x between two of them.
        self._edges += _checkers(here[:-1, :-1], here[:-1, 1:], here[1:, :-1], here[1:, 1:])
        self._edges += _checkers(before[:, :-1], before[:, 1:], here[:, :-1], here[:, 1:])
        self._edges += _checkers(before[:-1], before[1:], here[:-1], here[1:])
        self._count_blocks(before, here)
        self._before = here

    def finish(self) -> tuple[int, int]:
        """Return the contacts by an edge, and those by a node."""
        assert self._before is not None
        self._count_blocks(self._before, np.zeros_like(self._before))
        return self._edges, int(self._blocks @ _touching_nodes())

    def _count_blocks(self, below: np.ndarray, above: np.ndarray) -> None:
        shape = (below.shape[0] - 1, below.shape[1] - 1)
        codes = np.zeros(shape, np.uint8)
        for k, plane in enumerate((below, above)):
            for j in (0, 1):
                for i in (0, 1):
                    part = plane[j : j + shape[0], i : i + shape[1]]
                    codes |= part.astype(np.uint8) << np.uint8(4 * k + 2 * j + i)
        self._blocks += np.bincount(codes.ravel(), minlength=256)


def _checkers(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> int:
    """Count 2x2 squares of which one diagonal is inside and the other is not."""
    return int(np.count_nonzero((a & d & ~b & ~c) | (b & c & ~a & ~d)))


@cache
def _touching_nodes() -> np.ndarray:
    """Return, for every 2x2x2 block, whether voxels of it touch at its centre alone, (256,)."""
    places = [(code >> 2 & 1, code >> 1 & 1, code & 1) for code in range(8)]
    near = {
        (a, b)
        for a, b in combinations(range(8), 2)
        if sum(p != q for p, q in zip(places[a], places[b], strict=True)) <= 2
    }
    found = np.zeros(256, np.int64)
    for code in range(256):
        groups = [{n} for n in range(8) if code >> n & 1]
        for a, b in near:
            first = next((group for group in groups if a in group), None)
            second = next((group for group in groups if b in group), None)
            if first is not None and second is not None and first is not second:
                groups.remove(second)
                first |= second
        found[code] = len(groups) > 1
    return found
