"""The end of a fusion: interfaces as sharp as the picture's, and every block as the scan says.

A vote is a mean over the squares of three planes, so its corners are round and its throats are
filled. Detail is what a Gaussian takes away from it (an unsharp mask); so much of it is added that
the interface is as large as the material's. Connected components that come with it, smaller than
half a block, are none of the scan's and go.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trabecula.engine.memory import Array, Stage
from trabecula.engine.parallel import thread_count
from trabecula.measure.smooth import gaussian, reach_of
from trabecula.synth.kopf.back_projection import LIMIT, back_project, settle
from trabecula.synth.kopf.change_of_support import Material
from trabecula.synth.shared.block_bounds import BlockBounds
from trabecula.synth.shared.slabs import (
    count_true,
    for_plane_groups,
    make_by_slabs,
    tally_by_slabs,
)
from trabecula.synth.shared.specks import remove_specks
from trabecula.synth.shared.stages import slab_voxels
from trabecula.synth.shared.statistics.interface import interface_share

SIGMA = 2.0
"""Of the Gaussian, voxels."""

_MOST = 8.0  # times the detail
_TRIALS = 6  # of the amount, each halving what is open
_PASSES, _ROUNDS = 3, 8  # of fraction and blocks in turn; of back-projection in each
_MARGIN = 200.0  # votes beyond the interface that a block is moved


def sharpen(
    votes: np.ndarray, bounds: BlockBounds, material: Material
) -> tuple[np.ndarray, np.ndarray, Mapping[str, Any]]:
    """Return the second phase (Z, Y, X) bool of votes, sharpened until its interface is the
    material's; what it is without an unsharp mask; and a report.

    Parameters
    ----------
    votes : (Z, Y, X) int16
    bounds : BlockBounds
    material : Material
    """
    detail = _detail(votes)
    low, high, amount = 0.0, _MOST, 0.0
    for trial in range(_TRIALS + 1):
        moved = _clean(_move(votes, detail, amount, bounds, material), bounds)
        if not trial:
            plain, _ = _settled(moved, bounds)
        enough = interface_share([_sides(moved)])[0] >= material.interface
        if trial == _TRIALS or (enough and not amount):
            break
        low, high = (low, amount) if enough else (amount, high)
        amount = (low + high) / 2
    values, changed = _settled(moved, bounds)
    report = {
        "sharpening": amount,
        "settled": changed,
        "fraction": {"estimate": material.fraction, "result": count_true(values) / values.size},
        "interface": {
            "estimate": material.interface,
            "result": float(interface_share([_sides(values)])[0]),
        },
    }
    return values, plain, report


def _settled(moved: np.ndarray, bounds: BlockBounds) -> tuple[np.ndarray, int]:
    """Return where votes are positive, with blocks settled, and how many voxels changed for it."""
    values = make_by_slabs(lambda a, b: moved[a:b] > 0, moved.shape, bool)
    return values, settle(values, moved, bounds)


def sharpening_stages(shape: Sequence[int]) -> tuple[Stage, ...]:
    """Declare the arrays of `sharpen` for votes of a shape."""
    names = ("votes", "detail", "moved", "without specks")
    held = {name: Array(shape, np.int16) for name in names}
    around = slab_voxels(shape) + 2 * reach_of(SIGMA) * shape[1] * shape[2]
    byte = {name: Array(shape, bool) for name in ("values", "plain")}
    byte["sides"] = Array((1, *shape), np.int8)
    return (Stage("sharpen", {**held, **byte}, thread_count() * 12 * around),)


def _detail(votes: np.ndarray) -> np.ndarray:
    """Return half of what a Gaussian takes away from votes, int16."""
    reach = reach_of(SIGMA)

    def part(start: int, stop: int) -> np.ndarray:
        first = max(0, start - reach)
        around = votes[first : stop + reach]
        inner = slice(start - first, stop - first)
        return np.rint((around[inner] - gaussian(around, SIGMA)[inner]) / 2)

    return make_by_slabs(part, votes.shape, np.int16)


def _move(
    votes: np.ndarray, detail: np.ndarray, amount: float, bounds: BlockBounds, material: Material
) -> np.ndarray:
    """Add an amount of detail; bring the fraction to the material's and the blocks between their
    bounds, in turn.
    """
    factor = np.float32(2 * amount)

    def sum_of(start: int, stop: int) -> np.ndarray:
        found = votes[start:stop] + factor * detail[start:stop]
        return np.clip(np.rint(found, out=found), -LIMIT, LIMIT, out=found)

    moved = make_by_slabs(sum_of, votes.shape, np.int16)
    for _ in range(_PASSES):
        _shift_to_fraction(moved, material.fraction)
        back_project(moved, bounds, rounds=_ROUNDS, margin=_MARGIN)
    return moved


def _shift_to_fraction(votes: np.ndarray, fraction: float) -> None:
    """Shift votes by a constant so that this fraction of them is positive, in place."""
    counts = tally_by_slabs(
        lambda a, b: np.bincount(votes[a:b].ravel().astype(np.int64) + 2**15, minlength=2**16),
        votes.shape,
    )
    above = votes.size - np.cumsum(counts)  # votes larger than each value
    level = int(np.argmin(np.abs(above - fraction * votes.size))) - 2**15

    def shift(start: int, stop: int) -> None:
        moved = votes[start:stop].astype(np.int32) - level
        votes[start:stop] = np.clip(moved, -LIMIT, LIMIT)

    for_plane_groups(shift, votes.shape)


def _clean(votes: np.ndarray, bounds: BlockBounds) -> np.ndarray:
    """Return votes whose phases have no components smaller than half a block."""
    values = make_by_slabs(lambda a, b: votes[a:b] > 0, votes.shape, np.uint8)
    return remove_specks(votes[None], values, (0, 1), bounds.size // 2)[0]


def _sides(votes: np.ndarray) -> np.ndarray:
    """Return 1 or -1 (1, Z, Y, X) int8 of votes, or of a mask."""
    return make_by_slabs(lambda a, b: np.where(votes[a:b] > 0, 1, -1), (1, *votes.shape), np.int8)
