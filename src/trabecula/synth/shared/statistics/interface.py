"""How much interface a field has, and moves of it that are shortened where they would make more.

A two-point function of a small volume cannot be met exactly: real parts of that size differ in it.
A step that tries draws fringes on the interface, and throats between pores.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.parallel import for_slabs, sum_slabs
from trabecula.synth.shared.content.fields import UNIT
from trabecula.synth.shared.statistics.two_point import Correlations

_PARTS = 8  # of a move, the lengths that it may have


def interface_share(fields: Sequence[np.ndarray]) -> np.ndarray:
    """Return the share of neighbouring voxels along the axes that lie on different sides of 0, of
    every channel of fields (C, Z, Y, X) int8 together: (C,).
    """
    counts = sum(_count(field.astype(np.int16) * UNIT, field, _PARTS) for field in fields)
    pairs = sum(_pairs(field.shape[1:]) for field in fields)
    return np.asarray(counts / max(1, pairs))


def share_at(share: np.ndarray, own: Correlations, asked: Correlations) -> np.ndarray:
    """Return the shares of a material with the two-point functions `asked` whose `own` go with
    `share`: as the first step of the functions changes.
    """
    return np.asarray(share * _falls(asked) / np.maximum(_falls(own), 1e-30))


def shorten_move(field: np.ndarray, votes: np.ndarray, most: np.ndarray) -> np.ndarray:
    """Shorten a move so that no channel's interface is more than `most`, in place; return votes.

    Parameters
    ----------
    field : (C, Z, Y, X) int8
        Before the move.
    votes : (C, Z, Y, X) int16
        After it, in 1 / UNIT of the field's steps.
    most : (C,) float
        As `interface_share` measures. A field that has more already is not moved.
    """
    pairs = _pairs(field.shape[1:])
    for length in range(_PARTS, 0, -1):
        if (_count(votes, field, length) <= most * pairs).all():
            break
    else:
        length = 0
    if length < _PARTS:
        for_slabs(lambda a, b: _blend(votes, field, length, a, b), field.shape[1], anywhere=True)
    return votes


def _pairs(shape: Sequence[int]) -> int:
    z, y, x = shape
    return (z - 1) * y * x + z * (y - 1) * x + z * y * (x - 1)


def _falls(target: Correlations) -> np.ndarray:
    """Return how far the two-point functions fall over the first voxel, (C,)."""
    curves = target.curves.reshape(len(target.curves), target.directions, -1)
    held = target.held.reshape(target.directions, -1)[:, 1]
    return np.asarray(curves[:, :, 0].max(axis=1) - curves[:, held, 1].mean(axis=1))


def _count(votes: np.ndarray, field: np.ndarray, length: int) -> np.ndarray:
    """Count the neighbours on different sides of 0 after `length` of _PARTS of a move, (C,)."""

    def work(start: int, stop: int) -> np.ndarray:
        found = np.zeros(len(field), np.int64)
        count_changes(votes, field, length, found, start, stop)
        return found

    return sum_slabs(work, field.shape[1])


@kernel
def count_changes(votes, field, length, found, start, stop):
    """Add the neighbours of voxels in planes start .. stop, the next along every axis, that lie on
    the other side of 0.
    """
    channels, depth, height, width = votes.shape
    near, far = np.int32(length), np.int32((_PARTS - length) * UNIT)
    plane, after = np.empty((height, width), np.uint8), np.empty((height, width), np.uint8)
    for c in range(channels):
        _mark_inside(votes[c, start], field[c, start], near, far, plane)
        for z in range(start, stop):
            count = 0
            for y in range(height):
                for x in range(width - 1):
                    count += plane[y, x] ^ plane[y, x + 1]
            for y in range(height - 1):
                for x in range(width):
                    count += plane[y, x] ^ plane[y + 1, x]
            if z + 1 < depth:
                _mark_inside(votes[c, z + 1], field[c, z + 1], near, far, after)
                for y in range(height):
                    for x in range(width):
                        count += plane[y, x] ^ after[y, x]
            found[c] += count
            plane, after = after, plane


@inline
def _mark_inside(votes, field, near, far, inside):
    """Mark the voxels of a plane above 0 after a part of a move."""
    for y in range(inside.shape[0]):
        for x in range(inside.shape[1]):
            inside[y, x] = near * votes[y, x] + far * field[y, x] > 0


@kernel
def _blend(votes, field, length, start, stop):
    """Go `length` of _PARTS of the way from the field to the votes, in place."""
    for c in range(votes.shape[0]):
        for z in range(start, stop):
            for y in range(votes.shape[2]):
                for x in range(votes.shape[3]):
                    before = np.int32(field[c, z, y, x]) * UNIT
                    moved = length * (np.int32(votes[c, z, y, x]) - before)
                    votes[c, z, y, x] = before + moved // _PARTS
