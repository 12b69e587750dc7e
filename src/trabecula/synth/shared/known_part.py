"""The known part of new material: whether there is room beside it, and what steps on the two-point
function can change there.

Pairs of two known voxels stay as they are. So a step aims at the exemplar's two-point function for
all other pairs, those of a known and a free voxel lying between both: without that what is made
would have to make up for what is known. And a step moves interfaces the less the nearer they are to
a known voxel: it knows nothing of the joint, and ended in a face there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.memory import Array, Stage, Workspace, within
from trabecula.engine.parallel import for_slabs
from trabecula.measure.distance import distance_transform
from trabecula.synth.shared.content.fields import UNIT
from trabecula.synth.shared.content.joints import find_known
from trabecula.synth.shared.matching.region import Region, has_cube
from trabecula.synth.shared.novel_schedule import LEAST
from trabecula.synth.shared.slabs import complement, count_true, make_by_slabs, tally_by_slabs
from trabecula.synth.shared.statistics.torus_steps import TorusPairs, torus_step_stages
from trabecula.synth.shared.statistics.two_point import Correlations, Soft

_NEAR = 4.0
"""Voxels beyond the known ones from where a move is whole."""

WHOLE = 64
"""The share of a whole move."""

_ENOUGH = 0.3
"""The share of free voxels from which on they are held to the two-point function of the material:
towards it the interfaces of a smaller hole would be cut into combs."""


def has_room_beside(known: np.ndarray, top: int) -> bool:
    """Return whether the free voxels have room for a layout on level `top`, and half of the known
    ones are seen there.
    """
    open_, held = Region(known.shape, free=complement(known)), Region(known.shape, free=known)
    for _ in range(top):
        open_, held = open_.halve(), held.halve()
    assert open_.free is not None and held.free is not None
    seen = count_true(complement(open_.free)) * 8**top
    return 2 * seen >= count_true(known) and has_cube(complement(held.free), LEAST)


def is_a_sample(known: np.ndarray) -> bool:
    """Return whether the free voxels are as many as make a sample of the material."""
    return known.size - count_true(known) >= _ENOUGH * known.size


@dataclass(frozen=True)
class KnownPart:
    """What steps aim at beside the known voxels of a torus.

    Attributes
    ----------
    target : Correlations
        Of all voxels together, where the free ones have theirs.
    interface : (C,) float, optional
        The most that steps may leave, of all voxels together.
    """

    target: Correlations
    interface: np.ndarray | None

    @classmethod
    def of(
        cls,
        region: Region,
        target: Correlations,
        means: np.ndarray,
        interface: np.ndarray | None,
    ) -> tuple[KnownPart, np.ndarray]:
        """Measure the known voxels of a region, whose free ones are to have the `target`, these
        `means` of their soft indicators, and so much interface at most; return it with the
        `move_shares`.
        """
        low, high = region.low, region.high
        assert region.free is not None and low is not None and high is not None
        work = Workspace(known_stages(region.shape, len(low), target))
        work.enter("measure shares")
        known = work.adopt("which are known", find_known(region.free, low, high))
        work.adopt("shares", move_shares(known, region.wraps))
        work.enter("compare known voxels")
        middle = work.adopt(
            "middle",
            make_by_slabs(
                lambda a, b: (low[:, a:b].astype(np.int16) + high[:, a:b]) >> 1, low.shape, np.int8
            ),
        )
        whole = target_beside(target, means, known, middle)
        most = None if interface is None else interface_beside(interface, known, middle)
        return cls(whole, most), work.take("shares")


def target_beside(
    target: Correlations, means: np.ndarray, known: np.ndarray, middle: np.ndarray
) -> Correlations:
    """Return the two-point functions of a torus with known voxels whose free ones follow a target.

    Parameters
    ----------
    target : Correlations
        Of free voxels.
    means : (C,) float64
        Of their soft indicators.
    known : (Z, Y, X) bool
    middle : (C, Z, Y, X) int8
        The field of the known voxels.
    """
    pairs = TorusPairs.of(known.shape, target)

    def correlate(soft: Soft) -> np.ndarray:
        spectrum = pairs.forward(target.on_grid(soft.planes, known.shape))
        return pairs.curve(spectrum, spectrum)

    ones = np.ones(256, np.float32)
    both = correlate(Soft(middle[0], ones, known))  # shares of pairs
    share = count_true(known) / known.size
    one, none = 2 * (share - both), 1 - 2 * share + both
    curves = []
    for curve, channel, free in zip(target.curves, middle, means.tolist(), strict=True):
        soft = Soft.of(channel, target.softness, known)
        own = float(soft.mean_and_moving()[0])
        variance, other = free - free * free, own - own * own
        covariance = (curve - free * free) / max(variance, 1e-30)
        between = covariance * np.sqrt(max(variance * other, 0)) + own * free
        curves.append(correlate(soft) + one * between + none * curve)
    return replace(target, curves=np.array(curves))


def interface_beside(share: np.ndarray, known: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Return the share of neighbours on different sides of an interface (C,) where known voxels
    have their own, and pairs with a free one the `share` (C,).
    """

    def tally(start: int, stop: int) -> np.ndarray:
        counts = np.zeros(2 + len(middle), np.int64)
        last = min(stop + 1, len(known))
        for axis in range(3):
            # of pairs across planes those whose first voxel is in these planes
            planes = slice(start, last if axis == 0 else stop)
            there, inside = known[planes], middle[:, planes] > 0
            near, far = [slice(None)] * 3, [slice(None)] * 3
            near[axis], far[axis] = slice(None, -1), slice(1, None)
            held = there[tuple(near)] & there[tuple(far)]
            changes = inside[:, *near] != inside[:, *far]
            counts[:2] += held.size, np.count_nonzero(held)
            counts[2:] += np.count_nonzero(changes & held, axis=(1, 2, 3))
        return counts

    every, held, *own = tally_by_slabs(tally, known.shape).tolist()
    return np.asarray((share * (every - held) + own) / max(1, every))


