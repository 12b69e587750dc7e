"""The connected parts of what is there from the start, found some planes at a time, so that no
whole volume of labels is held.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from trabecula.engine import memmap
from trabecula.measure.labelling import pairs_across
from trabecula.measure.runs import Runs, merge_labels, runs_of

_AT_ONCE = 1 << 21
"""Voxels of a slab at most: its runs and labels take some bytes each, whether scratch files are in
use or not.
"""

_FACES = 6  # neighbours of a voxel


def slabs_of(shape: Sequence[int]) -> Iterator[tuple[int, int]]:
    """First and last plane (which is not among them) of slabs that are worked on one after the
    other.
    """
    plane = int(np.prod(shape[1:], dtype=np.int64))
    thick = max(1, min(memmap.slab_thickness(shape[0], 1), _AT_ONCE // max(1, plane)))
    for first in range(0, shape[0], thick):
        yield first, min(first + thick, shape[0])
        memmap.release_pages()


def parts_of(
    values: np.ndarray, member: np.ndarray, wraps: Sequence[bool], *, into: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Find the parts of the voxels whose value is a member.

    Parameters
    ----------
    values : (Z, Y, X) uint8
    member : (256,) bool
    wraps : three bool
        Axes at whose ends voxels are neighbours.
    into : (Z, Y, X) int32, optional
        Gets a number, from 1 on, for every voxel of a member; others are left as they are.

    Returns
    -------
    part : (m + 1,) int64
        The part, 1 .. n in the order of first voxels, that a number of `into` stands for; several
        may stand for one.
    sizes : (n,) int64
        Voxels of every part.
    """
    sizes, pairs, count = [], [np.empty((0, 2), np.int64)], 0
    first = last = np.zeros(values.shape[1:], np.int64)
    for a, b in slabs_of(values.shape):
        runs = runs_of(np.ascontiguousarray(values[a:b]), member, _FACES)
        top, bottom = _layer(runs, 0, 0, count), _layer(runs, 0, -1, count)
        pairs.append(_meeting(last, top))  # before the first slab there is nothing
        pairs += [
            _meeting(_layer(runs, n, -1, count), _layer(runs, n, 0, count))
            for n in (1, 2)
            if wraps[n]
        ]
        first, last = top if a == 0 else first, bottom
        if into is not None:
            labels = runs.labels()
            np.add(labels, np.int32(count), out=into[a:b], where=labels > 0)
        sizes.append(runs.sizes)
        count += len(runs.sizes)
    if wraps[0]:
        pairs.append(_meeting(last, first))
    part, merged = merge_labels(np.concatenate(sizes), np.concatenate(pairs))
    return np.concatenate([[0], part]), merged


def _layer(runs: Runs, axis: int, end: int, before: int) -> np.ndarray:
    """The numbers at one end of a slab, int64; `before` of them are those of slabs before."""
    box = [(0, side) for side in runs.shape]
    box[axis] = (runs.shape[axis] - 1, runs.shape[axis]) if end else (0, 1)
    labels = runs.labels(tuple(box)).take(0, axis).astype(np.int64)
    return np.where(labels > 0, labels + before, 0)


def _meeting(far: np.ndarray, near: np.ndarray) -> np.ndarray:
    """(n, 2) numbers that are neighbours from a layer to the one behind it."""
    return pairs_across(far, near, _FACES, (False, False))
