"""End of growth for a porosity: the arrival up to which the void has its volume fraction.

In a request of up to 2 million voxels every one is counted, so that the fraction is exact to the
voxel. In larger ones voxels of scattered blocks are counted, one of each part of an even division
of the request: the result then misses the fraction by chance, 0.05 points as a rule. Either way a
block that is made alone has the same level as the whole.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from trabecula.core.seeds import generator
from trabecula.engine.blocks import Box, boxes_of
from trabecula.engine.memory import Array, Stage, Workspace, within
from trabecula.synth.bubbles.growth import Growth, box_stages, expected_sizes
from trabecula.synth.bubbles.growth_law import Law
from trabecula.synth.bubbles.kernels import BLOCK, SUPER

COUNTED = 1 << 21
"""Voxels of a request up to which all are counted."""

_FEWEST, _MOST = 1 << 16, 1 << 18  # blocks of a larger one
_EACH = 8  # blocks for each bubble, between the two
# voxels along an edge of a box of blocks, where all voxels are counted and where some are
_PARTS = (64, 256)


@dataclass(frozen=True)
class Arrivals:
    """Sorted T^2 of the counted voxels.

    Attributes
    ----------
    values : (N,) float32 array
        Those in walls and out of the room are infinite, and so the last.
    """

    values: np.ndarray

    @property
    def most(self) -> float:
        """Return the highest void fraction that growth reaches."""
        return float(np.searchsorted(self.values, np.inf) / max(1, len(self.values)))

    def reaches(self, share: float) -> bool:
        """Return whether growth reaches a void fraction."""
        return round(share * len(self.values)) <= int(np.searchsorted(self.values, np.inf))

    def level(self, share: float | np.ndarray) -> np.float32 | np.ndarray:
        """Return T^2 for a void fraction (or a field of them), below 0 where it is none."""
        rank = np.rint(np.asarray(share, np.float64) * len(self.values)).astype(np.int64)
        rank = np.minimum(rank, np.searchsorted(self.values, np.inf))
        found = np.where(rank > 0, self.values[np.maximum(rank - 1, 0)], np.float32(-1))
        return found if found.ndim else np.float32(found)


def arrivals_of(growth: Growth, shape: Sequence[int], mask: np.ndarray | None) -> Arrivals:
    """Return arrivals in a request (in its mask, less the crust), enough of them for any level."""
    work = Workspace(level_stages(growth.law, shape, masked=mask is not None))
    work.enter("hold arrivals")
    arrivals, count = work.empty("arrivals"), 0
    chance = generator(growth.seed, "bubbles/level")
    for box, along in _divisions(growth.law, shape):
        picked = _voxels_of_a_block(growth.law, shape)
        blocks = _scatter_blocks(box, along, chance)
        picks = _picks(len(blocks), picked, growth.law.ndim, chance)
        work.enter("count a box")
        count += _count_box(work, growth, box, blocks, picks, mask, arrivals[count:])
        work.enter("hold arrivals")
    values = arrivals[:count]
    values.sort()
    return Arrivals(values)


def _count_box(
    work: Workspace,
    growth: Growth,
    box: Box,
    blocks: np.ndarray,
    picks: np.ndarray,
    mask: np.ndarray | None,
    into: np.ndarray,
) -> int:
    """Write T^2 of the voxels of a box that count to the beginning of an array; return their
    number.
    """
    values = work.adopt("sampled", growth.sample(box, blocks, picks))
    found = work.adopt("found", values[_count_mask(blocks, picks, box, growth, mask)])
    into[: len(found)] = found
    return len(found)


def level_stages(
    law: Law, shape: Sequence[int], *, masked: bool, flows: bool = False
) -> tuple[Stage, ...]:
    """Declare the arrays of finding the arrivals in a request (Z, Y, X)."""
    picked, divisions = _voxels_of_a_block(law, shape), _divisions(law, shape)
    blocks = [math.prod(along) for _, along in divisions]
    most, sides = max(blocks), [stop for _, stop in divisions[0][0]]
    held = {"arrivals": Array(min(math.prod(shape), picked * sum(blocks)), np.float32)}
    sampled = {
        "blocks": Array((most, 3), np.int64),
        "picks": Array((most, picked), np.uint8),
        "sampled": Array((most, picked), np.float32, at_most=True),
    }
    counted = {
        "found": sampled["sampled"],
        "voxels": Array((most, picked, 3), np.int64),
        "inside": Array((most, picked, 10), bool),
    }
    box = box_stages(law, expected_sizes(law, sides, flows=flows, room=masked))
    return (
        Stage("hold arrivals", held, 200 * most),  # blocks are drawn
        *within({**held, **sampled}, box),
        Stage("count a box", {**held, **sampled, **counted}, 48 * picked * most * masked),
    )


def _voxels_of_a_block(law: Law, shape: Sequence[int]) -> int:
    """Return how many voxels of a block are counted."""
    return BLOCK**law.ndim if math.prod(shape) <= COUNTED else 2**law.ndim


def _divisions(law: Law, shape: Sequence[int]) -> list[tuple[Box, tuple[int, ...]]]:
    """Return boxes that cover a request, and the even division of each into as many parts as
    blocks of it are counted: all, or those of a larger request that lie scattered.
    """
    voxels = math.prod(shape)
    if voxels <= COUNTED:
        wanted, side = voxels, _PARTS[0]  # more blocks than there are: all
    else:
        bubbles = voxels / law.apart**law.ndim
        wanted, side = int(min(max(_EACH * bubbles, _FEWEST), _MOST)), _PARTS[1]
    found = []
    for box in boxes_of(shape, side):
        here = max(1, round(wanted * (math.prod(stop - start for start, stop in box) / voxels)))
        sides = [-(-stop // BLOCK) - start // BLOCK for start, stop in box]
        share = min(1.0, (here / math.prod(sides)) ** (1 / law.ndim))
        found.append((box, tuple(max(1, round(blocks * share)) for blocks in sides)))
    return found


def _scatter_blocks(box: Box, along: Sequence[int], chance: np.random.Generator) -> np.ndarray:
    """Return blocks (N, 3) of a box, one by chance in each part of its division."""
    ranges = [(start // BLOCK, -(-stop // BLOCK)) for start, stop in box]
    parts = np.indices(along).reshape(3, -1).T
    sides = np.array([stop - start for start, stop in ranges])
    cuts = parts * sides // along
    wide = (parts + 1) * sides // along - cuts
    found = [start for start, _ in ranges] + cuts + chance.integers(0, wide)
    cubes = found // SUPER
    # Cube by cube, since blocks of a cube share its search.
    return np.ascontiguousarray(found[np.lexsort(cubes.T[::-1])])


def _picks(blocks: int, picked: int, ndim: int, chance: np.random.Generator) -> np.ndarray:
    """Return numbers of voxels in their blocks.

    They are all, alike for all blocks, or one of each eighth (quarter) of the block.
    """
    if picked == BLOCK**ndim:
        return np.arange(picked, dtype=np.uint8)[None]
    parts = np.indices((2,) * ndim).reshape(ndim, -1).T
    places = 2 * parts + chance.integers(0, 2, (blocks, len(parts), ndim))
    return (places @ ([BLOCK, 1, BLOCK**2] if ndim == 3 else [1, BLOCK])).astype(np.uint8)


def _count_mask(
    blocks: np.ndarray, picks: np.ndarray, box: Box, growth: Growth, mask: np.ndarray | None
) -> np.ndarray:
    """Return a mask of the picked voxels that count."""
    flat = growth.law.ndim == 2
    rows = BLOCK if flat else BLOCK**2  # as kernels count the voxels of a block
    within = np.stack([picks % rows // BLOCK, picks % BLOCK, picks // rows], -1)
    places = blocks[:, None] * [1 if flat else BLOCK, BLOCK, BLOCK] + within
    count = ((places >= [start for start, _ in box]) & (places < [stop for _, stop in box])).all(-1)
    known = mask if mask is None or not flat else mask[None]
    room = growth.room(box)
    for region, corner in ((known, 0), (room, [start for start, _ in box])):
        if region is not None:
            count[count] = region[tuple((places[count] - corner).T)]
    return count