def move_shares(known: np.ndarray, wraps: Sequence[bool]) -> np.ndarray:
    """Return the part of a move that every voxel may take, (Z, Y, X) uint8 in 64ths: nothing where
    it is known, all of it from 4 voxels beyond that on.
    """
    distance = distance_transform(complement(known), periodic=tuple(wraps))

    def shares(start: int, stop: int) -> np.ndarray:
        part = (distance[start:stop] - np.float32(0.5)) * np.float32(WHOLE / _NEAR)
        return np.rint(np.clip(part, 0, WHOLE))

    return make_by_slabs(shares, known.shape, np.uint8)


def shares_beside(region: Region) -> np.ndarray | None:
    """Return `move_shares` beside the known voxels of a region; None where nothing is known."""
    if region.free is None or region.low is None or region.high is None:
        return None
    return move_shares(find_known(region.free, region.low, region.high), region.wraps)


def hold_move(votes: np.ndarray, field: np.ndarray, shares: np.ndarray) -> None:
    """Shorten the move from a field (C, Z, Y, X) int8 to votes int16 to the shares of
    `move_shares`, in place.
    """
    for_slabs(partial(_hold, votes, field, shares), shares.shape[0])


def share_stages(shape: Sequence[int]) -> tuple[Stage, ...]:
    """Declare the arrays of `move_shares` beside the known voxels."""
    distance = {"distance": Array(shape, np.float32), "which are not": Array(shape, bool)}
    return (Stage("measure shares", {"shares": Array(shape, np.uint8), **distance}),)


def known_stages(shape: Sequence[int], channels: int, target: Correlations) -> tuple[Stage, ...]:
    """Declare the arrays of `KnownPart.of`."""
    known = {"which are known": Array(shape, bool)}
    held = {**known, "shares": Array(shape, np.uint8), "middle": Array((channels, *shape), np.int8)}
    compare = next(one for one in torus_step_stages(shape, target) if one.name == "compare")
    compared = replace(compare, name="compare known voxels")
    return (*within(known, share_stages(shape)), *within(held, [compared]))


@kernel
def _hold(votes, field, shares, start, stop):
    """Go the share of the way from the field to the votes, in planes start..stop."""
    for c in range(votes.shape[0]):
        for z in range(start, stop):
            for y in range(votes.shape[2]):
                for x in range(votes.shape[3]):
                    before = np.int32(field[c, z, y, x]) * UNIT
                    moved = shares[z, y, x] * (np.int32(votes[c, z, y, x]) - before)
                    votes[c, z, y, x] = before + moved // WHOLE
