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
from trabecula.synth.bubbles.growth import Growth, bytes_of_box
from trabecula.synth.bubbles.growth_law import Law
from trabecula.synth.bubbles.kernels import BLOCK, SUPER

COUNTED = 1 << 21
"""Voxels of a request up to which all are counted."""

_FEWEST, _MOST = 1 << 16, 1 << 18  # blocks of a larger one
_EACH = 8  # blocks for each bubble, between the two
# voxels along an edge of a box of blocks, where all voxels are counted and where some are
_PARTS = (64, 256)
_A_VOXEL = 26  # bytes for each counted voxel during the count


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
    voxels, ndim = math.prod(shape), growth.law.ndim
    wanted, picked, side = _sample_sizes(growth.law, shape)
    chance = generator(growth.seed, "bubbles/level")
    found = []
    for box in boxes_of(shape, side):
        share = math.prod(stop - start for start, stop in box) / voxels
        blocks = _scatter_blocks(box, max(1, round(wanted * share)), ndim, chance)
        picks = _picks(len(blocks), picked, ndim, chance)
        values = growth.sample(box, blocks, picks)
        found.append(values[_count_mask(blocks, picks, box, growth, mask)])
    values = np.concatenate(found)
    values.sort()
    return Arrivals(values)


def bytes_counted(law: Law, shape: Sequence[int]) -> tuple[int, int, int]:
    """Return bytes of the arrivals, bytes of finding them, and the edge of a box of blocks."""
    wanted, picked, side = _sample_sizes(law, shape)
    voxels = math.prod(shape)
    values = min(wanted * picked, voxels)
    most = min(side, max(shape)) ** law.ndim
    part = min(values, math.ceil(values * most / voxels))
    return 4 * values, 4 * values + max(4 * values, _A_VOXEL * part), side


def _sample_sizes(law: Law, shape: Sequence[int]) -> tuple[int, int, int]:
    """Return the number of blocks, the voxels picked in each, and the edge of a box of blocks."""
    voxels, whole = math.prod(shape), BLOCK**law.ndim
    if voxels <= COUNTED:
        return voxels, whole, _PARTS[0]  # more blocks than there are: all
    bubbles = voxels / law.apart**law.ndim
    return int(min(max(_EACH * bubbles, _FEWEST), _MOST)), 2**law.ndim, _PARTS[1]


def _scatter_blocks(box: Box, wanted: int, ndim: int, chance: np.random.Generator) -> np.ndarray:
    """Return blocks (N, 3) of a box: all, or one by chance in each part of a division.

    The division is even, into about `wanted` parts.
    """
    ranges = [(start // BLOCK, -(-stop // BLOCK)) for start, stop in box]
    share = min(1.0, (wanted / math.prod(stop - start for start, stop in ranges)) ** (1 / ndim))
    along = [max(1, round((stop - start) * share)) for start, stop in ranges]
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


def bytes_of_level(law: Law, shape: Sequence[int], *, flows: bool) -> tuple[int, int]:
    """Return the bytes of the arrivals in a request, and the bytes of finding them."""
    kept, held, part = bytes_counted(law, shape)
    return kept, max(
        held, kept + bytes_of_box(law, [min(part, side) for side in shape], flows=flows)
    )
